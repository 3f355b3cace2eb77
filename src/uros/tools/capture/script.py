"""Makes a replay script of a capture: what its boards send, and what the agent answered.

Messages are split into submessages, because an agent may bundle them as it likes. An answer belongs
to a list, and within each list the order counts:

* STATUS_AGENT, STATUS, INFO and TIMESTAMP_REPLY, one list for each client and stream;
* DATA, one list for each client and object, whichever stream carries it. Fragments are
  reassembled first.

Not compared: acknowledgements and heartbeats, sequence numbers, duplicates, the agent's clock in
TIMESTAMP_REPLY, other submessages on best-effort streams, and the identity of a service's caller
(which is kept, because it tells two calls apart).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from ...wire import ids
from ...wire.data import REQUEST_SIZE, SAMPLE_IDENTITY_SIZE
from ...wire.errors import DecodeError
from ...wire.header import pull_header, pull_subheader
from ...wire.streams import Fragments, ReliableIn
from .records import Record, create_client_payload

_ACKNOWLEDGEMENTS: Final = (ids.ACKNACK, ids.HEARTBEAT)
_OUTSIDE: Final = (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY)
_CLOCKS: Final = 16  # octets of the agent's clock at the beginning of a TIMESTAMP_REPLY

Submessage = tuple[int, int, bytes]
List = tuple[str, int]  # "stream" or "data", and which


class Answer(NamedTuple):
    """One submessage of the agent.

    Attributes:
        client: The client's number in the capture.
        list: The list that the answer belongs to.
        kind: The submessage's id.
        flags: The submessage's flags.
        payload: Its payload, with zeros for what differs each time.
        identity: The sample identity of a service's caller, or nothing.
    """

    client: int
    list: List
    kind: int
    flags: int
    payload: bytes
    identity: bytes

    @property
    def same(self) -> tuple[int, int, bytes]:
        """The fields that must be as recorded."""
        return self.kind, self.flags, self.payload

    def __str__(self) -> str:
        from ...agent.observability.format import parse_message

        size = len(self.payload).to_bytes(4, "little")[:2]
        message = b"\x81\0\0\0" + bytes((self.kind, self.flags)) + size + self.payload
        return str(parse_message(message)).removeprefix("0x81: ")


class Step(NamedTuple):
    """One message of a board. ``time`` is in seconds since the first message."""

    time: float
    client: int
    message: bytes
    stream: int


class Script(NamedTuple):
    """What to send and to expect.

    Attributes:
        turns: Steps and answers in their order.
        names: Transport and address of each client.
        left_out: Why a client cannot be played.
    """

    turns: list[Step | Answer]
    names: dict[int, str]
    left_out: dict[int, str]


def submessages(message: bytes, at: int) -> list[Submessage]:
    """Return ``(kind, flags, payload)`` of each submessage from ``at`` on.

    Raises:
        DecodeError: The message is malformed.
    """
    out = []
    while at + 4 <= len(message):
        kind, flags, start, stop = pull_subheader(message, at, len(message))
        out.append((kind, flags, message[start:stop]))
        at = stop + (-stop & 3)
    return out


def only_acknowledges(parts: list[Submessage]) -> bool:
    """Return whether a message holds nothing but ACKNACK and HEARTBEAT."""
    return all(kind in _ACKNOWLEDGEMENTS for kind, _, _ in parts)


class AnswerReader:
    """Makes answers of the agent's messages to one client."""

    def __init__(self, client: int, data: bool) -> None:
        self._client = client
        self._data = data
        self.reliable: dict[int, ReliableIn] = {}
        self._fragments: dict[int, Fragments] = {}

    def reset(self) -> None:
        """Forget all streams: a new session begins."""
        self.reliable.clear()
        self._fragments.clear()

    def read(self, message: bytes) -> list[Answer]:
        """Return the answers that a message completes.

        Raises:
            DecodeError: The message is malformed.
        """
        _, stream, number, _, at = pull_header(message, len(message))
        out: list[Answer] = []
        if stream < ids.STREAM_RELIABLE:
            self._take(stream, submessages(message, at), out)
            return out
        incoming = self.reliable.setdefault(stream, ReliableIn())
        if 0x8000 > (number - incoming.next) & 0xFFFF >= incoming.depth:
            incoming.restart(number, number)  # the messages between were not captured
        if incoming.receive(number, message[at:]):
            self._take(stream, submessages(message, at), out)
            self._take_early(stream, out)
        return out

    def _take_early(self, stream: int, out: list[Answer]) -> None:
        """Take the messages that came early and are next in order now."""
        while (body := self.reliable[stream].pop()) is not None:
            self._take(stream, submessages(body, 0), out)

    def _take(self, stream: int, parts: list[Submessage], out: list[Answer]) -> None:
        for kind, flags, payload in parts:
            if kind == ids.FRAGMENT:
                fragments = self._fragments.setdefault(stream, Fragments())
                whole = fragments.add(payload, bool(flags & ids.FLAG_LAST_FRAGMENT))
                if whole is not None and len(whole) >= 4:
                    out.extend(self._answer(stream, whole[0], whole[1], bytes(whole[4:])))
            else:
                out.extend(self._answer(stream, kind, flags, payload))

    def _answer(self, stream: int, kind: int, flags: int, payload: bytes) -> Iterator[Answer]:
        identity = b""
        if kind == ids.DATA and len(payload) >= REQUEST_SIZE:
            if not self._data:
                return
            which: List = ("data", int.from_bytes(payload[2:4], "big"))
            stop = REQUEST_SIZE + SAMPLE_IDENTITY_SIZE
            if payload[3] & 0x0F == ids.KIND_REPLIER and len(payload) >= stop:
                identity = payload[REQUEST_SIZE:stop]
                payload = payload[:REQUEST_SIZE] + bytes(SAMPLE_IDENTITY_SIZE) + payload[stop:]
        elif kind in _ACKNOWLEDGEMENTS or 0 < stream < ids.STREAM_RELIABLE:
            return
        else:
            which = ("stream", stream)
            if kind == ids.TIMESTAMP_REPLY:
                payload = bytes(min(_CLOCKS, len(payload))) + payload[_CLOCKS:]
        yield Answer(self._client, which, kind, flags, payload, identity)


