"""``machine.I2C`` that frees a bus which got stuck.

A sensor that was interrupted within a byte, by a reset of the board or by noise, waits for the rest
of it and holds the data line for ever. Clocks made by hand let it finish.
"""

import errno
from time import sleep_us  # type: ignore[attr-defined]

from machine import I2C, Pin  # type: ignore[import-not-found]

try:
    from typing import Any, Final
except ImportError:
    pass

# After these the bus may be held. A port that tells no more than EPERM may mean anything.
_HELD: Final = (errno.ETIMEDOUT, errno.EPERM)
_CLOCKS: Final = 9  # a byte and its acknowledgement
_HALF_US: Final = 5


class Bus:
    """I2C channel ``number``, whose clock is the pin ``scl``. Errors are those of ``machine.I2C``.
    Where a channel has no pins of its own, as on an ESP32, ``sda`` is its other one.

    Transfers end after ``timeout_us`` where the port lets that be chosen; renesas-ra always
    takes 1 s. Raises ValueError where the board has no such channel.
    """

    def __init__(
        self,
        number: int,
        scl: "str | int",
        frequency: int = 100000,
        timeout_us: int = 100000,
        sda: "str | int | None" = None,
    ) -> None:
        self.recovered = 0  # times that the bus was freed after a transfer
        self._number = number
        self._scl = scl
        self._sda = sda
        self._frequency = frequency
        self._timeout_us = timeout_us
        self._open()

    def writeto(self, address: int, buf: "bytes | bytearray") -> None:
        try:
            self._i2c.writeto(address, buf)
        except OSError as error:
            self._free(error)
            raise

    def readfrom_into(self, address: int, buf: bytearray) -> None:
        try:
            self._i2c.readfrom_into(address, buf)
        except OSError as error:
            self._free(error)
            raise

    def _free(self, error: OSError) -> None:
        if error.args and error.args[0] in _HELD:
            self.recovered += 1
            self._open()

    def _open(self) -> None:
        """Clocks by hand, then the controller, which takes its pins back."""
        scl = Pin(self._scl, Pin.OPEN_DRAIN, value=1)
        for _ in range(_CLOCKS):
            scl.value(0)
            sleep_us(_HALF_US)
            scl.value(1)
            sleep_us(_HALF_US)
        options: "dict[str, Any]" = {"freq": self._frequency, "timeout": self._timeout_us}
        if self._sda is not None:
            options["scl"], options["sda"] = Pin(self._scl), Pin(self._sda)
        try:
            self._i2c = I2C(self._number, **options)
        except TypeError:  # renesas-ra lets no time be chosen
            del options["timeout"]
            self._i2c = I2C(self._number, **options)
