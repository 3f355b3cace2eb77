"""Replays the clients of a recorded conversation to our agent and compares the agent's answers.

Events alone drive the replay: a client's datagram is sent, byte for byte as recorded, after every
answer recorded before it has arrived. ACKNACKs and HEARTBEATs are not answers: an agent may send
any number of them. Two values differ from the recording: the times in a TIMESTAMP_REPLY, and the
sample identity of a service request, which the requester chooses. The replay takes the identity
from our agent's request and writes it into the replies that it sends.
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
    """Our agent answers differently from the recorded one; the text shows both answers."""


@dataclass(frozen=True)
class Answer:
    """One message of an agent, ACKNACKs and HEARTBEATs excepted.

    ``identity`` is the (GUID, sequence number) of a request to a service. ``message`` has zeros in
    its place, and in the place of the agent's times.
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
                text = f"request {request}, object 0x{thing:04X}, {ids.status_name(status)}/{more}"
                parts.append(f"{name} {text} {payload[6:].hex()}".rstrip())
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
    """The Answer in a message of an agent; None for ACKNACK and HEARTBEAT."""
    if recorded.is_acknowledgement(message):
        return None
    _, stream, number, _, start = pull_header(message, len(message))
    masked, identity = bytearray(message), None
    kind, flags, payload = recorded.submessages(message)[0]
    if kind == ids.DATA and payload[3] & 0x0F == ids.KIND_REPLIER:
        at = start + 4 + data.REQUEST_SIZE
        identity = data.pull_sample_identity(message, at, len(message), bool(flags & 1))
        masked[at : at + data.SAMPLE_IDENTITY_SIZE] = bytes(data.SAMPLE_IDENTITY_SIZE)
    elif kind == ids.TIMESTAMP_REPLY:
        masked[start + 4 : start + 4 + 16] = bytes(16)  # the agent's times of sending and receiving
    return Answer(client, stream, number, bytes(masked), identity)


def load(name):
    """The records of a capture."""
    return recorded.load(CAPTURES / f"{name}.jsonl")


def messages(name, records, from_client):
    """Yield ``(client, message)`` of one side, without frames and length prefixes."""
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


def _samples_before_deletes(records):
    """The records with every DATA before its client's DELETE of the session.

    In one capture a sample crosses the DELETE on the wire; in the replay it comes first.
    """
    out = []
    deletes = {}  # client → its index in out
    for record in records:
        parts = recorded.submessages(record.data)
        kind, _, payload = parts[0]
        if record.from_client and kind == ids.DELETE and payload[2:4] == b"\xff\xfe":
            deletes[record.client] = len(out)
        if not record.from_client and kind == ids.DATA and record.client in deletes:
            out.insert(deletes[record.client], record)
        else:
            out.append(record)
    return out


class Replay:
    """One replay of a capture. ``line(client)`` returns the client's line to our agent.

    ``outside(sample)`` publishes a sample whose writer was outside of the capture. Without
    ``outside``, every DATA must result from samples that the clients themselves send.
    """

    def __init__(self, name, line, outside=None):
        self.name = name
        self.records = load(name)
        self._line = line
        self._lines = {}
        self._outside = outside
        if outside:
            self.records = _samples_before_deletes(self.records)
        self.expected = defaultdict(list)
        self.received = defaultdict(list)
        self.best_effort = []  # answers on best-effort streams; no capture has any
        self._identities = {}

    def run(self):
        """Replay the whole capture. Raises Mismatch."""
        deframers = {}
        due = defaultdict(int)  # answers recorded so far, by client and stream
        for record in self.records:
            decoded = _deframed(self.name, deframers, record)
            if record.from_client:
                self._await(due)
                self._open(record.client).send_raw(self._substitute(record))
                continue
            for reply in [answer(record.client, message) for message in decoded]:
                if reply is None:
                    continue
                if self._outside and reply.kind == ids.DATA:
                    self._await(due)
                    self._outside(recorded.submessages(reply.message)[0][2][data.REQUEST_SIZE :])
                self.expected[reply.key].append(reply)
                due[reply.key] += 1
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

    # --- receiving --------------------------------------------------------------

    def _await(self, due):
        deadline = time.monotonic() + SECONDS
        for (client, stream), count in due.items():
            if 0 < stream < ids.STREAM_RELIABLE:
                continue
            while len(self.received[client, stream]) < count:
                if not self._receive(client, deadline):
                    raise Mismatch(
                        f"{self.name}: nothing more comes of client {client}'s stream"
                        f" 0x{stream:02X}\n" + self._table((client, stream), count)
                    )

    def _receive(self, client, deadline):
        """Receive one message and compare it. False: none came in time."""
        message = self._open(client).receive(deadline)
        if message is None:
            return False
        reply = answer(client, message)
        if reply is None:
            return True
        if 0 < reply.stream < ids.STREAM_RELIABLE:
            self.best_effort.append(reply)
            return True
        got, expected = self.received[reply.key], self.expected[reply.key]
        got.append(reply)
        index = len(got) - 1
        if index < len(expected):
            self._compare(expected[index], reply)
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
        """Check that no other answer is in flight: the answer to a ping comes after all of them."""
        for client, line in self._lines.items():
            w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
            w.begin(ids.GET_INFO)
            session.push_get_info(w, 0x7777, ids.OBJECT_AGENT, ids.INFO_ACTIVITY)
            line.send(w.finish())
            key = client, ids.STREAM_NONE
            deadline = time.monotonic() + SECONDS
            while not self.received[key] or b"\x77\x77" not in self.received[key][-1].message:
                if not self._receive(client, deadline):
                    raise Mismatch(f"{self.name}: the agent does not answer a ping any more")
            self.received[key].pop()
        for key, got in self.received.items():
            if len(got) != due.get(key, 0):
                raise Mismatch(f"{self.name}: more than was recorded\n" + self._table(key, 0))

    def _table(self, key, count):
        """Both sides of a stream, from two answers before the first difference."""
        expected, got = self.expected[key], self.received[key]
        same = 0
        while same < min(len(expected), len(got)) and expected[same].message == got[same].message:
            same += 1
        lines = [f"  the first {same} answers are the same"]
        for reply in expected[max(0, same - 2) : same]:
            lines.append(f"    {reply}")
        for sign, side in (("-", expected[same : same + 3]), ("+", got[same : same + 3])):
            lines.extend(f"  {sign} {reply}" for reply in side)
            if not side:
                lines.append(f"  {sign} (nothing)")
        lines.append("  - as recorded, + ours")
        if count:
            lines.append(f"  {len(got)} of {count} came")
        return "\n".join(lines)
