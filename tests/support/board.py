"""A simulated environment for a board: a fake clock, message types, and a scripted agent.

Runs on CPython and on MicroPython. Time passes only where the code under test waits.
"""

from support.conversation import unpack
from uros.client.clock import Clock
from uros.ticks import TIME_MASK
from uros.wire import data, ids, session
from uros.wire.cdr import Reader, Writer
from uros.wire.header import push_header, push_subheader
from uros.wire.streams import Fragments, ReliableIn, ReliableOut

KEY = 0xAABBCCDD


class FakeClock(Clock):
    """A clock whose time ``t``, in microseconds, advances only by sleeping and receiving."""

    def __init__(self, start_ms=1000):
        self.t = start_ms * 1000
        super().__init__()

    def ms(self):
        return self.t // 1000 & TIME_MASK

    def us(self):
        return self.t & TIME_MASK

    def sleep(self, ms):
        self.t += ms * 1000


class Number:
    """A message of one int32, with the interface of a generated class."""

    _TYPE = "test_msgs/msg/Number"
    _DDS_TYPE = "test_msgs::msg::dds_::Number_"

    def __init__(self, value=0):
        self.value = value

    def cdr_size(self, o=0):
        return o + (-o & 3) + 4

    def pack_into(self, buf, offset, start):
        at = offset + (start - offset & 3)
        if at + 4 > len(buf):
            raise ValueError("too short a buffer")
        buf[at : at + 4] = number_bytes(self.value)
        return at + 4

    @classmethod
    def unpack_from(cls, buf, offset, start, end, little=True):
        if end - offset < 4:
            raise ValueError("a Number has 4 octets")
        octets = bytes(buf[offset : offset + 4])
        return cls(int.from_bytes(octets, "little" if little else "big")), offset + 4

    def __eq__(self, other):
        return type(other) is type(self) and other.value == self.value

    def __repr__(self):
        return f"Number({self.value!r})"


class Blob:
    """A message of any number of octets."""

    _TYPE = "test_msgs/msg/Blob"
    _DDS_TYPE = "test_msgs::msg::dds_::Blob_"

    def __init__(self, octets=b""):
        self.octets = octets

    def cdr_size(self, o=0):
        return o + len(self.octets)

    def pack_into(self, buf, offset, start):
        if offset + len(self.octets) > len(buf):
            raise ValueError("too short a buffer")
        buf[offset : offset + len(self.octets)] = self.octets
        return offset + len(self.octets)

    @classmethod
    def unpack_from(cls, buf, offset, start, end, little=True):
        return cls(bytes(buf[offset:end])), end


class Ask:
    """A service from Number to Number."""

    class Request(Number):
        _TYPE = "test_msgs/srv/Ask_Request"
        _DDS_TYPE = "test_msgs::srv::dds_::Ask_Request_"

    class Response(Number):
        _TYPE = "test_msgs/srv/Ask_Response"
        _DDS_TYPE = "test_msgs::srv::dds_::Ask_Response_"


def number_bytes(value):
    return (value & 0xFFFFFFFF).to_bytes(4, "little")


def pattern(size, start=0):
    """``size`` octets of all values."""
    octets = bytearray(size)
    for i in range(size):
        octets[i] = (start + i * 7 + (i >> 8)) & 0xFF
    return bytes(octets)


def built(push, *values):
    """The octets that a push function of the codecs writes."""
    w = Writer(bytearray(1024))
    push(w, *values)
    return bytes(memoryview(w.buf)[: w.offset])


def message(kind, payload, stream=0, sequence=0, session_id=0x81, flags=ids.FLAG_LITTLE_ENDIAN):
    """A datagram with one submessage."""
    buf = bytearray(8 + len(payload))
    push_header(buf, session_id, stream, sequence)
    push_subheader(buf, 4, kind, flags, len(payload))
    buf[8:] = payload
    return bytes(buf)


