"""Driving on two wheels: speed from encoder edges, PID, odometry, tuning and calibration.

Runs on boards as it is. Lengths are in metres, angles in radians counter-clockwise, times in ticks
of microseconds modulo 2^30 (`uros.ticks`). Duties are those of an 8-bit PWM, -255 to 255.
"""
