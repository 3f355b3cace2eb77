"""Reads pcapng files: those of ``uros agent --capture``, and those of Wireshark or tcpdump.

In the agent's files the comments of packets hold transport, address and key. In others the messages
are the UDP datagrams to and from port 8888, and every port that a client opened a session at.
"""

from __future__ import annotations

import ipaddress
import re
import struct
from typing import Final

from ...agent.transports.base import DEFAULT_PORT
from ...wire import ids
from .records import ClientNumbers, Record, RecordingError, create_client_payload

# Attack: a block of four gigabytes. A packet of 64 kB with its comment is far below.
MAX_BLOCK: Final = 4 * 1024 * 1024
MAX_INTERFACES: Final = 65536
_SECTION, _INTERFACE, _SIMPLE, _PACKET = 0x0A0D0D0A, 1, 3, 6
_END, _COMMENT, _FLAGS, _DROPPED, _RESOLUTION = 0, 1, 2, 4, 9
_UDP: Final = 17
# How far into a packet its IP header is, by link type; of Ethernet, behind its type.
_RAW, _ETHERNET, _COOKED, _COOKED_2, _LOOPBACK = 101, 1, 113, 276, 0
_COMMENT_FORM = re.compile(
    r"(\S+) (.+?)(?: key 0x([0-9A-F]{8}))?(?: \(cut, of \d+ bytes\))?", re.ASCII
)

_Endpoint = tuple[bytes, int]  # IP address and UDP port


