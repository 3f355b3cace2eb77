"""Sensors, motors and cameras of virtual boards, each as its data sheet has it.

============  ==================================================================================
``bh1750``    The BH1750: light in lux, by commands of one byte
``camera``    A camera that takes JPEG pictures of the room that it stands in, as an OV2640 does
``drv8835``   TI DRV8835, a double H-bridge, in IN/IN mode (its MODE pin low)
``encoder``   A wheel's photoelectric encoder with one channel: a disc of slots, and a light
              barrier
``gnss``      A receiver of satellites on a UART: NMEA 0183, once a second
``lis3mdl``   The LIS3MDL: the magnetic field, x y z, by registers
``max17048``  The MAX17048: a cell's voltage and how full it is, by registers of 16 bits, big-
              endian
``mcp9600``   The MCP9600: a thermocouple's hot and cold junction, by registers behind a pointer
``motor``     A brushed DC motor with its gear, as it is seen at the wheel's shaft
``mpu6050``   The MPU-6050: acceleration, rate of turn and its own temperature, by registers
``sht3x``     The SHT3x: temperature and relative humidity, by 16-bit commands
``tfluna``    The TF-Luna in I2C mode: how far something is, by light, in registers, little-
              endian
``vcnl4010``  The VCNL4010: proximity by its own infrared light, and ambient light
============  ==================================================================================
"""
