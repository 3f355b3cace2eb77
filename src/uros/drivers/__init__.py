"""Drivers for boards: sensors, the I2C bus, motors, LEDs, buttons and serial ports.

They import no other package of uros.

================  ================================================================================
``bus``           I2C bus that is recovered when a device holds its data line.
``sampled``       Base class of sensors that measure continuously and flag new samples.
``bh1750``        ROHM BH1750: illuminance.
``lis3mdl``       ST LIS3MDL: magnetic field.
``max17048``      Maxim MAX17048: voltage and charge of a lithium cell.
``mcp9600``       Microchip MCP9600: thermocouple.
``mpu6050``       InvenSense MPU-6050: acceleration and angular velocity.
``sht3x``         Sensirion SHT30, SHT31 and SHT35: temperature and relative humidity.
``tfluna``        Benewake TF-Luna: distance, by time of flight.
``vcnl4010``      Vishay VCNL4010: proximity and ambient light.
``nmea``          NMEA 0183: position, velocity and time from a GNSS receiver.
``drv8835``       TI DRV8835: H-bridge of a motor, on two PWM outputs.
``led``           LEDs: a dimmed one, and one that shows the program's state.
``button``        Debounced push button.
``port``          The serial port towards the host: USB or a UART.
``console_port``  The console's line as the line to the agent.
``usb_cdc``       USB CDC-ACM serial port, made by the program.
``pid_line``      Text protocol by which the wheels of a rover are tuned over TCP.
``starting``      Start-up of a part that may fail and is tried again.
================  ================================================================================

A sensor's driver takes a ``machine.I2C`` and never waits: each call ends with its transfers on the
bus. Where the sensor needs time, ``start()`` begins a measurement, which is read ``wait_ms`` later.
A failed reading keeps the values of the last good one, and raises

- OSError: the transfer failed,
- SensorError: the transfer succeeded, but what the sensor sent is no valid measurement.

Every transfer ends with a stop condition. A register is therefore read by two transfers, the
register's number and then its content, and not by ``readfrom_mem``: MicroPython's driver for the
RA6M5 misses the start condition of the next transfer after a repeated start that failed.
"""

import errno


class SensorError(Exception):
    """A sensor answered, but not with a valid measurement; str() says what is wrong."""


_REASONS = {
    errno.ENODEV: "no answer",
    errno.EIO: "bus error",
    errno.ETIMEDOUT: "bus timed out",
    errno.EPERM: "bus error",  # the renesas-ra port knows no other
}


def reason(error: Exception) -> str:
    """Return a short text for people about an error of a driver."""
    if isinstance(error, OSError):
        number = error.args[0] if error.args else 0
        return _REASONS.get(number) or "bus error %s" % number
    return str(error)