class FakeAgent:
    """A transport with an agent at its other end, which answers at once.

    ``sent`` has all messages of the board, ``requests`` the (kind, object id) of each request on
    its reliable stream, once each and in order, ``samples`` the (object id, sample) of WRITE_DATA.
    ``delay`` is the latency in each direction, two numbers of microseconds. The agent answers
    nothing while ``silent`` is set, and answers with the statuses in ``refuse`` (object id →
    status). The transport raises ``fail_open``, ``fail_send`` and ``fail_receive``.
    """

    def __init__(self, clock, mtu=512):
        self.clock = clock
        self.mtu = mtu
        self.delay = (0, 0)
        self.epoch_us = 1700000000000000  # the agent's time when the clock shows 0
        self.silent = False
        self.status = ids.STATUS_OK  # of CREATE_CLIENT
        self.refuse = {}
        self.fail_open = self.fail_send = self.fail_receive = None
        self.is_open = False
        self.opened = self.posted = 0
        self.forget()
        self.create_clients = []  # (clock in ms, session id)
        self.pings = []  # (clock in ms, within a session)

    def forget(self):
        """Act as a new agent process, without any session."""
        self.sent = []
        self.inbox = []  # (time of arrival, count, message)
        self.requests = []
        self.creations = []  # payloads of CREATE
        self.samples = []
        self.times = 0
        self.session_id = 0
        self.streams()

    def streams(self):
        self.into = ReliableIn()
        self.out = ReliableOut()
        self.fragments = Fragments(1 << 20)

    # --- the transport --------------------------------------------------------------------

    def open(self):
        self.opened += 1
        if self.fail_open:
            raise self.fail_open
        self.is_open = True

    def close(self):
        self.is_open = False
        self.inbox.clear()

    def send(self, message, size):
        assert self.is_open
        assert size <= self.mtu, size
        if self.fail_send:
            raise self.fail_send
        message = bytes(memoryview(message)[:size])
        self.sent.append(message)
        if not self.silent:
            self.hear(message)

    def receive(self, timeout_ms):
        assert self.is_open
        assert timeout_ms >= 0
        if self.fail_receive:
            raise self.fail_receive
        end = self.clock.t + timeout_ms * 1000
        self.inbox.sort()
        if self.inbox and self.inbox[0][0] <= end:
            when, _, message = self.inbox.pop(0)
            self.clock.t = max(self.clock.t, when)
            return message
        self.clock.t = end
        return None

    # --- the agent ------------------------------------------------------------------------

    def post(self, message):
        """Send a datagram to the board; it arrives after the delay."""
        when = self.clock.t + self.delay[0] + self.delay[1]
        self.posted += 1
        self.inbox.append((when, self.posted, message))

    def answer(self, kind, payload, session_id=None):
        self.post(message(kind, payload, session_id=session_id or self.session_id))

    def reliable(self, kind, payload, flags=ids.FLAG_LITTLE_ENDIAN):
        self.out.put(
            message(kind, payload, ids.STREAM_RELIABLE, self.out.next, self.session_id, flags)
        )
        for datagram in self.out.take(self.clock.ms()):
            self.post(datagram)

    def sample(self, object_id, octets, request=0):
        """Send a sample to the board."""
        self.reliable(ids.DATA, built(session.push_request, request, object_id) + octets)

    def hear(self, datagram):
        """Process a datagram of the board."""
        (session_id, stream, sequence, _), parts = unpack(datagram)
        if session_id == ids.SESSION_NONE_WITHOUT_KEY:
            self.outside_session(*parts[0])
        elif session_id != self.session_id:
            return
        elif stream < ids.STREAM_RELIABLE:
            for part in parts:
                self.submessage(*part)
        else:
            if self.into.receive(sequence, datagram[4:]):
                for part in parts:
                    self.submessage(*part)
                body = self.into.pop()
                while body is not None:
                    for part in unpack(datagram[:4] + body)[1]:
                        self.submessage(*part)
                    body = self.into.pop()
            self.acknowledge()

    def acknowledge(self):
        first, missing = self.into.acknack()
        self.answer(ids.ACKNACK, built(session.push_acknack, first, missing, ids.STREAM_RELIABLE))

    def outside_session(self, kind, flags, payload):
        r = Reader(payload, 0, len(payload), True)
        if kind == ids.GET_INFO:
            self.pings.append((self.clock.ms(), False))
            info = built(session.push_info, 10, ids.OBJECT_AGENT, 0, 0, [])
            self.answer(ids.INFO, info, ids.SESSION_NONE_WITHOUT_KEY)
        elif kind == ids.CREATE_CLIENT:
            values = session.pull_create_client(r)
            assert values[0] == b"XRCE" and values[3] == KEY and values[6] == self.mtu, values
            self.create_clients.append((self.clock.ms(), values[4]))
            self.session_id = values[4]
            self.streams()
            self.answer(ids.STATUS_AGENT, built(session.push_status_agent, self.status))

    def submessage(self, kind, flags, payload):
        r = Reader(payload, 0, len(payload), True)
        if kind == ids.ACKNACK:
            first, missing, _ = session.pull_acknack(r)
            for datagram in self.out.acknack(first, missing, self.clock.ms()):
                self.post(datagram)
        elif kind == ids.HEARTBEAT:
            first, last, _ = session.pull_heartbeat(r)
            self.into.heartbeat(first, last, self.clock.ms())
            self.acknowledge()
        elif kind == ids.GET_INFO:
            self.pings.append((self.clock.ms(), True))
            self.answer(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 1, []))
        elif kind == ids.TIMESTAMP:
            self.times += 1
            now = self.clock.t + self.delay[0] + self.epoch_us
            self.timestamp(now, now, session.pull_timestamp(r))
        elif kind == ids.FRAGMENT:
            whole = self.fragments.add(payload, bool(flags & ids.FLAG_LAST_FRAGMENT))
            if whole is not None:
                self.submessage(whole[0], whole[1], bytes(whole[4:]))
        elif kind == ids.WRITE_DATA:
            self.samples.append((payload[2] << 8 | payload[3], payload[4:]))
        else:
            request, thing = session.pull_request(r)
            if kind == ids.DELETE and thing == ids.OBJECT_CLIENT:
                self.answer(ids.STATUS, built(session.push_status, request, thing, 0))
                self.session_id = 0
                return
            self.requests.append((kind, thing))
            if kind == ids.CREATE:
                self.creations.append((flags, payload))
            if kind != ids.READ_DATA:
                status = self.refuse.get(thing, ids.STATUS_OK)
                self.reliable(ids.STATUS, built(session.push_status, request, thing, status))

    def timestamp(self, transmit, receive, originate):
        """Answer with the agent's times in microseconds."""
        pair = [
            (microseconds // 1000000, microseconds % 1000000 * 1000)
            for microseconds in (transmit, receive)
        ]
        self.answer(
            ids.TIMESTAMP_REPLY, built(session.push_timestamp_reply, pair[0], pair[1], originate)
        )


__all__ = [
    "KEY", "Ask", "Blob", "FakeAgent", "FakeClock", "Number", "built", "data",
    "message", "number_bytes", "pattern",
]  # fmt: skip
