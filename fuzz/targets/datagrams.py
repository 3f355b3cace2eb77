"""A whole agent that receives datagrams of several clients, in any order and at any time.

The input is records; the operation is ``peer | kind << 2 | option bits``:

====  ====================================================================
kind  body
====  ====================================================================
0     a datagram, unchanged
1     submessages on the reliable stream 0x80, with its next sequence number
2     submessages on the best-effort stream 0x01
3     submessages outside of streams
4     a time, in milliseconds
5     a sample from outside of the agent; the first byte is the number of the topic
6     a submessage in fragments; the first byte is their length, in units of 4 bytes, less 1
7     none: the client's connection is gone
====  ====================================================================

With 0x20 a sequence number is skipped before the message, with 0x40 the client acknowledges all
received messages after it. Clients 1 and 2 are known by their address, 3 and 4 by their keys. A
client without a session creates one first, except for unchanged datagrams.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

from uros.agent.policy.limits import Limits
from uros.wire import ids
from uros.wire.session import push_acknack

from . import records, submessages
from .world import World, built, create_client, message, submessage

RAW, RELIABLE, BEST_EFFORT, BARE, TIME, SAMPLE, FRAGMENTS, GONE = range(8)
SKIP, POLITE = 0x20, 0x40
OPS = tuple(range(0x80))
CAPTURES = Path(__file__).resolve().parents[2] / "tests" / "captures"
# Simulated time is expensive, so an input may use this much.
_MAX_MS = 45_000


def key_of(peer: int) -> int:
    return 0x10000000 + peer


def session_id_of(peer: int) -> int:
    return 0x81 if peer < 3 else 0x01


NARROW = Limits(
    objects=12, participants=2, domains=2, types=3, representations=4096, message=16_384,
    memory=100_000,
)  # fmt: skip


class _Play:
    def __init__(self, world: World) -> None:
        self.world = world
        self.left_ms = _MAX_MS

    def session(self, peer: int):  # type: ignore[no-untyped-def]
        """The session of a peer, created where there is none."""
        world = self.world
        session = world.place.sessions.get(peer) if peer < 3 else None
        if session is None:
            client = world.agent.clients.get(key_of(peer))
            session = None if client is None else client.session
        if session is None:
            world.receive(peer, create_client(key_of(peer), session_id_of(peer)))
            client = world.agent.clients.get(key_of(peer))
            session = None if client is None else client.session
        return session

    def say(self, peer: int, stream: int, body: bytes, skip: bool) -> None:
        """Send submessages under a correct header."""
        session = self.session(peer)
        if session is None:
            return
        number = 0
        if stream >= ids.STREAM_RELIABLE:
            number = session.last_received(stream) + 1
        elif stream:
            known = session._best_effort_in.get(stream)
            number = 0 if known is None else known.last + 1
        number += 1 if skip else 0
        self.world.receive(
            peer, message(session.session_id, stream, number & 0xFFFF, session.key, body)
        )

    def acknowledge(self, peer: int) -> None:
        session = self.session(peer)
        if session is None:
            return
        for stream_id, stream in list(session._out.items()):
            for _ in range(8):  # each one may release more messages
                if stream.acked == stream.sent:
                    break
                body = submessage(ids.ACKNACK, built(push_acknack, stream.sent, 0, stream_id))
                self.say(peer, 0, body, False)

    def do(self, op: int, body: bytes) -> None:
        world = self.world
        peer, kind, skip = (op & 3) + 1, op >> 2 & 7, bool(op & SKIP)
        if kind == RAW:
            world.receive(peer, body)
        elif kind == RELIABLE:
            self.say(peer, 0x80, body, skip)
        elif kind == BEST_EFFORT:
            self.say(peer, 0x01, body, skip)
        elif kind == BARE:
            self.say(peer, 0, body, skip)
        elif kind == TIME:
            ms = min(int.from_bytes(body[:3], "little"), self.left_ms)
            self.left_ms -= ms
            world.step(ms)
        elif kind == SAMPLE:
            world.publish(body[0] if body else 0, body[1:])
        elif kind == FRAGMENTS:
            size = 4 * (1 + (body[0] if body else 0))
            parts = [body[at : at + size] for at in range(1, len(body), size)]
            for part in parts[:64]:
                flags = 1 | (ids.FLAG_LAST_FRAGMENT if part is parts[-1] else 0)
                self.say(peer, 0x80, submessage(ids.FRAGMENT, part, flags), skip)
        else:
            world.agent.gone(world.place, peer)
            world.settle()
        if op & POLITE:
            self.acknowledge(peer)


def one_input(data: bytes) -> None:
    """See the module. In the first byte, 0x80 sets the highest log level, 0x40 low limits."""
    options = data[0] if data else 0
    world = World(6 if options & 0x80 else 4, NARROW if options & 0x40 else None)
    play = _Play(world)
    for op, body in records.unpack(data[1:]):
        play.do(op, body)
        world.witness()
        world.check()
    world.close()


# --- valid inputs ---------------------------------------------------------------------


def captured() -> Iterator[tuple[str, list[records.Record]]]:
    """The client's messages of the recorded conversations over UDP."""
    for file in sorted(CAPTURES.glob("*.jsonl")):
        if file.stem.startswith(("serial_", "tcp_")):
            continue
        lines = [json.loads(line) for line in file.read_text().splitlines()]
        client_messages = [
            (line["client"] % 4, bytes.fromhex(line["hex"]))
            for line in lines
            if line["from"] == "client"
        ]
        yield file.stem, client_messages[:40]


