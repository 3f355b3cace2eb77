"""The serial port towards the host."""

try:
    from typing import Any, Final
except ImportError:
    pass

# Used where MicroPython cannot define USB devices: a UART that is not its console.
_UART: Final = 7
_BAUD: Final = 115200


def open_port(vendor: int, product: int, manufacturer: str, name: str, serial: str) -> "Any":
    """Return a USB port with these identifiers, or UART 7.

    Its ``read(n)`` and ``write(b)`` do not wait.
    """
    try:
        from .usb_cdc import UsbSerial

        return UsbSerial(vendor, product, manufacturer, name, serial)
    except (ImportError, AttributeError):  # no usb-device-cdc, or no machine.USBDevice
        from machine import UART  # type: ignore[import-not-found]

        return UART(_UART, _BAUD, timeout=0, rxbuf=2048)
