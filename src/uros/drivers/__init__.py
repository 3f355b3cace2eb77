"""Drivers for boards: sensors, the bus they sit on, the serial port. They import no other room.

A sensor's driver takes a ``machine.I2C`` and never waits: each call is over after its transfers on
the bus. Where the sensor needs time, ``start()`` begins a measurement and the reading is asked for
``wait_ms`` later. A reading that failed leaves the values of the last good one, and raises

- OSError: the bus says that the transfer failed,
- SensorError: the transfer was fine, what it brought is not.

Every transfer ends with a stop condition. Registers are therefore read by two transfers, the
register's number and then its content, and not by ``readfrom_mem``: MicroPython's driver for the
RA6M5 misses the start condition of the next transfer after a repeated start that failed.
"""

import errno


class SensorError(Exception):
    """A sensor answered, but not with a measurement; str() tells people what is wrong."""


_REASONS = {
    errno.ENODEV: "no answer",
    errno.EIO: "bus error",
    errno.ETIMEDOUT: "bus timed out",
    errno.EPERM: "bus error",  # the renesas-ra port knows no other
}


def reason(error: Exception) -> str:
    """What to tell people about an error of a driver, in a few words."""
    if isinstance(error, OSError):
        number = error.args[0] if error.args else 0
        return _REASONS.get(number) or "bus error %s" % number
    return str(error)
