"""Reads captures: those of ``uros agent`` in both forms, and recordings of other agents.

A parser takes the bytes of a file as they come and returns the records that are complete::

    parser = parser_for(first_bytes, name)
    records = parser.feed(first_bytes)

A text capture has one JSON object a line for each message (see
:mod:`uros.agent.observability.jsonl`). Lines without ``transport`` are recordings of eProsima's
agents (``tests/captures``): each is a datagram, or a chunk of a serial line or a TCP stream, in
which the messages are found. :mod:`.pcapng` reads pcapng.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from ...wire import ids
from ...wire.framing import FLAG, Deframer, LengthDeframer
from .records import MAX_CLIENTS, ClientNumbers, Parser, Record, RecordingError

# Attack: a line without an end. A message of 64 kB has 131,072 digits.
MAX_LINE: Final = 1024 * 1024
_CHUNK: Final = 256 * 1024
_PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
_OLD_PCAP: Final = (
    b"\xa1\xb2\xc3\xd4",
    b"\xd4\xc3\xb2\xa1",
    b"\xa1\xb2\x3c\x4d",
    b"\x4d\x3c\xb2\xa1",
)


def parser_for(head: bytes, name: str) -> Parser:
    """Return the parser for a file that begins with ``head``.

    Raises:
        RecordingError: Such a file is not a capture.
    """
    if head.startswith(_PCAPNG):
        from .pcapng import PcapngParser

        return PcapngParser(name)
    if head.startswith(_OLD_PCAP):
        raise RecordingError(
            f"{name} is in the older format pcap: convert it with"
            f" 'editcap -F pcapng {name} new.pcapng'"
        )
    if head.lstrip()[:1] == b"{" or not head:
        return TextParser(name)
    raise RecordingError(
        f"{name} is not a capture: neither pcapng nor JSON lines; 'uros agent ... --capture FILE'"
        " writes one"
    )


def read(path: str | Path, note: Callable[[str], None] = lambda text: None) -> Iterator[Record]:
    """Yield the records of a file in their order.

    Args:
        path: The capture.
        note: Called with a warning if the end of the file is cut off.

    Raises:
        RecordingError: The file cannot be read, or is not a capture.
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
            note(f"{path}: the last {rest} bytes are not a whole message and are left out")
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error


# --- text ----------------------------------------------------------------------------


class TextParser:
    """Parses JSON lines, of ``uros agent`` or of recordings of other agents."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._line = bytearray()
        self._number = 0
        self._clients = ClientNumbers()
        self._chunks: Chunks | None = None

    def rest(self) -> int:
        """See :class:`.records.Parser`."""
        return len(self._line)

    def feed(self, data: bytes) -> list[Record]:
        """See :class:`.records.Parser`."""
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
            f"{self._name}:{self._number + ahead} is not a line of a capture: {what}"
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
                Record(time, from_client, client, self._chunks.name, f"client {client}", 0, message)
                for message in self._chunks.messages(from_client, client, data)
            ]
        source = str(transport), str(fields["address"])
        key = int(fields.get("key", "0x0"), 16)
        if not 0 <= key <= 0xFFFFFFFF:
            raise ValueError(f'"key" is {fields["key"]}')
        lost = int(fields.get("lost", 0))
        return [Record(time, from_client, self._clients.number(*source), *source, key, data, lost)]


# --- chunks of bytes -------------------------------------------------------------------


class Chunks:
    """Finds the messages in chunks of bytes. Here each chunk is a message, as with UDP."""

    name = "UDP"

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        """Return the messages that ``data`` completes, in one direction of one client.

        Raises:
            ValueError: The recording has too many clients.
        """
        return [data]


class SerialChunks(Chunks):
    """Chunks of a serial line: a message is a frame."""

    name = "SERIAL"

    def __init__(self) -> None:
        self._deframers: dict[tuple[bool, int], Deframer] = {}

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        """See :meth:`Chunks.messages`."""
        deframer = self._deframers.get((from_client, client))
        if deframer is None:
            if len(self._deframers) >= MAX_CLIENTS:
                raise ValueError(f"over {MAX_CLIENTS} clients")
            # All frames of one direction have the destination of the first.
            at = data.find(FLAG)
            address = data[at + 2] if 0 <= at < len(data) - 2 else 0 if from_client else 1
            deframer = self._deframers[from_client, client] = Deframer(address)
        return deframer.feed(data)


class TcpChunks(Chunks):
    """Chunks of a TCP stream: each message follows its length."""

    name = "TCP"

    def __init__(self) -> None:
        self._deframers: dict[tuple[bool, int], LengthDeframer] = {}

    def messages(self, from_client: bool, client: int, data: bytes) -> list[bytes]:
        """See :meth:`Chunks.messages`."""
        deframer = self._deframers.get((from_client, client))
        if deframer is None:
            if len(self._deframers) >= MAX_CLIENTS:
                raise ValueError(f"over {MAX_CLIENTS} clients")
            deframer = self._deframers[from_client, client] = LengthDeframer()
        return deframer.feed(data)


def chunks_of(first: bytes) -> Chunks:
    """Return what parses a recording's chunks. The first one begins a session or is a ping."""
    outside = (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY)
    if first[:1] == bytes((FLAG,)):
        return SerialChunks()
    if len(first) >= 3 and first[0] not in outside and first[2] in outside:
        return TcpChunks()
    return Chunks()