def all_messages() -> Iterator[records.Record]:
    for _, messages in captured():
        yield from messages


def seeds() -> Iterator[tuple[str, bytes]]:
    for name, messages in captured():
        yield name, b"\0" + records.pack(messages)
    for name, messages in synthetic():
        yield name, b"\0" + records.pack(messages)


def synthetic() -> Iterator[tuple[str, list[records.Record]]]:
    """Conversations that are in no recording, by the helpers of the agent's tests."""
    from unit.agent import helpers as h

    def body(*parts) -> bytes:  # type: ignore[no-untyped-def]
        return submessages.pack([(kind, flags, payload) for kind, flags, payload in parts])

    reliable, polite = RELIABLE << 2, RELIABLE << 2 | POLITE
    sample = h.write_data(h.WRITER, b"\x07\0\0\0")
    yield "publisher", [(reliable, body(*h.publisher_entities())), (polite, body(sample, sample))]
    yield (
        "subscriber",
        [
            (polite, body(*h.subscriber_entities())),
            (polite, body(h.read_data(h.READER))),
            (SAMPLE << 2 | POLITE, b"\0\x05\0\0\0"),
            (SAMPLE << 2, b"\0" + bytes(3000)),
            (TIME << 2, (900).to_bytes(3, "little")),
            (polite, body(h.read_data(h.READER, control=(0, 0, 0, 0)))),
            (polite, body(h.delete(h.READER), h.delete(h.PARTICIPANT))),
        ],
    )
    yield (
        "limited_reader",
        [
            (polite, body(*h.subscriber_entities())),
            (polite, body(h.read_data(h.READER, control=(3, 500, 10, 5)))),
            (SAMPLE << 2 | POLITE, b"\0\x05\0\0\0"),
            (TIME << 2 | POLITE, (700).to_bytes(3, "little")),
            (TIME << 2, (31_000).to_bytes(3, "little")),
        ],
    )
    yield (
        "services",
        [
            (polite, body(h.participant(), h.service(h.REPLIER))),
            (polite, body(h.read_data(h.REPLIER))),
            (polite | 2, body(h.participant(), h.service(h.REQUESTER))),
            (polite | 2, body(h.read_data(h.REQUESTER), h.write_data(h.REQUESTER, bytes(16)))),
            (polite, body(h.write_data(h.REPLIER, bytes(32)))),
        ],
    )
    yield (
        "documents",
        [
            (polite, body(h.xml(h.TYPE, h.TYPES_XML), h.xml(h.QOS, h.QOS_XML))),
            (polite, body(h.xml(h.APPLICATION, h.APPLICATION_XML))),
            (polite, body(h.by_reference(h.oid(3, ids.KIND_DATAWRITER), "kept", h.PUBLISHER))),
            (polite, body(h.delete(h.APPLICATION))),
        ],
    )
    yield (
        "again",
        [
            (polite, body(*h.publisher_entities(flags=h.REUSE))),
            (polite, body(*h.publisher_entities(flags=h.REPLACE))),
            (polite, body(*h.publisher_entities(flags=h.REUSE | h.REPLACE))),
            (GONE << 2, b""),
            (RAW << 2, h.create_client(key_of(1))),
            (RAW << 2, h.create_client(key_of(2))),
        ],
    )
    large = h.write_data(h.WRITER, bytes(range(200)) * 8)
    yield (
        "fragments",
        [
            (polite, body(*h.publisher_entities())),
            (FRAGMENTS << 2, b"\x10" + h.whole(large)),
            (FRAGMENTS << 2 | SKIP, b"\x02" + h.whole(sample)),
            (BARE << 2, body(h.heartbeat(0, 20), h.acknack(0, 0xFFFF))),
            (reliable, body((ids.RESET, 1, b""))),
        ],
    )
    yield (
        "inspection",
        [
            (polite, body(*h.publisher_entities())),
            (polite, body(h.get_info(), h.get_info(h.WRITER), h.get_info(h.PARTICIPANT))),
            (BARE << 2, body((ids.TIMESTAMP, 1, bytes(8)))),
            (BEST_EFFORT << 2, body(sample, h.delete(ids.OBJECT_CLIENT))),
        ],
    )


