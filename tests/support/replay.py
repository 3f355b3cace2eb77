"""Plays the clients of a recorded conversation to our agent and compares what it answers.

Events alone drive it: a client's datagram goes out, byte for byte as recorded, when every answer
recorded before it has come. Acknowledgements and heartbeats are no answers; each agent sends them
as often as it likes. Two things cannot be as recorded: the times in a TIMESTAMP_REPLY, and the
identity by which a service knows its request, which is the asker's own. The player learns ours
from our agent and puts it into the replies it plays.
"""

import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from support import recorded
from support.lines import SECONDS
from uros.wire import data, ids, session
from uros.wire.cdr import Reader
from uros.wire.framing import Deframer, LengthDeframer
from uros.wire.header import MessageWriter, pull_header

CAPTURES = Path(__file__).parent.parent / "captures"

NAMES = {
    value: name
    for name, value in vars(ids).items()
    if name in "STATUS_AGENT STATUS INFO DATA FRAGMENT TIMESTAMP_REPLY GET_INFO RESET".split()
}


class Mismatch(AssertionError):
    """Our agent does not say what the recorded one said; the text shows both."""


@dataclass(frozen=True)
class Answer:
    """One message of an agent that is more than an acknowledgement.

    ``identity`` is the (GUID, sequence number) of a request to a service; in ``message`` it is
    zero then, as are the agent's times.
    """

    client: int
    stream: int
    number: int
    message: bytes
    identity: "tuple[bytes, int] | None" = None

    @property
    def key(self):
        return self.client, self.stream

    @property
    def kind(self):
        return recorded.submessages(self.message)[0][0]

    def __str__(self):
        parts = []
        for kind, flags, payload in recorded.submessages(self.message):
            name = NAMES.get(kind, str(kind))
            if kind in (ids.STATUS, ids.INFO):
                request, thing, status, more = session.pull_status(_reader(payload, flags))
                said = f"request {request}, object 0x{thing:04X}, {ids.status_name(status)}/{more}"
                parts.append(f"{name} {said} {payload[6:].hex()}".rstrip())
            elif kind == ids.DATA:
                request, thing = session.pull_request(_reader(payload, flags))
                parts.append(f"{name} request {request}, object 0x{thing:04X}, {payload[4:].hex()}")
            else:
                parts.append(f"{name} {payload.hex()}")
        return f"client {self.client} stream 0x{self.stream:02X} no. {self.number}: " + "; ".join(
            parts
        )


def _reader(payload, flags):
    return Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))


def answer(client, message):
    """A message of an agent as an Answer; None where it only acknowledges."""
    if recorded.is_own_matter(message):
        return None
    _, stream, number, _, start = pull_header(message, len(message))
    masked, identity = bytearray(message), None
    kind, flags, payload = recorded.submessages(message)[0]
    if kind == ids.DATA and payload[3] & 0x0F == ids.KIND_REPLIER:
        at = start + 4 + data.REQUEST_SIZE
        identity = data.pull_sample_identity(message, at, len(message), bool(flags & 1))
        masked[at : at + data.SAMPLE_IDENTITY_SIZE] = bytes(data.SAMPLE_IDENTITY_SIZE)
    elif kind == ids.TIMESTAMP_REPLY:
        masked[start + 4 : start + 4 + 16] = bytes(16)  # its clock on sending and receiving
    return Answer(client, stream, number, bytes(masked), identity)


def load(name):
    """The records of a capture."""
    return recorded.load(CAPTURES / f"{name}.jsonl")


def messages(name, records, from_client):
    """``(client, message)`` of one side, taken out of frames and length prefixes."""
    deframers = {}
    for record in records:
        if record.from_client != from_client:
            continue
        for message in _deframed(name, deframers, record):
            yield record.client, message


def _deframed(name, deframers, record):
    if not name.startswith(("serial", "tcp")):
        return [record.data]
    key = record.from_client, record.client
    if key not in deframers:
        serial = name.startswith("serial")
        address = 0 if record.from_client else 1
        deframers[key] = Deframer(address) if serial else LengthDeframer()
    return deframers[key].feed(record.data)


def _samples_before_farewells(records):
    """The same with every DATA before its client's DELETE of the session.

    In one capture a sample crosses the farewell; played again it comes before.
    """
    out = []
    farewell = {}  # client → its index in out
    for record in records:
        parts = recorded.submessages(record.data)
        kind, _, payload = parts[0]
        if record.from_client and kind == ids.DELETE and payload[2:4] == b"\xff\xfe":
            farewell[record.client] = len(out)
        if not record.from_client and kind == ids.DATA and record.client in farewell:
            out.insert(farewell[record.client], record)
        else:
            out.append(record)
    return out


