"""A capture as a play: what its boards say, and what the agent answered.

Messages are taken apart into submessages, because how an agent bundles them is its own matter. An
answer belongs to a list, and of each list the order counts:

* STATUS_AGENT, STATUS, INFO and TIMESTAMP_REPLY, one list for each client and stream;
* DATA, one list for each client and object, whichever stream carries it. Fragments are put
  together before.

Not compared: acknowledgements and heartbeats, the numbers of messages, what comes twice, the
agent's clock in TIMESTAMP_REPLY, whatever else comes on best-effort streams, and who calls a
service (two calls are told apart by it; that is kept).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from ...wire import ids
from ...wire.data import REQUEST_SIZE, SAMPLE_IDENTITY_SIZE
from ...wire.errors import DecodeError
from ...wire.header import pull_header, pull_subheader
from ...wire.streams import Fragments, ReliableIn
from .recordings import Record, opening

_OWN_MATTERS: Final = (ids.ACKNACK, ids.HEARTBEAT)
_OUTSIDE: Final = (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY)
_CLOCKS: Final = 16  # of the agent, at the beginning of a TIMESTAMP_REPLY

Submessage = tuple[int, int, bytes]
List = tuple[str, int]  # "stream" or "data", and which


class Answer(NamedTuple):
    """One submessage of the agent. What cannot be the same twice is zero in ``payload``;
    ``identity`` is the caller of a service.
    """

    client: int
    list: List
    kind: int
    flags: int
    payload: bytes
    identity: bytes

    @property
    def same(self) -> tuple[int, int, bytes]:
        """What must be as recorded."""
        return self.kind, self.flags, self.payload

    def __str__(self) -> str:
        from ...agent.observability.format import take_apart

        size = len(self.payload).to_bytes(4, "little")[:2]
        message = b"\x81\0\0\0" + bytes((self.kind, self.flags)) + size + self.payload
        return str(take_apart(message)).removeprefix("0x81: ")


class Step(NamedTuple):
    """One message of a board; ``time`` is in seconds since the first."""

    time: float
    client: int
    message: bytes
    stream: int


class Script(NamedTuple):
    """Steps and answers in their order; by client, what is known of it, and why not it plays."""

    turns: list[Step | Answer]
    names: dict[int, str]
    left_out: dict[int, str]


def submessages(message: bytes, at: int) -> list[Submessage]:
    """``(kind, flags, payload)`` of each from ``at`` on. Raises DecodeError."""
    out = []
    while at + 4 <= len(message):
        kind, flags, start, stop = pull_subheader(message, at, len(message))
        out.append((kind, flags, message[start:stop]))
        at = stop + (-stop & 3)
    return out


def is_own_matter(parts: list[Submessage]) -> bool:
    """Whether a message only acknowledges."""
    return all(kind in _OWN_MATTERS for kind, _, _ in parts)


class Hearing:
    """The agent's messages to one client, made into answers."""

    def __init__(self, client: int, data: bool) -> None:
        self._client = client
        self._data = data
        self.reliable: dict[int, ReliableIn] = {}
        self._fragments: dict[int, Fragments] = {}

    def reset(self) -> None:
        """A session begins anew, and its streams."""
        self.reliable.clear()
        self._fragments.clear()

    def answers(self, message: bytes) -> list[Answer]:
        """Those that have become whole by a message. Raises DecodeError."""
        _, stream, number, _, at = pull_header(message, len(message))
        out: list[Answer] = []
        if stream < ids.STREAM_RELIABLE:
            self._take(stream, submessages(message, at), out)
            return out
        incoming = self.reliable.setdefault(stream, ReliableIn())
        if 0x8000 > (number - incoming.next) & 0xFFFF >= incoming.depth:
            incoming.restart(number, number)  # what is between was not captured
        if incoming.receive(number, message[at:]):
            self._take(stream, submessages(message, at), out)
            self.catch_up(stream, out)
        return out

    def catch_up(self, stream: int, out: list[Answer]) -> None:
        """Take what came early and is the next one now."""
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
        elif kind in _OWN_MATTERS or 0 < stream < ids.STREAM_RELIABLE:
            return
        else:
            which = ("stream", stream)
            if kind == ids.TIMESTAMP_REPLY:
                payload = bytes(min(_CLOCKS, len(payload))) + payload[_CLOCKS:]
        yield Answer(self._client, which, kind, flags, payload, identity)


class _Speaking:
    """One client's messages, made into steps: each once and in order."""

    def __init__(self) -> None:
        self._reliable: dict[int, ReliableIn] = {}

    def messages(self, message: bytes) -> list[tuple[int, bytes]]:
        """``(stream, message)`` of what is to be sent for a recorded message."""
        try:
            _, stream, number, _, at = pull_header(message, len(message))
            parts = submessages(message, at)
        except DecodeError:
            return [(ids.STREAM_NONE, message)]  # nonsense is played too
        if is_own_matter(parts):
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
    """The play of a capture; without ``data``, samples are not asked for."""
    turns: list[Step | Answer] = []
    names: dict[int, str] = {}
    left_out: dict[int, str] = {}
    speaking: dict[int, _Speaking] = {}
    hearing: dict[int, Hearing] = {}
    first: float | None = None
    for record in records:
        client, message = record.client, record.message
        if client not in names:
            names[client] = f"{record.transport} {record.address}"
            if not record.from_client or not message or message[0] not in _OUTSIDE:
                left_out[client] = "its session began before the capture did"
            speaking[client], hearing[client] = _Speaking(), Hearing(client, data)
        if client in left_out and record.from_client and opening(message) is not None:
            del left_out[client]  # from here on it can be played
        if client in left_out:
            continue
        if first is None:
            first = record.time
        if not record.from_client:
            try:
                turns.extend(hearing[client].answers(message))
            except DecodeError:
                pass  # the agent's own nonsense: nobody can wait for it
            continue
        if opening(message) is not None:
            hearing[client].reset()
        for stream, said in speaking[client].messages(message):
            turns.append(Step(max(0.0, record.time - first), client, said, stream))
    return Script(turns, names, left_out)
