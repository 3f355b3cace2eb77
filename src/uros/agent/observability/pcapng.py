"""Captured messages as pcapng, for Wireshark and tshark.

Each transport is an interface, each message an IP packet with UDP in it (LINKTYPE_RAW), because
every tool opens that. Peers with an IP address keep it, those of TCP too; a board on a serial line,
on CAN or on a custom transport gets the made-up address 127.(interface).0.(board), and the agent
127.0.0.1. The packet's comment has the real address::

    SerialAgent /dev/ttyACM0 (1) key 0x4B0CBE99
"""

from __future__ import annotations

import ipaddress
import struct
from typing import Final

from ...addresses import own_address
from ...printable import printable
from ..objects.kinds import key_label
from ..transports.base import DEFAULT_PORT, ServerTransport
from .message_hooks import AGENT, MessageEvent

LINKTYPE_RAW: Final = 101
MAGIC: Final = b"\x0a\x0d\x0d\x0a"
# What one IPv4 packet holds besides its headers; of a longer message (TCP only) the rest is cut.
MAX_PAYLOAD: Final = 65507
# The most addresses that are cached, because messages may come from endless forged ones.
_MAX_ADDRESSES: Final = 4096

_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_END, _COMMENT, _NAME, _DESCRIPTION, _FLAGS, _DROPPED = 0, 1, 2, 3, 2, 4
_RESOLUTION, _APPLICATION = 9, 4
_INBOUND, _OUTBOUND = 1, 2

_HEAD: Final = struct.Struct("<IIIIIII")
_TAIL: Final = struct.Struct("<II")
_ZEROS: Final = bytes(4)

_Endpoint = tuple[bytes, int]


class PcapngEncoder:
    """Encodes messages as pcapng blocks."""

    def __init__(self) -> None:
        self._interfaces: dict[ServerTransport, int] = {}
        # By transport and address: the peer's endpoint and the agent's.
        self._known: dict[tuple[ServerTransport, str], tuple[_Endpoint, _Endpoint]] = {}
        self._boards: dict[ServerTransport, int] = {}
        self._begun = False

    def reset(self) -> None:
        """Begin a new file: its section header comes with the next message."""
        self._interfaces.clear()
        self._begun = False

    def encode(self, event: MessageEvent, lost: int) -> bytes:
        """Return the blocks of a message; ``lost`` messages before it were not captured."""
        out = b""
        if not self._begun:
            self._begun = True
            out = _section()
        transport = event.transport
        number = self._interfaces.get(transport)
        if number is None:
            number = self._interfaces[transport] = len(self._interfaces)
            out += _interface(transport)
        address = transport.address(event.peer)
        client, agent = self._endpoints(transport, address, number)
        sent = event.direction == AGENT
        payload = event.message[:MAX_PAYLOAD]
        comment = f"{transport.name} {printable(address)}"
        if event.key:
            comment += f" key {key_label(event.key)}"
        if len(payload) < len(event.message):
            comment += f" (cut, of {len(event.message)} bytes)"
        packet = _udp(agent, client, payload) if sent else _udp(client, agent, payload)
        options = _option(_COMMENT, comment.encode("utf-8", "replace")[:1000])
        options += _SENT if sent else _RECEIVED
        if lost:
            options += _option(_DROPPED, struct.pack("<Q", lost))
        size = len(packet)
        # Block type and length, interface, time, captured and original length of the packet; at
        # its end the end of the options, and the block length again.
        length = 28 + size + (-size & 3) + len(options) + 8
        head = _HEAD.pack(
            _PACKET, length, number, event.now >> 32, event.now & 0xFFFFFFFF, size, size
        )
        return b"".join((out, head, packet, _ZEROS[: -size & 3], options, _TAIL.pack(0, length)))

    def _endpoints(
        self, transport: ServerTransport, address: str, number: int
    ) -> tuple[_Endpoint, _Endpoint]:
        endpoints = self._known.get((transport, address))
        if endpoints is None:
            if len(self._known) >= _MAX_ADDRESSES:
                self._known.clear()
            endpoints = self._known[transport, address] = self._find(transport, address, number)
        return endpoints

    def _find(
        self, transport: ServerTransport, address: str, number: int
    ) -> tuple[_Endpoint, _Endpoint]:
        port = getattr(transport, "port", None)
        port = port if isinstance(port, int) and 0 < port <= 0xFFFF else DEFAULT_PORT
        # Behind a space, TLS has the name in the client's certificate.
        host, _, client_port = address.partition(" ")[0].rpartition(":")
        try:
            ip = ipaddress.ip_address(host.strip("[]"))
            client = ip.packed, int(client_port) & 0xFFFF
        except ValueError:
            board = self._boards[transport] = self._boards.get(transport, 0) + 1
            made_up = bytes((127, (number + 1) & 0xFF, board >> 8 & 0xFF, board & 0xFF))
            return (made_up, port), (b"\x7f\0\0\1", port)
        listens_on = getattr(transport, "listens_on", "")
        try:
            agent_ip = ipaddress.ip_address(listens_on)
            if agent_ip.version != ip.version or agent_ip.is_unspecified:
                agent_ip = ipaddress.ip_address(own_address((str(ip), client[1] or 9)) or "")
        except ValueError:
            agent_ip = ipaddress.ip_address("::1" if ip.version == 6 else "127.0.0.1")
        return client, (agent_ip.packed, port)


def _udp(source: _Endpoint, destination: _Endpoint, payload: bytes) -> bytes:
    """Return an IP packet with its checksums."""
    size = 8 + len(payload)
    addresses = source[0] + destination[0]
    head = struct.pack(">HHH", source[1], destination[1], size)
    pseudo = addresses + struct.pack(">II", size, 17) + head + b"\0\0" + payload
    head += struct.pack(">H", _checksum(pseudo) or 0xFFFF)
    if len(source[0]) == 16:
        return struct.pack(">IHBB", 6 << 28, size, 17, 64) + addresses + head + payload
    ip = bytearray(struct.pack(">BBHIBBH", 0x45, 0, 20 + size, 0, 64, 17, 0) + addresses)
    ip[10:12] = struct.pack(">H", _checksum(ip))
    return bytes(ip) + head + payload


def _checksum(data: bytes | bytearray) -> int:
    """Return the Internet checksum (RFC 1071): ones' complement of the ones' complement sum."""
    # A number modulo 2^16 - 1 is the sum of its 16-bit digits; this way C adds them up.
    total = int.from_bytes(data + b"\0" * (len(data) & 1), "big")
    return 0xFFFF - (total % 0xFFFF or 0xFFFF)


def _section() -> bytes:
    from ... import __version__

    options = _option(_APPLICATION, f"uros {__version__}".encode()) + _option(_END, b"")
    return _block(_SECTION, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1) + options)


def _interface(transport: ServerTransport) -> bytes:
    where = getattr(transport, "port", None) or getattr(transport, "device", "")
    options = _option(_NAME, transport.name.encode())
    options += _option(_DESCRIPTION, f"{transport.kind} {where}".strip().encode()[:1000])
    options += _option(_RESOLUTION, b"\x06") + _option(_END, b"")
    return _block(_INTERFACE, struct.pack("<HHI", LINKTYPE_RAW, 0, 0) + options)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + _padded(value)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size


def _padded(data: bytes) -> bytes:
    return data + _ZEROS[: -len(data) & 3]


_RECEIVED: Final = _option(_FLAGS, struct.pack("<I", _INBOUND))
_SENT: Final = _option(_FLAGS, struct.pack("<I", _OUTBOUND))
