"""Control of a differential-drive rover: encoders, PID, odometry, tuning and calibration.

Runs on boards as it is. Lengths are in metres, angles in radians counter-clockwise, times in ticks
of microseconds modulo 2^30 (`uros.ticks`). Duties are those of an 8-bit PWM, -255 to 255.

==============  ==================================================================================
``wheel``       Distance and speed of a wheel with a single-channel encoder.
``pid``         PID controller of a motor's speed, with feed-forward and a dead zone.
``odometry``    Pose from the distances of both wheels, with its covariance.
``diff_drive``  Wheel speeds that follow a Twist, and detection of a blocked wheel.
``chassis``     Supply, motors, encoders, speed control and odometry of one rover.
``square``      Driving a square by odometry.
``autotune``    Identification of both motors, and PID gains for them.
``calibrate``   Wheel radii and track from a drive whose poses were measured.
==============  ==================================================================================
"""
