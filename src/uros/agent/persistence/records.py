"""The records of one client in the state file, and the client that they describe.

A record's payload is a letter and these fields (``{}`` is a line of JSON)::

    C {}           the client: key, session id, MTU, properties, transport, address there
    O {} content   an object was created, by this representation
    D id           an object was deleted
    R {}           READ_DATA of an object began; E id: it ended
    M id n         a datawriter has n matched readers
    L id sample    the last sample of a transient-local datawriter of depth 1
    B stream n     highest sequence number reserved on a best-effort stream to the client
    T stream n ..  a message to the client on a reliable stream, sequence number n
    N stream n     the next sequence number of such a stream
    F stream n ..  bytes of an incomplete fragmented message from the client, from byte n on
    Z              all streams were reset

The slot has the state of the reliable streams. From the client: the next sequence number and the
valid length of its fragments; to the client: the numbers acknowledged and sent.
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
# CRC, serial, count, key; then the streams from the client, then those to it.
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


class DamagedRecords(ValueError):
    """The records of a client are incomplete or contradict each other."""


@dataclass
class ClientInfo:
    """A client and its address.

    Attributes:
        key: Client key.
        session_id: Session id.
        mtu: MTU in bytes.
        transport: Its transport: name and label.
        peer: Its address there.
        properties: The properties of its CREATE_CLIENT.
        asleep_since: Since when its transport is not among the agent's, in seconds since 1970;
            0 if it is.
    """

    key: int
    session_id: int
    mtu: int
    transport: str
    peer: Any
    properties: list[tuple[str, str]] = field(default_factory=list)
    asleep_since: float = 0.0

    def payload(self) -> bytes:
        """Encode the record ``C``."""
        return b"C" + json.dumps(vars(self)).encode()


def can_be_kept(peer: Any) -> bool:
    """Return whether an address stays valid after a restart: numbers, texts, and None.

    None is the one board of a serial line.
    """
    if isinstance(peer, tuple):
        return all(can_be_kept(part) for part in peer)
    return peer is None or isinstance(peer, (int, str))


def _peer(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_peer(part) for part in value)
    if value is None or isinstance(value, (int, str)):
        return value
    raise DamagedRecords(f"no address: {value!r}")


def object_payload(object_id: int, representation: Representation) -> bytes:
    """Encode the record ``O``."""
    form, content, kind, parent, little = representation
    text = isinstance(content, str)
    head = [object_id, form, kind, parent, little, text]
    raw = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
    return b"O" + json.dumps(head).encode() + b"\n" + raw


def reading_payload(object_id: int, reading: Reading) -> bytes:
    """Encode the record ``R``."""
    return b"R" + json.dumps([object_id, *reading]).encode()


def id_payload(letter: bytes, object_id: int) -> bytes:
    """Encode the records ``D`` and ``E``."""
    return letter + _ID.pack(object_id)


def matched_payload(object_id: int, readers: int) -> bytes:
    """Encode the record ``M``."""
    return b"M" + _MATCHED.pack(object_id, readers)


def latched_payload(object_id: int, sample: bytes) -> bytes:
    """Encode the record ``L``."""
    return b"L" + _ID.pack(object_id) + sample


def number_payload(letter: bytes, stream_id: int, number: int, message: bytes = b"") -> bytes:
    """Encode the records ``B``, ``N`` and ``T``."""
    return letter + _NUMBER.pack(stream_id, number) + message


def fragments_payload(stream_id: int, offset: int, part: bytes | bytearray) -> bytes:
    """Encode the record ``F``."""
    return b"F" + _OFFSET.pack(stream_id, offset) + part


@dataclass
class Outgoing:
    """State of a reliable stream to the client: sequence numbers, and the messages it holds."""

    acked: int = 0
    sent: int = 0
    next: int = 0
    held: dict[int, bytes] = field(default_factory=dict)


@dataclass
class Incoming:
    """State of a reliable stream from the client."""

    next: int
    fragments: bytearray
    skip: bool


@dataclass
class ClientRecords:
    """One client as the state file describes it.

    Attributes:
        info: The client; None before its record ``C``.
        objects: Representations by object id.
        reads: Active READ_DATA by object id.
        matched: Matched readers of datawriters, by object id.
        latched: Last samples of transient-local datawriters, by object id.
        best_effort: Reserved sequence numbers of best-effort streams to the client.
        outgoing: Reliable streams to the client.
        incoming: Reliable streams from the client.
    """

    info: ClientInfo | None = None
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
    def parse(cls, slot: bytes, records: dict[int, bytes]) -> ClientRecords:
        """Parse a client's slot and its records by their numbers; raises DamagedRecords."""
        _, _, count, key = SLOT_HEAD.unpack_from(slot)
        parsed = cls()
        for number in range(1, count + 1):
            payload = records.get(number)
            if payload is None:
                raise DamagedRecords(f"record {number} of {count} is missing")
            try:
                parsed._apply(payload)
            except DamagedRecords:
                raise
            except (
                ValueError, TypeError, KeyError, OverflowError, struct.error, RecursionError
            ) as error:  # fmt: skip
                raise DamagedRecords(f"record {number}: {error}") from error
        if parsed.info is None or parsed.info.key != key:
            raise DamagedRecords("its first record is missing")
        parsed._streams(slot)
        return parsed

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
                raise DamagedRecords("fragments are missing")
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
            raise DamagedRecords(f"a record {letter!r}")

    def _client(self, fields: dict[str, Any]) -> None:
        info = ClientInfo(**fields)
        info.peer = _peer(info.peer)
        info.properties = [(str(name), str(value)) for name, value in info.properties]
        info.asleep_since = float(info.asleep_since)
        numbers = info.key, info.session_id, info.mtu
        sound = all(isinstance(number, int) for number in numbers)
        if not sound or not isinstance(info.transport, str):
            raise DamagedRecords("no client")
        if not (0 < info.key <= 0xFFFFFFFF and 0 < info.session_id <= 0xFF):
            raise DamagedRecords("no client")
        self.info = info

    def _created(self, body: bytes) -> None:
        line, _, raw = body.partition(b"\n")
        object_id, form, kind, parent, little, text = json.loads(line)
        content = raw.decode("utf-8", "surrogateescape") if text else raw
        self.deleted(int(object_id))
        self.objects[int(object_id)] = int(form), content, int(kind), int(parent), bool(little)

    def deleted(self, object_id: int) -> None:
        """Remove an object that was deleted."""
        for records in (self.objects, self.reads, self.matched, self.latched):
            records.pop(object_id, None)

    def _streams(self, slot: bytes) -> None:
        """Apply the slot; raises DamagedRecords if messages are missing."""
        for at in range(SLOT_IN_AT, SLOT_OUT_AT, SLOT_IN.size):
            stream_id, used, number, pending = SLOT_IN.unpack_from(slot, at)
            if not used:
                continue
            whole = self._fragments.get(stream_id, bytearray())[:pending]
            if len(whole) < pending:
                raise DamagedRecords("fragments are missing")
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
                raise DamagedRecords("the sequence numbers of its streams are contradictory")
            numbers = [(acked + index) & 0xFFFF for index in range(count)]
            if any(number not in stream.held for number in numbers):
                raise DamagedRecords("messages to it are missing")
            messages = {number: stream.held[number] for number in numbers}
            outgoing[stream_id] = Outgoing(acked, sent, stream.next, messages)
        self.outgoing = outgoing

    # --- writing --------------------------------------------------------------------

    def encode(self, serial: int) -> tuple[bytearray, bytearray, int]:
        """Return the slot, the encoded records and their number, counted from 1."""
        assert self.info is not None
        payloads = [self.info.payload()]
        payloads += [object_payload(*item) for item in self.objects.items()]
        payloads += [reading_payload(*item) for item in self.reads.items()]
        payloads += [matched_payload(*item) for item in self.matched.items()]
        payloads += [latched_payload(*item) for item in self.latched.items()]
        payloads += [number_payload(b"B", *item) for item in self.best_effort.items()]
        slot = bytearray(SLOT_SIZE)
        for index, (stream_id, outgoing) in enumerate(self.outgoing.items()):
            payloads += [number_payload(b"T", stream_id, *item) for item in outgoing.held.items()]
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
        SLOT_HEAD.pack_into(slot, 0, 0, serial, len(payloads), self.info.key)
        seal(slot)
        written = bytearray()
        for number, payload in enumerate(payloads, 1):
            written += record(serial, number, payload)
        return slot, written, len(payloads)
