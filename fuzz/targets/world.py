"""A whole agent without sockets, on the memory middleware, in simulated time, with its invariants.

A witness, a correct client on an address of its own, sends requests after every operation: no other
client may be affected.
"""

import io

from uros.agent.agent import Agent
from uros.agent.clock import Clock
from uros.agent.log import Log, RateLimit
from uros.agent.observability.message_hooks import CLIENT
from uros.agent.policy.admission import MAX_CLIENTS
from uros.agent.policy.limits import Limits
from uros.agent.session.session import MAX_HELD, MAX_STREAMS
from uros.agent.transports.base import ServerTransport
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.qos import QoSProfile
from uros.ticks import TIME_MASK, ticks_diff
from uros.wire import entities, ids, session
from uros.wire.cdr import Writer
from uros.wire.header import MessageWriter, header_size, pull_header, push_header, push_subheader
from uros.wire.streams import WINDOW

WITNESS = 0  # the peer of the witness
WITNESS_KEY = 0x5EC0DD17
# The largest datagram of a transport.
MAX_DATAGRAM = 0xFFFF
# A step of time is split into slices of this length; the witness sends requests in each.
SLICE_MS = 2000
MAX_STEP_MS = 40_000
# Attack: amplification, a client that makes the agent send much more than it sends itself. The
# limit leaves room for the answers to the witness's pings.
MAX_SENT = 16 * 1024 * 1024
MAX_TURN = 1024 * 1024

INT32 = "std_msgs::msg::dds_::Int32_"
OUTSIDE_TOPICS = ("rt/chatter", "rt/std_msgs_msg_Int32", "HelloWorldTopic", "rt/other")


class Finding(AssertionError):
    """A violated invariant."""


def must(condition: bool, fault: str) -> None:
    """Raise Finding with ``fault`` unless the condition is true."""
    if not condition:
        raise Finding(fault)


def submessage(kind: int, payload: bytes, flags: int = 1) -> bytes:
    """A submessage with its header, padded to a multiple of 4."""
    head = bytearray(4)
    push_subheader(head, 0, kind, flags, len(payload))
    return bytes(head) + payload + bytes(-len(payload) % 4)


def built(push: object, *values: object) -> bytes:
    """The octets that a push function of the codecs writes."""
    w = Writer(bytearray(4096))
    push(w, *values)  # type: ignore[operator]
    return bytes(w.buf[: w.offset])


def message(session_id: int, stream: int, sequence: int, key: int, body: bytes) -> bytes:
    head = bytearray(header_size(session_id))
    push_header(head, session_id, stream, sequence, key)
    return bytes(head) + body


def create_client(key: int, session_id: int, mtu: int = 512) -> bytes:
    outside = ids.SESSION_NONE_WITHOUT_KEY if session_id & 0x80 else ids.SESSION_NONE_WITH_KEY
    w = MessageWriter(bytearray(64), outside, ids.STREAM_NONE, 0, key)
    w.begin(ids.CREATE_CLIENT)
    session.push_create_client(w, key, session_id, mtu, None)
    return w.finish()


PING = submessage(ids.GET_INFO, built(session.push_get_info, 7, ids.OBJECT_AGENT, 2))
BARE_PING = message(ids.SESSION_NONE_WITHOUT_KEY, 0, 0, 0, PING)
OWN_PING = message(0x81, 0, 0, WITNESS_KEY, PING)
_ENTITIES = b"".join(
    submessage(
        ids.CREATE, built(entities.push_create, 1, object_id, ids.IN_BINARY, content, parent)
    )
    for object_id, content, parent in (
        (0x011, built(entities.push_binary_participant, "witness", None), 0),
        (0x012, built(entities.push_binary_topic, "rt/witness", INT32), 0x011),
        (0x013, built(entities.push_binary_group, None, None), 0x011),
        (0x015, built(entities.push_binary_endpoint, 0x012, ids.QOS_RELIABLE, 5), 0x013),
    )
)
_SAMPLE = b"\x2a\x00\x00\x00"


class _Sink(io.TextIOBase):
    """A log that is formatted and dropped; an internal error in it is a finding."""

    def __init__(self) -> None:
        self.faults: list[str] = []  # not raised here, since the agent would catch the exception

    def write(self, text: str) -> int:
        if "internal error" in text or text.count("\n") != 1 or not text.isascii():
            self.faults.append(text)
        return len(text)


class _Always(RateLimit):
    """No rate limit: the lines must not depend on the speed of the machine."""

    def admit(self, kind: str) -> int:
        return 1


class Place(ServerTransport):
    """The transport: peers are numbers."""

    name = "FuzzAgent"
    kind = "FUZZ"

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[object, bytes]] = []

    def open(self, host: object) -> None:
        """Nothing to open."""

    def send(self, peer: object, datagram: bytes) -> None:
        self.sent.append((peer, bytes(datagram)))

    def address(self, peer: object) -> str:
        return f"peer {peer}"

    def close(self) -> None:
        """Nothing to close."""