class _StepReader:
    """Puts one client's messages in order and drops duplicates."""

    def __init__(self) -> None:
        self._reliable: dict[int, ReliableIn] = {}

    def messages(self, message: bytes) -> list[tuple[int, bytes]]:
        """Return ``(stream, message)`` of all that a recorded message lets us send."""
        try:
            _, stream, number, _, at = pull_header(message, len(message))
            parts = submessages(message, at)
        except DecodeError:
            return [(ids.STREAM_NONE, message)]  # malformed messages are played too
        if only_acknowledges(parts):
            return []
        if any(kind in (ids.CREATE_CLIENT, ids.RESET) for kind, _, _ in parts):
            self._reliable.clear()
        if stream < ids.STREAM_RELIABLE:
            return [(stream, message)]
        incoming = self._reliable.setdefault(stream, ReliableIn())
        if 0x8000 > (number - incoming.next) & 0xFFFF >= incoming.depth:
            incoming.restart(number, number)
        if not incoming.receive(number, message):
            return []
        out = [(stream, message)]
        while (early := incoming.pop()) is not None:
            out.append((stream, early))
        return out


def script(records: Iterable[Record], data: bool = True) -> Script:
    """Make the script of a capture.

    Args:
        records: The capture's messages in their order.
        data: Whether the agent's samples are compared.
    """
    turns: list[Step | Answer] = []
    names: dict[int, str] = {}
    left_out: dict[int, str] = {}
    steps: dict[int, _StepReader] = {}
    answers: dict[int, AnswerReader] = {}
    first: float | None = None
    for record in records:
        client, message = record.client, record.message
        if client not in names:
            names[client] = f"{record.transport} {record.address}"
            if not record.from_client or not message or message[0] not in _OUTSIDE:
                left_out[client] = "its session began before the capture"
            steps[client], answers[client] = _StepReader(), AnswerReader(client, data)
        if client in left_out and record.from_client and create_client_payload(message) is not None:
            del left_out[client]  # from here on it can be played
        if client in left_out:
            continue
        if first is None:
            first = record.time
        if not record.from_client:
            try:
                turns.extend(answers[client].read(message))
            except DecodeError:
                pass  # malformed: nothing to compare
            continue
        if create_client_payload(message) is not None:
            answers[client].reset()
        for stream, sent in steps[client].messages(message):
            turns.append(Step(max(0.0, record.time - first), client, sent, stream))
    return Script(turns, names, left_out)
