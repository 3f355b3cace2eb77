"""Captured conversations, read: ours in both forms, and recordings of other agents.

A parser takes the bytes of a file as they come and gives the records that are whole::

    parser = parser_for(first_bytes, name)
    records = parser.feed(first_bytes)

Text is one JSON line a message (see :mod:`uros.agent.observability.jsonl`). Lines without
``transport`` are
recordings of eProsima's agents (``tests/captures``): a line of those is a datagram, or a chunk of
a serial line or a TCP stream, of which the messages are found. pcapng is :mod:`.recordings_pcapng`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from ...wire import ids
from ...wire.framing import FLAG, Deframer, LengthDeframer
from ..errors import ToolError

# Attack: a line without an end. A message of 64 kB has 131,072 digits.
MAX_LINE: Final = 1024 * 1024
# Attack: conversations without end, each with its deframer.
MAX_CLIENTS: Final = 65536
_CHUNK: Final = 256 * 1024
_PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
_OLD_PCAP: Final = (
    b"\xa1\xb2\xc3\xd4",
    b"\xd4\xc3\xb2\xa1",
    b"\xa1\xb2\x3c\x4d",
    b"\x4d\x3c\xb2\xa1",
)


class RecordingError(ToolError):
    """A file that is no recording; the text says where it ends to be one."""


class Record(NamedTuple):
    """One message. ``time`` is in seconds, since 1970 or since the first; ``client`` counts
    the places that clients talk from; ``key`` is 0 where the recording does not say it; ``lost``
    messages before it are not in the recording.
    """

    time: float
    from_client: bool
    client: int
    transport: str
    address: str
    key: int
    message: bytes
    lost: int = 0


def opening(message: bytes) -> bytes | None:
    """What a CREATE_CLIENT says, from its cookie on and as far as it is there, sound or not; None:
    the message is another one.
    """
    if message[:1] not in (b"\x00", b"\x80"):
        return None
    at = 4 if message[0] else 8
    return message[at + 4 :] if message[at : at + 1] == bytes((ids.CREATE_CLIENT,)) else None


class Parser(Protocol):
    """See the module. ``feed`` raises RecordingError."""

    def feed(self, data: bytes) -> list[Record]: ...

    def rest(self) -> int:
        """Bytes that are no whole record yet."""


def parser_for(head: bytes, name: str) -> Parser:
    """The parser of a file that begins with ``head``. Raises RecordingError."""
    if head.startswith(_PCAPNG):
        from .pcapng import PcapngParser

        return PcapngParser(name)
    if head.startswith(_OLD_PCAP):
        raise RecordingError(
            f"{name} is a capture in the older format of pcap: make it a pcapng with"
            f" 'editcap -F pcapng {name} new.pcapng'"
        )
    if head.lstrip()[:1] == b"{" or not head:
        return TextParser(name)
    raise RecordingError(
        f"{name} is no capture: neither pcapng nor a JSON line a message; 'uros agent ... --capture"
        " FILE' writes one"
    )


def read(path: str | Path, note: Callable[[str], None] = lambda text: None) -> Iterator[Record]:
    """The records of a file in their order. ``note`` is told where its end was cut off.

    Raises RecordingError.
    """
    parser: Parser | None = None
    try:
        with open(path, "rb") as file:
            while chunk := file.read(_CHUNK):
                if parser is None:
                    parser = parser_for(chunk, str(path))
                yield from parser.feed(chunk)
        rest = parser.rest() if parser else 0
        if rest:
            note(f"{path}: the last {rest} bytes are no whole message, and left out")
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error


# --- text ----------------------------------------------------------------------------


class TextParser:
    """JSON lines, of ours or of others."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._line = bytearray()
        self._number = 0
        self._clients = Places()
        self._chunks: Chunks | None = None

    def rest(self) -> int:
        return len(self._line)

    def feed(self, data: bytes) -> list[Record]:
        self._line += data
        out: list[Record] = []
        start = 0
        while (stop := self._line.find(b"\n", start)) >= 0:
            self._number += 1
            line = bytes(self._line[start:stop])
            if line.strip():
                out.extend(self._records(line))
            start = stop + 1
        del self._line[:start]
        if len(self._line) > MAX_LINE:
            raise self._error(f"a line of over {MAX_LINE} bytes", 1)
        return out

    def _error(self, what: str, ahead: int = 0) -> RecordingError:
        return RecordingError(
            f"{self._name}:{self._number + ahead} is no line of a capture: {what}"
        )

    def _records(self, line: bytes) -> list[Record]:
        try:
            fields = json.loads(line)
            return self._read(fields)
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            if isinstance(error, KeyError):
                raise self._error(f"it has no {error}") from error
            raise self._error(" ".join(str(error).split())[:200]) from error

    def _read(self, fields: Any) -> list[Record]:
        time = float(fields["t"])
        if not math.isfinite(time):
            raise ValueError(f'"t" is {time}')
        if fields["from"] not in ("client", "agent"):
            raise ValueError('"from" is neither client nor agent')
        from_client = fields["from"] == "client"
        data = bytes.fromhex(fields["hex"])
        transport = fields.get("transport")
        if transport is None:
            client = int(fields["client"])
            if self._chunks is None:
                self._chunks = chunks_of(data)
            return [
                Record(time, from_client, client, self._chunks.name, f"client {client}", 0, it)
                for it in self._chunks.messages(from_client, client, data)
            ]
        place = str(transport), str(fields["address"])
        key = int(fields.get("key", "0x0"), 16)
        if not 0 <= key <= 0xFFFFFFFF:
            raise ValueError(f'"key" is {fields["key"]}')
        lost = int(fields.get("lost", 0))
        return [Record(time, from_client, self._clients.number(*place), *place, key, data, lost)]


