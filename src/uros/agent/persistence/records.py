"""What the state file keeps of one client: its records, and what they add up to.

A record's payload is a letter, and then, where ``{}`` stands a line of JSON::

    C {}           the client: key, session id, MTU, properties, transport, address there
    O {} content   an object was created, by this representation
    D id           an object was deleted
    R {}           READ_DATA of an object; E id: it ended
    M id n         a datawriter has n readers
    L id sample    the last sample of a transient-local datawriter of depth 1
    B stream n     numbers of a best-effort stream to the client, used up at most
    T stream n ..  a message to the client on a reliable stream, number n
    N stream n     the next number of such a stream
    F stream n ..  bytes of an unfinished fragmented message from the client, from byte n on
    Z              all streams start anew

The slot has the numbers of the reliable streams: next from the client, how much of its
fragments counts; acknowledged by it, and sent to it.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any, Final

from ...wire.streams import MAX_HELD, MAX_MESSAGE
from ..session.session import MAX_STREAMS
from .journal import SLOT_SIZE, record, seal

_ID: Final = struct.Struct("<H")
_MATCHED: Final = struct.Struct("<HI")
_NUMBER: Final = struct.Struct("<BH")
_OFFSET: Final = struct.Struct("<BI")
# CRC, serial, count, key; behind it the streams from the client, then those to it.
SLOT_HEAD: Final = struct.Struct("<IIII")
SLOT_IN: Final = struct.Struct("<BBHI")  # stream, 1 in use | 2 skips fragments, next, fragments
SLOT_OUT: Final = struct.Struct("<BBHH")  # stream, 1 in use, acknowledged, sent
SLOT_IN_AT: Final = SLOT_HEAD.size
SLOT_OUT_AT: Final = SLOT_IN_AT + MAX_STREAMS * SLOT_IN.size
assert SLOT_OUT_AT + MAX_STREAMS * SLOT_OUT.size <= SLOT_SIZE

# (format, content, kind, parent, whether little-endian): what CREATE said.
Representation = tuple[int, "str | bytes", int, int, bool]
# (request id, stream, delivery control)
Reading = tuple[int, int, "tuple[int, int, int, int] | None"]


class Unsound(ValueError):
    """The records make no sense."""


@dataclass
class About:
    """A client, and where it talks from."""

    key: int
    session_id: int
    mtu: int
    transport: str
    peer: Any
    properties: list[tuple[str, str]] = field(default_factory=list)
    asleep_since: float = 0.0  # its transport is not there, in seconds since 1970; 0: it is

    def payload(self) -> bytes:
        return b"C" + json.dumps(vars(self)).encode()


def can_be_kept(peer: Any) -> bool:
    """Whether an address is the same one after a restart: numbers, texts, and None, which is
    the one board of a line.
    """
    if isinstance(peer, tuple):
        return all(can_be_kept(it) for it in peer)
    return peer is None or isinstance(peer, (int, str))


def _peer(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_peer(it) for it in value)
    if value is None or isinstance(value, (int, str)):
        return value
    raise Unsound(f"no address: {value!r}")


def object_payload(object_id: int, what: Representation) -> bytes:
    form, content, kind, parent, little = what
    text = isinstance(content, str)
    head = [object_id, form, kind, parent, little, text]
    raw = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
    return b"O" + json.dumps(head).encode() + b"\n" + raw


def reading_payload(object_id: int, what: Reading) -> bytes:
    return b"R" + json.dumps([object_id, *what]).encode()


def id_payload(letter: bytes, object_id: int) -> bytes:
    """``D`` and ``E``."""
    return letter + _ID.pack(object_id)


def matched_payload(object_id: int, readers: int) -> bytes:
    return b"M" + _MATCHED.pack(object_id, readers)


def latched_payload(object_id: int, sample: bytes) -> bytes:
    return b"L" + _ID.pack(object_id) + sample


def number_payload(letter: bytes, stream_id: int, number: int, message: bytes = b"") -> bytes:
    """``B``, ``N`` and ``T``."""
    return letter + _NUMBER.pack(stream_id, number) + message


def fragments_payload(stream_id: int, offset: int, part: bytes | bytearray) -> bytes:
    return b"F" + _OFFSET.pack(stream_id, offset) + part


@dataclass
class Outgoing:
    """A reliable stream to the client."""

    acked: int = 0
    sent: int = 0
    next: int = 0
    held: dict[int, bytes] = field(default_factory=dict)


@dataclass
class Incoming:
    """A reliable stream from the client."""

    next: int
    fragments: bytearray
    skip: bool


@dataclass
class Kept:
    """One client, as the file has it."""

    about: About | None = None
    objects: dict[int, Representation] = field(default_factory=dict)
    reads: dict[int, Reading] = field(default_factory=dict)
    matched: dict[int, int] = field(default_factory=dict)
    latched: dict[int, bytes] = field(default_factory=dict)
    best_effort: dict[int, int] = field(default_factory=dict)
    outgoing: dict[int, Outgoing] = field(default_factory=dict)
    incoming: dict[int, Incoming] = field(default_factory=dict)
    _fragments: dict[int, bytearray] = field(default_factory=dict)

    # --- reading --------------------------------------------------------------------

    @classmethod
    def of(cls, slot: bytes, records: dict[int, bytes]) -> Kept:
        """What a client's records add up to, by their numbers. Raises Unsound."""
        _, _, count, key = SLOT_HEAD.unpack_from(slot)
        kept = cls()
        for number in range(1, count + 1):
            payload = records.get(number)
            if payload is None:
                raise Unsound(f"record {number} of {count} is missing")
            try:
                kept._apply(payload)
            except Unsound:
                raise
            except (
                ValueError, TypeError, KeyError, OverflowError, struct.error, RecursionError
            ) as error:  # fmt: skip
                raise Unsound(f"record {number}: {error}") from error
        if kept.about is None or kept.about.key != key:
            raise Unsound("its first record is missing")
        kept._streams(slot)
        return kept

    def _apply(self, payload: bytes) -> None:
        letter, body = payload[:1], payload[1:]
        if letter == b"T":
            stream_id, number = _NUMBER.unpack_from(body)
            stream = self.outgoing.setdefault(stream_id, Outgoing())
            stream.held[number] = body[_NUMBER.size :]
            stream.next = (number + 1) & 0xFFFF
        elif letter == b"N":
            stream_id, number = _NUMBER.unpack(body)
            self.outgoing.setdefault(stream_id, Outgoing()).next = number
        elif letter == b"F":
            stream_id, offset = _OFFSET.unpack_from(body)
            whole = self._fragments.setdefault(stream_id, bytearray())
            if offset > len(whole) or offset + len(body) > MAX_MESSAGE + _OFFSET.size:
                raise Unsound("fragments are missing")
            del whole[offset:]
            whole += body[_OFFSET.size :]
        elif letter == b"B":
            stream_id, number = _NUMBER.unpack(body)
            self.best_effort[stream_id] = number
        elif letter == b"L":
            self.latched[_ID.unpack_from(body)[0]] = body[_ID.size :]
        elif letter == b"M":
            object_id, readers = _MATCHED.unpack(body)
            self.matched[object_id] = readers
        elif letter == b"O":
            self._created(body)
        elif letter == b"D":
            self.deleted(_ID.unpack(body)[0])
        elif letter == b"R":
            object_id, request_id, stream_id, control = json.loads(body)
            if control is not None:
                most, seconds, rate, pace = map(int, control)
                control = most, seconds, rate, pace
            self.reads[int(object_id)] = int(request_id), int(stream_id), control
        elif letter == b"E":
            self.reads.pop(_ID.unpack(body)[0], None)
        elif letter == b"Z":
            self.outgoing, self._fragments, self.best_effort = {}, {}, {}
        elif letter == b"C":
            self._client(json.loads(body))
        else:
            raise Unsound(f"a record {letter!r}")

    def _client(self, known: dict[str, Any]) -> None:
        about = About(**known)
        about.peer = _peer(about.peer)
        about.properties = [(str(name), str(value)) for name, value in about.properties]
        about.asleep_since = float(about.asleep_since)
        numbers = about.key, about.session_id, about.mtu
        if not all(isinstance(it, int) for it in numbers) or not isinstance(about.transport, str):
            raise Unsound("no client")
        if not (0 < about.key <= 0xFFFFFFFF and 0 < about.session_id <= 0xFF):
            raise Unsound("no client")
        self.about = about

    def _created(self, body: bytes) -> None:
        line, _, raw = body.partition(b"\n")
        object_id, form, kind, parent, little, text = json.loads(line)
        content = raw.decode("utf-8", "surrogateescape") if text else raw
        self.deleted(int(object_id))
        self.objects[int(object_id)] = int(form), content, int(kind), int(parent), bool(little)

    def deleted(self, object_id: int) -> None:
        """The object is no more."""
        for known in (self.objects, self.reads, self.matched, self.latched):
            known.pop(object_id, None)

    def _streams(self, slot: bytes) -> None:
        """What the slot says. Raises Unsound where messages are missing by that."""
        for at in range(SLOT_IN_AT, SLOT_OUT_AT, SLOT_IN.size):
            stream_id, used, number, pending = SLOT_IN.unpack_from(slot, at)
            if not used:
                continue
            whole = self._fragments.get(stream_id, bytearray())[:pending]
            if len(whole) < pending:
                raise Unsound("fragments are missing")
            self.incoming[stream_id] = Incoming(number, whole, bool(used & 2))
        outgoing = {}
        for index in range(MAX_STREAMS):
            stream_id, used, acked, sent = SLOT_OUT.unpack_from(
                slot, SLOT_OUT_AT + index * SLOT_OUT.size
            )
            if not used:
                continue
            stream = self.outgoing.get(stream_id, Outgoing())
            count = (stream.next - acked) & 0xFFFF
            if count > MAX_HELD or (sent - acked) & 0xFFFF > count:
                raise Unsound("its streams' numbers make no sense")
            numbers = [(acked + it) & 0xFFFF for it in range(count)]
            if any(it not in stream.held for it in numbers):
                raise Unsound("messages to it are missing")
            held = {it: stream.held[it] for it in numbers}
            outgoing[stream_id] = Outgoing(acked, sent, stream.next, held)
        self.outgoing = outgoing

    # --- writing --------------------------------------------------------------------

    def write(self, serial: int) -> tuple[bytearray, bytearray, int]:
        """``(slot, records, how many)`` of it, numbered anew."""
        assert self.about is not None
        payloads = [self.about.payload()]
        payloads += [object_payload(*it) for it in self.objects.items()]
        payloads += [reading_payload(*it) for it in self.reads.items()]
        payloads += [matched_payload(*it) for it in self.matched.items()]
        payloads += [latched_payload(*it) for it in self.latched.items()]
        payloads += [number_payload(b"B", *it) for it in self.best_effort.items()]
        slot = bytearray(SLOT_SIZE)
        for index, (stream_id, outgoing) in enumerate(self.outgoing.items()):
            payloads += [
                number_payload(b"T", stream_id, *it) for it in outgoing.held.items()
            ]
            payloads.append(number_payload(b"N", stream_id, outgoing.next))
            SLOT_OUT.pack_into(
                slot, SLOT_OUT_AT + index * SLOT_OUT.size,
                stream_id, 1, outgoing.acked, outgoing.sent,
            )  # fmt: skip
        for index, (stream_id, incoming) in enumerate(self.incoming.items()):
            if incoming.fragments:
                payloads.append(fragments_payload(stream_id, 0, incoming.fragments))
            SLOT_IN.pack_into(
                slot, SLOT_IN_AT + index * SLOT_IN.size,
                stream_id, 1 | incoming.skip << 1, incoming.next, len(incoming.fragments),
            )  # fmt: skip
        SLOT_HEAD.pack_into(slot, 0, 0, serial, len(payloads), self.about.key)
        seal(slot)
        written = bytearray()
        for number, payload in enumerate(payloads, 1):
            written += record(serial, number, payload)
        return slot, written, len(payloads)
