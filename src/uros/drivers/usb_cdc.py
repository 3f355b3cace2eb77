"""A USB CDC-ACM serial port, by micropython-lib's ``usb-device-cdc``.

Reading and writing never wait. While the host has not configured the board, `open`, `read` and
`write` raise OSError (ENODEV), so that a program notices a pulled cable. A suspended bus raises
nothing.
"""

import errno
import select

import usb.device  # type: ignore[import-not-found]
from usb.device.cdc import CDCInterface  # type: ignore[import-not-found]

try:
    from typing import Any, Final
except ImportError:
    pass

_TX: Final = 512
_RX: Final = 2048
_INTERRUPT_IN: Final = 0x83
_OUT: Final = 0x01
_IN: Final = 0x82

# Behind the configuration descriptor's 9 bytes: the two interfaces of a CDC-ACM, without an
# interface association. USB 2.0, 9.6.5 and 9.6.6; CDC 1.20, 5.2.3; PSTN 1.20, 5.3.
_INTERFACES: Final = (
    b"\x09\x04\x00\x00\x01\x02\x02\x01\x00"  # control: abstract control model, AT commands
    b"\x05\x24\x00\x10\x01"  # CDC 1.10
    b"\x05\x24\x01\x00\x01"  # no call management
    b"\x04\x24\x02\x02"  # line coding and line state
    b"\x05\x24\x06\x00\x01"  # interfaces 0 and 1 belong together
    b"\x07\x05\x83\x03\x10\x00\xff"  # interrupt in, 16 bytes, every 255 ms
    b"\x09\x04\x01\x00\x02\x0a\x00\x00\x00"  # data
    b"\x07\x05\x01\x02\x40\x00\x00"  # bulk out, 64 bytes
    b"\x07\x05\x82\x02\x40\x00\x00"  # bulk in, 64 bytes
)


class UsbSerial(CDCInterface):  # type: ignore[misc]
    """The only USB device of the board, self-powered.

    ``is_open()`` tells whether the host has enumerated it. Other USB functions, such as a console,
    are switched off.
    """

    def __init__(
        self, vendor: int, product: int, manufacturer: str, name: str, serial: str
    ) -> None:
        CDCInterface.__init__(self, timeout=0, txbuf=_TX, rxbuf=_RX)
        self._configuration = bytearray()
        self._poll = select.poll()
        self._poll.register(self, select.POLLIN)
        device = usb.device.get()
        device.active(False)
        device.config(
            self,
            manufacturer_str=manufacturer,
            product_str=name,
            serial_str=serial,
            id_vendor=vendor,
            id_product=product,
            bcd_device=0x0200,
            device_class=2,
            max_power_ma=100,
        )
        # config() marks a device with a current as bus-powered: mark it as self-powered.
        self._configuration[7] |= 0x40
        device.active(True)

    def desc_cfg(self, desc: "Any", itf_num: int, ep_num: int, strs: "Any") -> None:
        """Append the interface descriptors; called by ``usb.device``."""
        self._c_itf = itf_num
        self.ep_c_in = _INTERRUPT_IN
        self.ep_d_out = _OUT
        self.ep_d_in = _IN
        desc.extend(_INTERFACES)
        self._configuration = desc.b  # None the first time, for the length alone

    def num_eps(self) -> int:
        """Return the number of endpoint numbers in use."""
        return 3

    def read(self, size: int) -> "bytes | None":
        """Return up to ``size`` received bytes; None: there are none."""
        self.open()
        return CDCInterface.read(self, size)  # type: ignore[no-any-return]

    def write(self, buf: "bytes | bytearray | memoryview") -> int:
        """Write as much as the buffer takes; return the number of bytes."""
        self.open()
        return CDCInterface.write(self, buf)  # type: ignore[no-any-return]

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is something to read, for ``timeout_ms`` at most."""
        self._poll.poll(timeout_ms)

    def open(self) -> None:
        """Raise OSError (ENODEV) while the host has not configured the board."""
        if not self.is_open():
            raise OSError(errno.ENODEV)

    def close(self) -> None:
        """Do nothing: the host keeps the port, for the next agent."""