class Places:
    """Numbers the places that clients talk from, in the order of their coming."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, str], int] = {}

    def number(self, transport: str, address: str) -> int:
        if len(self._numbers) > MAX_CLIENTS:
            self._numbers.clear()
        return self._numbers.setdefault((transport, address), len(self._numbers))


# --- chunks of bytes -------------------------------------------------------------------


class Chunks:
    """Finds messages in what was read from a line: here each chunk is one."""

    name = "UDP"

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        return [data]


class SerialChunks(Chunks):
    """Frames of serial lines."""

    name = "SERIAL"

    def __init__(self) -> None:
        self._deframers: dict[tuple[bool, int], Deframer] = {}

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        found = self._deframers.get((from_client, client))
        if found is None:
            if len(self._deframers) >= MAX_CLIENTS:
                raise ValueError(f"over {MAX_CLIENTS} clients")
            # Whom the first frame is for, the others are for too.
            at = data.find(FLAG)
            address = data[at + 2] if 0 <= at < len(data) - 2 else 0 if from_client else 1
            found = self._deframers[from_client, client] = Deframer(address)
        return found.feed(data)


class TcpChunks(Chunks):
    """Messages behind their lengths."""

    name = "TCP"

    def __init__(self) -> None:
        self._deframers: dict[tuple[bool, int], LengthDeframer] = {}

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        found = self._deframers.get((from_client, client))
        if found is None:
            if len(self._deframers) >= MAX_CLIENTS:
                raise ValueError(f"over {MAX_CLIENTS} clients")
            found = self._deframers[from_client, client] = LengthDeframer()
        return found.feed(data)


def chunks_of(first: bytes) -> Chunks:
    """What the chunks of a recording are by its first, which begins a session or a ping."""
    outside = (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY)
    if first[:1] == bytes((FLAG,)):
        return SerialChunks()
    if len(first) >= 3 and first[0] not in outside and first[2] in outside:
        return TcpChunks()
    return Chunks()