_material: list[records.Record] = []
_bodies: list[bytes] = []


class Carried:
    """Mutates the records of a transport that carries messages.

    Records of ``kinds``, the low three bits of the operation, have a message of the peer in the
    high bits. Valid records to insert are ``material`` and ``messages``, (peer, message), the
    latter as records of the first kind.
    """

    def __init__(
        self,
        ops: tuple[int, ...],
        kinds: tuple[int, ...],
        material: list[records.Record],
        messages: Callable[[], Iterator[records.Record]],
    ) -> None:
        self._ops = ops
        self._kinds = kinds
        self._material = material
        self._messages = messages
        self._bodies: list[bytes] = []

    def mutate(self, data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
        if not self._bodies:
            for peer, message in self._messages():
                self._bodies.append(message[4:])
                self._material.append((self._kinds[0] | peer << 4, message))

        def change(op: int, body: bytes) -> bytes:
            if op & 7 in self._kinds and len(body) > 4 and random.random() < 0.7:
                return body[:4] + submessages.change(body[4:], random, mutate_bytes, self._bodies)
            return mutate_bytes(body)

        return records.mutate(data, random, self._ops, self._material, change)

    def mutate_in_chunks(
        self, data: bytes, random: Random, mutate_bytes: records.MutateBytes
    ) -> bytes:
        """Mutate an input that has the length of chunks before the records."""
        head = data[:1] if random.random() < 0.9 else bytes((random.randrange(256),))
        return (head or b"\0") + self.mutate(data[1:], random, mutate_bytes)


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    if not _material:
        for _, messages in captured():
            _material.extend(messages)
            # Without their headers, for any client, in its next message.
            for op, datagram in messages:
                at = 4 if datagram[0] & 0x80 else 8
                if datagram[1]:
                    _material.append((op | RELIABLE << 2 | POLITE, datagram[at:]))
                _bodies.append(datagram[at:])
        for _, messages in synthetic():
            _material.extend(messages)
            _bodies.extend(body for op, body in messages if op >> 2 & 7 in (RELIABLE, BARE))
        for peer in range(1, 5):
            _material.append((peer - 1, create_client(key_of(peer), session_id_of(peer))))
        for ms in (1, 10, 200, 1000, 30_000):
            _material.append((TIME << 2, ms.to_bytes(3, "little")))

    def change(op: int, body: bytes) -> bytes:
        kind = op >> 2 & 7
        if kind == RAW and len(body) > 8:
            at = 4 if body[0] & 0x80 else 8
            return body[:at] + submessages.change(body[at:], random, mutate_bytes, _bodies)
        if kind in (RELIABLE, BEST_EFFORT, BARE):
            return submessages.change(body, random, mutate_bytes, _bodies)
        return mutate_bytes(body)

    head = data[:1] or b"\0"
    if random.random() < 0.05:
        head = bytes((random.choice((0, 0x40, 0x80, 0xC0)),))
    return head + records.mutate(data[1:], random, OPS, _material, change)
