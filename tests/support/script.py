"""An I2C bus that plays a script, for drivers. Runs on CPython and on MicroPython."""

from uros.drivers import SensorError


class Script:
    """An I2C bus that expects these transfers in this order.

    A transfer is the hex of the address, ">" for a write or "<" for a read, and the hex of the
    bytes; or "!" and an errno in place of the bytes, for a transfer that fails.
    """

    def __init__(self, *transfers):
        self.transfers = list(transfers)

    def _next(self, address, kind):
        wanted = self.transfers.pop(0)
        assert wanted[:3] == f"{address:02x}{kind}", (wanted, address, kind)
        if wanted[3] == "!":
            raise OSError(int(wanted[4:]))
        return bytes.fromhex(wanted[3:])

    def writeto(self, address, buf):
        wanted = self._next(address, ">")
        assert bytes(buf) == wanted, (buf, wanted)
        return len(buf)

    def readfrom_into(self, address, buf):
        data = self._next(address, "<")
        assert len(buf) == len(data), (len(buf), data)
        buf[:] = data

    def over(self):
        assert not self.transfers, self.transfers


def raised(call):
    """The error that ``call`` must raise."""
    try:
        call()
    except (OSError, SensorError) as error:
        return error
    raise AssertionError("nothing was raised")
