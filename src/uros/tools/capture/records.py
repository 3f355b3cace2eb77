"""What every reader of captures gives: one record a message."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from ...wire import ids
from ..errors import ToolError

# Attack: conversations without end, each with its deframer.
MAX_CLIENTS: Final = 65536


class RecordingError(ToolError):
    """A file is not a capture, or is damaged. The text says where and why."""


class Record(NamedTuple):
    """One message of a capture.

    Attributes:
        time: Seconds since 1970, or since the first message.
        from_client: Whether a client sent the message.
        client: The number of the client's address, in the order of appearance.
        transport: Name of the transport, such as ``UDP``.
        address: Address of the client.
        key: The client key; 0 where the capture does not say it.
        message: The XRCE message.
        lost: How many messages before this one were not captured.
    """

    time: float
    from_client: bool
    client: int
    transport: str
    address: str
    key: int
    message: bytes
    lost: int = 0


class Parser(Protocol):
    """Parses the bytes of a capture as they come."""

    def feed(self, data: bytes) -> list[Record]:
        """Return the records that ``data`` completes.

        Raises:
            RecordingError: The bytes are not a capture.
        """

    def rest(self) -> int:
        """Return the number of bytes that do not yet make a whole record."""


class ClientNumbers:
    """Numbers the addresses of clients in the order of their appearance."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str], int] = {}

    def number(self, transport: str, address: str) -> int:
        """Return the number of an address, a new one for a new address."""
        if len(self._numbers) > MAX_CLIENTS:
            self._numbers.clear()
        return self._numbers.setdefault((transport, address), len(self._numbers))


def create_client_payload(message: bytes) -> bytes | None:
    """Return the payload of a CREATE_CLIENT from its cookie on, or None for another message.

    The payload may be cut off or wrong.
    """
    if message[:1] not in (b"\x00", b"\x80"):
        return None
    at = 4 if message[0] else 8
    return message[at + 4 :] if message[at : at + 1] == bytes((ids.CREATE_CLIENT,)) else None