class PcapngParser:
    """Parses pcapng. See :class:`.records.Parser`."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._bytes = bytearray()
        self._at = 0  # in the file
        self._order = "<"
        self._begun = False
        self._interfaces: list[tuple[int, int]] = []  # link type, ticks a second
        self._clients = ClientNumbers()
        self._agents: set[_Endpoint] = set()

    def rest(self) -> int:
        """See :class:`.records.Parser`."""
        return len(self._bytes)

    def feed(self, data: bytes) -> list[Record]:
        """See :class:`.records.Parser`."""
        self._bytes += data
        out: list[Record] = []
        at = 0
        view = bytes(self._bytes)
        while len(view) - at >= 12:
            size = self._size(view, at)
            if len(view) - at < size:
                break
            try:
                record = self._block(view[at : at + size])
            except (struct.error, IndexError, ValueError) as error:
                if isinstance(error, RecordingError):
                    raise
                raise self._error(f"a damaged block ({error})") from error
            if record is not None:
                out.append(record)
            at += size
            self._at += size
        del self._bytes[:at]
        return out

    def _error(self, what: str) -> RecordingError:
        return RecordingError(f"{self._name} is not a sound pcapng file: {what} at byte {self._at}")

    def _size(self, view: bytes, at: int) -> int:
        """Return the length of the block at ``at``, of which at least 12 bytes have come."""
        if view[at : at + 4] == b"\x0a\x0d\x0d\x0a":
            magic = view[at + 8 : at + 12]
            if magic not in (b"\x4d\x3c\x2b\x1a", b"\x1a\x2b\x3c\x4d"):
                raise self._error("a section without its magic number")
            self._order = "<" if magic[0] == 0x4D else ">"
            self._begun = True
        elif not self._begun:
            raise self._error("no section header")
        size: int = struct.unpack_from(f"{self._order}I", view, at + 4)[0]
        if size < 12 or size % 4 or size > MAX_BLOCK:
            raise self._error(f"a block of {size} bytes")
        return size

    def _unpack(self, form: str, data: bytes, at: int = 0) -> tuple[int, ...]:
        return struct.unpack_from(self._order + form, data, at)

    def _block(self, block: bytes) -> Record | None:
        kind = self._unpack("I", block)[0]
        body = block[8:-4]
        if kind == _SECTION:
            self._interfaces.clear()
        elif kind == _INTERFACE:
            if len(self._interfaces) >= MAX_INTERFACES:
                raise self._error("too many interfaces")
            options = dict(self._options(body[8:]))
            resolution = options.get(_RESOLUTION, b"\x06")[0]
            base, power = (2, resolution & 0x7F) if resolution & 0x80 else (10, resolution)
            if power > 30:
                raise self._error(f"a clock of {base}^{power} Hz")
            self._interfaces.append((self._unpack("H", body)[0], base**power))
        elif kind == _PACKET:
            return self._packet(body)
        return None

    def _options(self, data: bytes) -> list[tuple[int, bytes]]:
        out = []
        at = 0
        while at + 4 <= len(data):
            code, size = self._unpack("HH", data, at)
            if code == _END:
                break
            out.append((code, data[at + 4 : at + 4 + size]))
            at += 4 + size + (-size & 3)
        return out

    def _packet(self, body: bytes) -> Record | None:
        number, high, low, size, _ = self._unpack("IIIII", body)
        if number >= len(self._interfaces) or 20 + size > len(body):
            raise self._error("a packet without its interface, or cut off")
        link, hertz = self._interfaces[number]
        time = (high << 32 | low) / hertz
        options = dict(self._options(body[20 + size + (-size & 3) :]))
        found = _datagram(link, body[20 : 20 + size])
        if found is None:
            return None
        source, destination, message = found
        flags = options.get(_FLAGS, b"")
        way = self._unpack("I", flags)[0] & 3 if len(flags) == 4 else 0
        comment = _COMMENT_FORM.fullmatch(options.get(_COMMENT, b"").decode("utf-8", "replace"))
        if link == _RAW and comment and way in (1, 2):
            client_at = comment[1], comment[2]
            key = int(comment[3] or "0", 16)
            dropped = options.get(_DROPPED, b"")
            lost = self._unpack("Q", dropped)[0] if len(dropped) == 8 else 0
            client = self._clients.number(*client_at)
            return Record(time, way == 1, client, *client_at, key, message, lost)
        return self._foreign(time, source, destination, message)

    def _foreign(
        self, time: float, source: _Endpoint, destination: _Endpoint, message: bytes
    ) -> Record | None:
        """Return the message of another tool's packet, if it goes to an agent or comes from one."""
        payload = create_client_payload(message) or b""
        if payload[:4] == ids.COOKIE and len(self._agents) < MAX_INTERFACES:
            self._agents.add(destination)
        from_client = destination in self._agents or destination[1] == DEFAULT_PORT
        if not from_client and source not in self._agents and source[1] != DEFAULT_PORT:
            return None
        host, port = source if from_client else destination
        ip = ipaddress.ip_address(host)
        address = f"[{ip}]:{port}" if ip.version == 6 else f"{ip}:{port}"
        client = self._clients.number("UDP", address)
        return Record(time, from_client, client, "UDP", address, 0, message)


def _datagram(link: int, packet: bytes) -> tuple[_Endpoint, _Endpoint, bytes] | None:
    """Return ``(source, destination, payload)`` of a whole UDP datagram, or None."""
    at = {_RAW: 0, _ETHERNET: 14, _COOKED: 16, _COOKED_2: 20, _LOOPBACK: 4}.get(link)
    if at is None:
        return None
    if link == _ETHERNET and packet[12:14] == b"\x81\x00":
        at += 4
    ip = packet[at:]
    version = ip[0] >> 4 if ip else 0
    if version == 4 and len(ip) >= 20:
        start = (ip[0] & 0x0F) * 4
        fragment = int.from_bytes(ip[6:8], "big") & 0x3FFF
        protocol, addresses, size = ip[9], ip[12:20], 4
        if fragment:
            return None
    elif version == 6 and len(ip) >= 40:
        start, protocol, addresses, size = 40, ip[6], ip[8:40], 16
    else:
        return None
    udp = ip[start:]
    if protocol != _UDP or len(udp) < 8:
        return None
    source, destination, length = struct.unpack_from(">HHH", udp)
    if not 8 <= length <= len(udp):
        return None
    return (addresses[:size], source), (addresses[size:], destination), udp[8:length]