class World:
    """See the module. ``limits`` of the clients; None: those of ``uros agent``."""

    def __init__(self, level: int = 4, limits: Limits | None = None) -> None:
        self.time = 1000  # milliseconds
        self.clock = Clock(lambda: self.time / 1000)
        self.bus = Bus()
        self.middleware = MemoryMiddleware(self.bus)
        self.outside = MemoryMiddleware(self.bus)
        self._sink = _Sink()
        self.agent = Agent(self.middleware, Log(level, self._sink), clock=self.clock, limits=limits)
        self.agent.now = lambda: self.time
        self.agent.faults = self.agent.unmatched_faults = _Always()
        self.place = Place()
        self.bytes_sent = 0
        self.tampered = (
            False  # another client used the witness's key and may have taken its session
        )
        self.calls: list[tuple[int, object]] = []
        self.agent.start(self.wake_at, [self.place])
        node = self.outside.create_node(0, "/", "outside")
        qos = QoSProfile(depth=20)
        self.writers = [node.create_writer(topic, INT32, qos) for topic in OUTSIDE_TOPICS]
        self.readers = [
            node.create_reader(topic, INT32, qos, lambda: None) for topic in OUTSIDE_TOPICS
        ]
        self._witnessed = node.create_reader("rt/witness", INT32, qos, lambda: None)
        self.receive(WITNESS, create_client(WITNESS_KEY, 0x81))
        self.receive(WITNESS, message(0x81, 0x80, 0, WITNESS_KEY, _ENTITIES))

    # --- the server's methods for transports -----------------------------------------

    def now(self) -> int:
        return self.time

    def received(self, transport, session, buf, view, length, now) -> None:  # type: ignore
        self._check_key(transport, view[:length])
        if self.agent.message_hooks:
            self.agent.message_hooks(transport, 0, CLIENT, view, length, session.key)
        if session.receive(buf, view, length, now):
            self.agent.attend(session)

    def unmatched(self, transport, peer, buf, view, length) -> None:  # type: ignore
        self._check_key(transport, view[:length], peer)
        if self.agent.message_hooks:
            self.agent.message_hooks(transport, peer, CLIENT, view, length, 0)
        self.agent.unmatched(transport, peer, buf, view, length)

    def _check_key(self, transport: object, datagram: memoryview, peer: object = None) -> None:
        if transport is not self.place or peer != WITNESS:
            self.tampered |= WITNESS_KEY.to_bytes(4, "big") in bytes(datagram)

    def gone(self, transport, peer) -> None:  # type: ignore
        self.agent.gone(transport, peer)

    def watch(self, fileno: int, ready: object, writing: bool = False) -> None:
        pass

    def unwatch(self, fileno: int) -> None:
        pass

    def lost(self, transport: ServerTransport) -> None:
        self.agent.line_loss.lost(transport)

    def note(self, level: int, part: str, function: str, what: str, about: str) -> None:
        self.agent.log(level, part, function, what, about)

    def wake_at(self, seconds: float, call: object) -> None:
        self.calls.append((self.time + int(seconds * 1000), call))

    # --- operations --------------------------------------------------------------------

    def receive(self, peer: object, datagram: bytes) -> list[tuple[object, bytes]]:
        """Pass a datagram to the agent; (peer, datagram) of all that the agent sends then."""
        buf = bytearray(datagram[:MAX_DATAGRAM])
        self.place.deliver(self, peer, buf, memoryview(buf), len(buf), self.time)
        return self.settle()

    def settle(self) -> list[tuple[object, bytes]]:
        """Do the work of the server's loop after a burst of datagrams."""
        agent = self.agent
        self.middleware.dispatch()
        turns = 0
        while agent.attended:
            turns += 1
            must(turns < 10_000, "sessions want attention for ever")
            attended = list(agent.attended)
            agent.attended.clear()
            if agent.session_store is not None:
                agent.session_store.keep(attended)
            for client_session in attended:
                client_session.finish()
                agent.flush(client_session)
        if agent.budget.since > agent.budget.room:
            agent.budget.settle(self.time)
        must(not self._sink.faults, "".join(self._sink.faults))
        sent, self.place.sent = self.place.sent, []
        for peer, datagram in sent:
            self._check_message(peer, datagram)
        self.bytes_sent += sum(len(datagram) for _, datagram in sent)
        return sent

    def _check_message(self, peer: object, datagram: bytes) -> None:
        """A datagram of the agent is a message, no longer than its receiver's MTU."""
        pull_header(datagram, len(datagram))
        session = self.place.sessions.get(peer)
        if session is not None:
            # An answer of one submessage is sent even where the MTU is smaller.
            must(len(datagram) <= max(session.mtu, 64), f"{len(datagram)} bytes, mtu {session.mtu}")

    def advance(self, milliseconds: int) -> None:
        """Advance the time and run the timers that are due."""
        end = self.time + milliseconds
        turns = 0
        while True:
            turns += 1
            must(turns < 20_000, "timers fire for ever")
            due = [call for call in self.calls if call[0] <= end]
            for client in self.agent.clients.values():
                at = client.next_deadline()
                if at is not None and ticks_diff(at, end & TIME_MASK) <= 0:
                    due.append((at, client))
            if not due:
                break
            first = min(due, key=lambda entry: entry[0])
            at, due_call = first
            self.time = max(self.time, at)
            if first in self.calls:
                self.calls.remove(first)
                due_call()  # type: ignore[operator]
            else:
                due_call.poll(self.time)  # type: ignore[attr-defined]
                self.agent.attend(due_call.session)  # type: ignore[attr-defined]
            self.settle()
        self.time = end
        self.middleware.tick()
        self.settle()

    def step(self, milliseconds: int) -> None:
        """Advance the time in slices, with requests of the witness in each."""
        left = min(milliseconds, MAX_STEP_MS)
        while left > 0:
            self.advance(min(left, SLICE_MS))
            left -= SLICE_MS
            self.witness()

    def publish(self, topic: int, sample: bytes) -> None:
        """Write a sample from outside of the agent."""
        self.writers[topic % len(self.writers)].write(b"\0\1\0\0" + sample)
        self.settle()

    # --- invariants ----------------------------------------------------------------------

    def witness(self) -> None:
        """The agent answers the witness."""
        answers = self.receive(WITNESS, BARE_PING)
        must(any(peer == WITNESS for peer, _ in answers), "a ping is not answered")
        if not self.tampered:
            answers = self.receive(WITNESS, OWN_PING)
            must(
                any(peer == WITNESS and datagram[0] == 0x81 for peer, datagram in answers),
                "the ping of another client within its session is not answered",
            )

    def check(self) -> None:
        """No resource exceeds its limit, and the counts are right."""
        agent = self.agent
        must(len(agent.clients) <= MAX_CLIENTS, "too many clients")
        must(set(agent._places) == set(agent.clients), "places and clients differ")
        for peer, client_session in self.place.sessions.items():
            known = agent._places.get(client_session.key)
            must(known == (self.place, peer), f"a session of peer {peer} that is not there")
        must(self.bytes_sent <= MAX_SENT, "it sends without end")
        held = 0
        for client in agent.clients.values():
            self._check_client(client)
            held += client.held()
        # A turn may exceed the limit by the messages that it sends; here a turn is one message.
        must(held <= agent.limits.memory + MAX_TURN, f"{held} bytes held for all clients")

    def _check_client(self, client) -> None:  # type: ignore[no-untyped-def]
        session = client.session
        must(not session.outgoing, "messages that nobody sends")
        must(len(session._in) <= MAX_STREAMS, "input streams")
        must(len(session._out) <= MAX_STREAMS, "output streams")
        must(len(session._best_effort_in) <= MAX_STREAMS, "best-effort streams")
        pending = 0
        for incoming in session._in.values():
            must(len(incoming.stream.waiting) <= WINDOW, "early messages")
            pending += incoming.fragments.pending
        limits = self.agent.limits
        must(pending <= limits.message, f"{pending} bytes of fragments")
        for stream in session._out.values():
            must(len(stream) <= MAX_HELD, "held messages")
            held = sum(map(len, stream.export()[3].values()))
            must(stream.size == held, "bytes held are miscounted")
            must((stream.sent - stream.acked) & 0xFFFF <= WINDOW, "a window overrun")
        kept = sum(thing.kept for thing in client.objects.values())
        must(client._kept == kept, f"{client._kept} bytes of representations, not {kept}")
        must(kept <= limits.representations, "representations")
        must(len(client.objects) <= limits.objects, "objects")
        must(session.writers.keys() <= client.objects.keys(), "writers of no object")

    def close(self) -> None:
        """The witness can still publish; after the agent has closed, nothing is left."""
        if not self.tampered:
            self._witnessed.take(100)
            client = self.agent.clients.get(WITNESS_KEY)
            must(client is not None, "another client is gone")
            number = (client.session.last_received(0x80) + 1) & 0xFFFF
            write = submessage(ids.WRITE_DATA, b"\0\1\0\x15" + _SAMPLE)
            self.receive(WITNESS, message(0x81, 0x80, number, WITNESS_KEY, write))
            samples = [bytes(sample) for sample in self._witnessed.take(100)]
            must(samples == [b"\0\1\0\0" + _SAMPLE], f"another client's sample: {samples}")
        self.agent.close()
        self.settle()
        self.middleware.close()
        must(not self.agent.clients and not self.agent._places, "clients after the end")
        must(not self.place.sessions, "sessions after the end")
        self.outside.close()
        left = [node.full_name for node in self.bus.nodes]
        must(not left, f"nodes after the end: {left}")
        must(not any(self.bus.readers.values()), "readers after the end")
        must(not any(self.bus.writers.values()), "writers after the end")
