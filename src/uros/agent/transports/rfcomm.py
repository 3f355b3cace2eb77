"""Bluetooth at the agent's end: RFCOMM, the serial line of classic Bluetooth.

Most boards (an ESP32's BluetoothSerial, an HC-05) accept a connection: :class:`RfcommServer`. A
board that connects by itself needs :class:`RfcommListener`; the agent registers no service record,
so the channel must be configured on such a board. A channel that the system has bound to a device,
``/dev/rfcomm0``, is a serial device.
"""

from __future__ import annotations

import errno
import re
import socket
from collections.abc import Callable
from typing import Any, Final

from .base import TransportError
from .remedies import bluetooth_trouble
from .sockets import SocketLineServer, StreamListener

MAX_CHANNEL: Final = 30
_ANY: Final = "00:00:00:00:00:00"
_ADDRESS: Final = re.compile("[0-9A-F]{2}(:[0-9A-F]{2}){5}")


def check_address(address: str) -> str:
    """Return a Bluetooth address in capitals; raises TransportError if it is invalid."""
    address = address.upper().replace("-", ":")
    if not _ADDRESS.fullmatch(address):
        raise TransportError(
            errno.EINVAL, f"{address} is not a Bluetooth address: it looks like AA:BB:CC:DD:EE:FF"
            " (see: bluetoothctl devices)"
        )  # fmt: skip
    return address


def check_channel(channel: int) -> int:
    """Return ``channel``; raises TransportError if RFCOMM has no such channel."""
    if not 1 <= channel <= MAX_CHANNEL:
        raise TransportError(
            errno.EINVAL, f"channel {channel} does not exist: 1 to {MAX_CHANNEL}"
            " (a board's: sdptool browse ADDRESS; mostly 1)"
        )  # fmt: skip
    return channel


def bluetooth_socket() -> Callable[[], socket.socket]:
    """Return a function that makes RFCOMM sockets; raises TransportError without Bluetooth."""
    family: Any = getattr(socket, "AF_BLUETOOTH", None)
    protocol: Any = getattr(socket, "BTPROTO_RFCOMM", None)
    if family is None or protocol is None:
        raise TransportError(
            errno.EAFNOSUPPORT,
            "this Python was built without Bluetooth: use the system's (/usr/bin/python3), or"
            " bind the board to a device (sudo rfcomm bind 0 ADDRESS CHANNEL) and run the"
            " agent with: serial --dev /dev/rfcomm0",
        )
    return lambda: socket.socket(family, socket.SOCK_STREAM, protocol)


class RfcommServer(SocketLineServer):
    """Connects to the board at ``address``, again and again while it is out of reach.

    Args:
        address: The board's Bluetooth address.
        channel: Its RFCOMM channel.
        make: Makes the sockets, for tests.

    Raises:
        TransportError: The address or channel is invalid, or this Python has no Bluetooth.
    """

    name = "RfcommAgent"
    kind = "RFCOMM"

    def __init__(
        self, address: str, channel: int = 1, make: Callable[[], socket.socket] | None = None
    ) -> None:
        address, channel = check_address(address), check_channel(channel)
        super().__init__(
            f"{address}/{channel}", make or bluetooth_socket(), (address, channel),
            bluetooth_trouble,
        )  # fmt: skip


class RfcommListener(StreamListener):
    """Accepts boards that connect to a channel of an adapter (any, by default).

    See :class:`RfcommServer`.
    """

    name = "RfcommAgent"
    kind = "RFCOMM"

    def __init__(
        self, channel: int = 1, adapter: str = _ANY,
        make: Callable[[], socket.socket] | None = None,
    ) -> None:  # fmt: skip
        adapter, channel = check_address(adapter), check_channel(channel)
        super().__init__(
            f"channel: {channel}", make or bluetooth_socket(), (adapter, channel), _name_of,
            bluetooth_trouble,
        )  # fmt: skip


def _name_of(address: Any) -> str:
    return str(address[0])