class Replay:
    """One play of a capture. ``line(client)`` gives each client its line to our agent.

    ``outside(sample)`` publishes a sample that came from somewhere else when the capture was made;
    without it every DATA must come of what the clients themselves send.
    """

    def __init__(self, name, line, outside=None):
        self.name = name
        self.records = load(name)
        self._line = line
        self._lines = {}
        self._outside = outside
        if outside:
            self.records = _samples_before_farewells(self.records)
        self.expected = defaultdict(list)
        self.got = defaultdict(list)
        self.best_effort = []  # answers on best-effort streams, which no capture has
        self._identities = {}

    def run(self):
        """Play it all. Raises Mismatch."""
        deframers = {}
        due = defaultdict(int)  # answers recorded so far, by client and stream
        for record in self.records:
            found = _deframed(self.name, deframers, record)
            if record.from_client:
                self._await(due)
                self._open(record.client).send_raw(self._substitute(record))
                continue
            for it in [answer(record.client, message) for message in found]:
                if it is None:
                    continue
                if self._outside and it.kind == ids.DATA:
                    self._await(due)
                    self._outside(recorded.submessages(it.message)[0][2][data.REQUEST_SIZE :])
                self.expected[it.key].append(it)
                due[it.key] += 1
        self._await(due)
        self._finish(due)

    def _open(self, client):
        if client not in self._lines:
            self._lines[client] = self._line(client)
        return self._lines[client]

    def _substitute(self, record):
        """The record's bytes, with our agent's identity in a service's reply."""
        if self.name.startswith(("serial", "tcp")):
            return record.data
        message = bytearray(record.data)
        _, _, _, _, start = pull_header(message, len(message))
        parts = recorded.submessages(record.data)
        kind, flags, payload = parts[0]
        if kind == ids.WRITE_DATA and payload[3] & 0x0F == ids.KIND_REPLIER:
            assert len(parts) == 1 and flags & ids.FLAG_LITTLE_ENDIAN
            at = start + 4 + data.REQUEST_SIZE
            theirs = data.pull_sample_identity(message, at, len(message))
            data.push_sample_identity(message, at, *self._identities[theirs])
        return bytes(message)

    # --- what comes -------------------------------------------------------------

    def _await(self, due):
        deadline = time.monotonic() + SECONDS
        for (client, stream), count in due.items():
            if 0 < stream < ids.STREAM_RELIABLE:
                continue
            while len(self.got[client, stream]) < count:
                if not self._receive(client, deadline):
                    raise Mismatch(
                        f"{self.name}: nothing more comes of client {client}'s stream"
                        f" 0x{stream:02X}\n" + self._table((client, stream), count)
                    )

    def _receive(self, client, deadline):
        """Take and compare one message. False: none came in time."""
        message = self._open(client).receive(deadline)
        if message is None:
            return False
        it = answer(client, message)
        if it is None:
            return True
        if 0 < it.stream < ids.STREAM_RELIABLE:
            self.best_effort.append(it)
            return True
        got, expected = self.got[it.key], self.expected[it.key]
        got.append(it)
        index = len(got) - 1
        if index < len(expected):
            self._compare(expected[index], it)
        return True

    def _compare(self, expected, got):
        if expected.message != got.message:
            raise Mismatch(f"{self.name}: another answer\n" + self._table(got.key, 0))
        if expected.identity is not None:
            known = self._identities.setdefault(expected.identity, got.identity)
            same_asker = {(a[0], b[0]) for a, b in self._identities.items()}
            if (
                known != got.identity
                or len(set(self._identities.values())) < len(self._identities)
                or len(same_asker) != len({a for a, _ in same_asker})
            ):
                raise Mismatch(
                    f"{self.name}: another asker\n"
                    f"  recorded: {expected.identity}\n  ours:     {got.identity}"
                )

    def _finish(self, due):
        """See that nothing else was on its way: a ping's answer comes behind it all."""
        for client, line in self._lines.items():
            w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
            w.begin(ids.GET_INFO)
            session.push_get_info(w, 0x7777, ids.OBJECT_AGENT, ids.INFO_ACTIVITY)
            line.send(w.finish())
            key = client, ids.STREAM_NONE
            deadline = time.monotonic() + SECONDS
            while not self.got[key] or b"\x77\x77" not in self.got[key][-1].message:
                if not self._receive(client, deadline):
                    raise Mismatch(f"{self.name}: the agent does not answer a ping any more")
            self.got[key].pop()
        for key, got in self.got.items():
            if len(got) != due.get(key, 0):
                raise Mismatch(f"{self.name}: more than was recorded\n" + self._table(key, 0))

    def _table(self, key, count):
        """Both sides of a stream from just before where they part."""
        expected, got = self.expected[key], self.got[key]
        same = 0
        while same < min(len(expected), len(got)) and expected[same].message == got[same].message:
            same += 1
        lines = [f"  the first {same} answers are the same"]
        for it in expected[max(0, same - 2) : same]:
            lines.append(f"    {it}")
        for sign, side in (("-", expected[same : same + 3]), ("+", got[same : same + 3])):
            lines.extend(f"  {sign} {it}" for it in side)
            if not side:
                lines.append(f"  {sign} (nothing)")
        lines.append("  - as recorded, + ours")
        if count:
            lines.append(f"  {len(got)} of {count} came")
        return "\n".join(lines)
