"""Sensors, motors and cameras of virtual boards, each modelled after its data sheet.

============  ==================================================================================
``bh1750``    The BH1750 ambient light sensor: illuminance in lux, one-byte commands
``camera``    An OV2640 camera: JPEG pictures of the room around it
``drv8835``   The TI DRV8835 dual H-bridge in IN/IN mode (MODE pin low)
``encoder``   A single-channel photoelectric wheel encoder: slotted disc and light barrier
``gnss``      A GNSS receiver on a UART: NMEA 0183, once a second
``lis3mdl``   The LIS3MDL magnetometer: magnetic field on three axes
``max17048``  The MAX17048 fuel gauge: cell voltage and state of charge
``mcp9600``   The MCP9600 thermocouple converter: hot and cold junction temperature
``motor``     A brushed DC gear motor, seen at the wheel's shaft
``mpu6050``   The MPU-6050: acceleration, angular velocity and die temperature
``sht3x``     The SHT3x: temperature and relative humidity, 16-bit commands
``tfluna``    The TF-Luna lidar in I2C mode: distance
``vcnl4010``  The VCNL4010: proximity by its own infrared light, and ambient light
============  ==================================================================================
"""
