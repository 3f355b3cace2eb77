"""A small blocking XRCE client on uros.wire, for tests: a call returns after its answer has come.

Objects are numbered from 1 for each kind; the kind is in the low four bits of an id.
"""

import time
from collections import deque

from support.lines import SECONDS
from uros.ticks import TIME_MASK, ticks_diff
from uros.wire import data, entities, ids, session
from uros.wire.cdr import Reader, Writer
from uros.wire.header import MessageWriter, header_size, pull_header, pull_subheader, push_header
from uros.wire.streams import (
    BestEffortIn,
    Fragments,
    ReliableIn,
    ReliableOut,
    split,
)

RELIABLE = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST
BEST_EFFORT = ids.QOS_KEEP_LAST


def now_ms():
    return int(time.monotonic() * 1000) & TIME_MASK


class XrceClient:
    """One session over a line of support.lines. ``samples`` are DATA payloads by object id."""

    def __init__(self, line, key, session_id=0x81, mtu=512):
        self.line = line
        self.key = key
        self.session_id = session_id
        self.mtu = min(mtu, getattr(line, "mtu", mtu))
        self.samples = {}
        self.statuses = {}  # (request id, object id) → status
        self.infos = deque()
        self.agent_status = None
        self._request = 0
        self._numbers = {}
        self._out = ReliableOut()
        self._in = ReliableIn()
        self._best_effort_in = BestEffortIn()
        self._best_effort_out = 0
        self._fragments = Fragments()
        self._parts = {}

    # --- sending ---------------------------------------------------------------

    def _send(self, kind, payload, stream, flags=ids.FLAG_LITTLE_ENDIAN):
        """Send one submessage, in fragments where it is larger than the MTU."""
        head = header_size(self.session_id)
        if head + 4 + len(payload) > self.mtu and stream >= ids.STREAM_RELIABLE:
            size = len(payload)
            whole = bytes((kind, flags, size & 0xFF, size >> 8 & 0xFF)) + payload
            for start, stop, part_flags in split(len(whole), self.mtu - head - 4):
                self._put(ids.FRAGMENT, whole[start:stop], stream, part_flags)
            return
        self._put(kind, payload, stream, flags)

    def _put(self, kind, payload, stream, flags):
        number = 0
        if stream >= ids.STREAM_RELIABLE:
            self.until(lambda: self._out.available() > 0, "the agent acknowledges nothing")
            number = self._out.next
        elif stream:
            number = self._best_effort_out
            self._best_effort_out = (number + 1) & 0xFFFF
        head = bytearray(header_size(self.session_id))
        push_header(head, self.session_id, stream, number, self.key)
        size = len(payload)
        message = bytes(head) + bytes((kind, flags, size & 0xFF, size >> 8 & 0xFF)) + payload
        if stream < ids.STREAM_RELIABLE:
            self.line.send(message)
            return
        self._out.put(message)
        for datagram in self._out.take(now_ms()):
            self.line.send(datagram)

    def next_request(self):
        self._request += 1
        return self._request

    def _payload(self, push, *values):
        w = Writer(bytearray(66000))
        push(w, *values)
        return bytes(w.buf[: w.offset])

    # --- receiving ---------------------------------------------------------------

    def until(self, done, failure, seconds=SECONDS):
        """Receive messages until ``done()``; AssertionError after the deadline."""
        deadline = time.monotonic() + seconds
        while not done():
            self._beat()
            message = self.line.receive(min(deadline, time.monotonic() + 0.2))
            if message is not None:
                self.take(message)
            elif time.monotonic() >= deadline:
                raise AssertionError(f"client {self.key:08X}: {failure} (within {seconds} s)")

    def _beat(self):
        now = now_ms()
        due = self._out.heartbeat(now)
        if due is not None:
            payload = self._payload(session.push_heartbeat, *due, ids.STREAM_RELIABLE)
            self._put(ids.HEARTBEAT, payload, ids.STREAM_NONE, ids.FLAG_LITTLE_ENDIAN)

    def take(self, message):
        session_id, stream, number, _, start = pull_header(message, len(message))
        if session_id & 0x7F and session_id != self.session_id:
            return  # late, from an earlier session on the same line
        if stream >= ids.STREAM_RELIABLE:
            if self._in.receive(number, message[start:]):
                self._submessages(message, start)
                self._catch_up()
            self._acknowledge()
        elif not stream or self._best_effort_in.accept(number, now_ms()):
            self._submessages(message, start)

    def _catch_up(self):
        while (body := self._in.pop()) is not None:
            self._submessages(body, 0)

    def _acknowledge(self):
        payload = self._payload(session.push_acknack, *self._in.acknack(), ids.STREAM_RELIABLE)
        self._put(ids.ACKNACK, payload, ids.STREAM_NONE, ids.FLAG_LITTLE_ENDIAN)

    def _submessages(self, message, at):
        end = len(message)
        while at + 4 <= end:
            kind, flags, start, stop = pull_subheader(message, at, end)
            if kind == ids.FRAGMENT:
                last = bool(flags & ids.FLAG_LAST_FRAGMENT)
                whole = self._fragments.add(message[start:stop], last)
                if whole is not None:
                    self._submessages(bytes(whole), 0)
            else:
                self._submessage(kind, flags, bytes(message[start:stop]))
            at = stop + (-stop & 3)

    def _submessage(self, kind, flags, payload):
        r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
        if kind == ids.STATUS_AGENT:
            self.agent_status = session.pull_status_agent(r)[0]
        elif kind == ids.STATUS:
            request, thing, status, _ = session.pull_status(r)
            self.statuses[request, thing] = status
        elif kind == ids.DATA:
            request, thing = session.pull_request(r)
            self.samples.setdefault(thing, deque()).append(payload[4:])
        elif kind == ids.INFO:
            self.infos.append(session.pull_info(r))
        elif kind == ids.ACKNACK:
            first, missing, _ = session.pull_acknack(r)
            for datagram in self._out.acknack(first, missing, now_ms()):
                self.line.send(datagram)
        elif kind == ids.HEARTBEAT:
            first, last, _ = session.pull_heartbeat(r)
            self._in.heartbeat(first, last, now_ms())
            self._acknowledge()

    # --- requests --------------------------------------------------------------

    def open(self):
        """Create the session; the status in STATUS_AGENT."""
        none = ids.SESSION_NONE_WITHOUT_KEY if self.session_id & 0x80 else 0
        w = MessageWriter(bytearray(128), none, ids.STREAM_NONE, 0, self.key)
        w.begin(ids.CREATE_CLIENT)
        session.push_create_client(w, self.key, self.session_id, self.mtu)
        self.agent_status = None
        self._out, self._in = ReliableOut(), ReliableIn()
        self.line.send(w.finish())
        self.until(lambda: self.agent_status is not None, "no answer to CREATE_CLIENT")
        return self.agent_status

    def request(self, kind, push, thing, *values, flags=ids.FLAG_LITTLE_ENDIAN, stream=None):
        """Send a request about an object and wait for its STATUS."""
        number = self.next_request()
        payload = self._payload(push, number, thing, *values)
        stream = ids.STREAM_RELIABLE if stream is None else stream
        self._send(kind, payload, stream, flags)
        self.until(lambda: (number, thing) in self.statuses, f"no STATUS for 0x{thing:04X}")
        return self.statuses[number, thing]

    def create(self, kind, number, form, content, parent, flags=0):
        """Create an object and check its status; the object id."""
        thing = number << 4 | kind
        flags |= ids.FLAG_LITTLE_ENDIAN
        status = self.request(
            ids.CREATE, entities.push_create, thing, form, content, parent, flags=flags
        )
        assert status == ids.STATUS_OK, (hex(thing), ids.status_name(status))
        return thing

    def delete(self, thing):
        return self.request(ids.DELETE, session.push_request, thing)

    def close(self):
        """Delete the session; the status."""
        return self.request(
            ids.DELETE, session.push_request, ids.OBJECT_CLIENT, stream=ids.STREAM_NONE
        )

    def ping(self):
        """Send GET_INFO in the session; the availability in the answer, 1: a known session."""
        number = self.next_request()
        payload = self._payload(session.push_get_info, number, ids.OBJECT_AGENT, ids.INFO_ACTIVITY)
        self._put(ids.GET_INFO, payload, ids.STREAM_NONE, ids.FLAG_LITTLE_ENDIAN)
        self.until(lambda: any(info[0] == number for info in self.infos), "no answer to a ping")
        return self.infos.pop()[3]

    def _number(self, kind):
        self._numbers[kind] = self._numbers.get(kind, 0) + 1
        return self._numbers[kind]

    def binary(self, kind, parent, push, *values, number=None):
        content = self._payload(push, *values)
        number = self._number(kind) if number is None else number
        return self.create(kind, number, ids.IN_BINARY, content, parent)

    def participant(self, name, domain=0):
        """The object id of a participant; it is created once for each name."""
        if name not in self._parts:
            self._parts[name] = self.binary(
                ids.KIND_PARTICIPANT, domain, entities.push_binary_participant, name, None
            )
        return self._parts[name]

    def _topic(self, node, topic, type_name):
        key = node, topic
        if key not in self._parts:
            self._parts[key] = self.binary(
                ids.KIND_TOPIC, node, entities.push_binary_topic, topic, type_name
            )
        return self._parts[key]

    def writer(self, node_name, topic, type_name, qos=RELIABLE, depth=10):
        """Create a datawriter with its participant, topic and publisher; its object id."""
        return self._endpoint(
            ids.KIND_PUBLISHER, ids.KIND_DATAWRITER, node_name, topic, type_name, qos, depth
        )

    def reader(self, node_name, topic, type_name, qos=RELIABLE, depth=10):
        return self._endpoint(
            ids.KIND_SUBSCRIBER, ids.KIND_DATAREADER, node_name, topic, type_name, qos, depth
        )

    def _endpoint(self, group_kind, kind, node_name, topic, type_name, qos, depth):
        node = self.participant(node_name)
        topic_id = self._topic(node, topic, type_name)
        group = self.binary(group_kind, node, entities.push_binary_group, None, None)
        return self.binary(
            kind, group, entities.push_binary_endpoint, topic_id, qos, depth,
            None, None, None, kind == ids.KIND_DATAREADER,
        )  # fmt: skip

    def service(self, kind, node_name, name, request_type, reply_type):
        """Create a requester or replier of a ROS service; its object id."""
        node = self.participant(node_name)
        return self.binary(
            kind, node, entities.push_binary_service, name, request_type, reply_type,
            f"rq{name}Request", f"rr{name}Reply",
        )  # fmt: skip

    def write(self, thing, payload, stream=ids.STREAM_RELIABLE, flags=ids.FLAG_LITTLE_ENDIAN):
        """Send WRITE_DATA; on a reliable stream, wait for the acknowledgement. The request id."""
        number = self.next_request()
        head = self._payload(session.push_request, number, thing)
        self._send(ids.WRITE_DATA, head + payload, stream, flags)
        if stream >= ids.STREAM_RELIABLE:
            self.until(lambda: not len(self._out), "a sample is not acknowledged")
        return number

    def read(self, thing, stream=ids.STREAM_RELIABLE, control=(0xFFFF, 0, 0, 0)):
        """Send READ_DATA and wait for the acknowledgement; the request id."""
        number = self.next_request()
        payload = self._payload(data.push_read_data, number, thing, stream, 0, None, control)
        self._send(ids.READ_DATA, payload, ids.STREAM_RELIABLE)
        self.until(lambda: not len(self._out), "READ_DATA is not acknowledged")
        return number

    def wait_sample(self, thing, seconds):
        """Whether a sample is there, or comes within ``seconds``."""
        waiting = self.samples.setdefault(thing, deque())
        deadline = time.monotonic() + seconds
        while not waiting and time.monotonic() < deadline:
            message = self.line.receive(deadline)
            if message is not None:
                self.take(message)
        return bool(waiting)

    def sample(self, thing, seconds=SECONDS):
        """Wait for the next sample of a reader; its payload."""
        waiting = self.samples.setdefault(thing, deque())
        self.until(lambda: waiting, f"no sample for 0x{thing:04X}", seconds)
        return waiting.popleft()


__all__ = ["BEST_EFFORT", "RELIABLE", "XrceClient", "ticks_diff"]
