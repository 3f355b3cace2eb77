"""The XRCE client of a flight controller, written from public sources.

PX4 and ArduPilot both use eProsima's C client library; :class:`Session` behaves like that library,
with the buffers of both. It uses nothing of uros: this module builds the bytes itself, after the
library's sources, and tests/replay/test_c_library.py compares them with recordings of the library.
"""

import os
import select
import socket
import struct
import time
from collections import defaultdict, deque

SECONDS = 20.0
"""The limit for waiting, in seconds. A test that passes does not reach it."""

# Kinds of objects, the low four bits of an id.
PARTICIPANT, TOPIC, PUBLISHER, SUBSCRIBER, WRITER, READER, REQUESTER, REPLIER = range(1, 9)
AGENT_ID = b"\xff\xfd"
CLIENT_ID = b"\xff\xfe"
BY_REFERENCE, BY_XML, IN_BINARY = 1, 2, 3
REUSE, REPLACE = 0x02, 0x04
OK = 0x00
# Bits of a binary endpoint's QoS.
RELIABLE, KEEP_LAST, TRANSIENT_LOCAL = 0x01, 0x02, 0x08
BEST_EFFORT_STREAM, RELIABLE_STREAM = 0x01, 0x80

CREATE_CLIENT, CREATE, GET_INFO, DELETE, STATUS_AGENT, STATUS, INFO, WRITE_DATA = range(8)
READ_DATA, DATA, ACKNACK, HEARTBEAT = 8, 9, 10, 11
FRAGMENT, TIMESTAMP, TIMESTAMP_REPLY = 13, 14, 15
LAST_FRAGMENT = 0x02

HEARTBEAT_SECONDS = 0.1
SESSION_ID = 0x81


def string(text):
    raw = text.encode() + b"\0"
    return struct.pack("<I", len(raw)) + raw


class Cdr(bytearray):
    """Little-endian CDR as Micro-CDR writes it: numbers at multiples of their size."""

    def number(self, form, *values):
        for value in values:
            self.extend(bytes(-len(self) % struct.calcsize(form)))
            self.extend(struct.pack("<" + form, value))
        return self

    def text(self, *texts):
        for value in texts:
            self.extend(bytes(-len(self) % 4))
            self.extend(string(value))
        return self


def object_id(number, kind):
    return struct.pack(">H", number << 4 | kind)


# --- links -------------------------------------------------------------------------------


class UdpLink:
    """A UDP socket, as in PX4's POSIX build. A reboot uses a new one."""

    def __init__(self, port):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)

    def fileno(self):
        return self._socket.fileno()

    def send(self, message):
        try:
            self._socket.send(message)
        except OSError:
            pass  # no agent listens (ECONNREFUSED): the library ignores that too

    def read(self):
        out = []
        while True:
            try:
                out.append(self._socket.recv(65536))
            except OSError:
                return out

    def close(self):
        self._socket.close()


def crc16(data):
    """CRC-16/ARC, bit by bit."""
    crc = 0
    for octet in data:
        crc ^= octet
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


_CRC = [crc16(bytes([octet])) for octet in range(256)]


def _crc16(data):
    crc = 0
    for octet in data:
        crc = crc >> 8 ^ _CRC[(crc ^ octet) & 0xFF]
    return crc


def stuffed(data):
    return data.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")


def unstuffed(data):
    return data.replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")


def framed(message, source=1, destination=0):
    head = bytes((source, destination)) + struct.pack("<H", len(message))
    return b"\x7e" + stuffed(head + message + struct.pack("<H", _crc16(message)))


class SerialLink:
    """A UART; ``fd`` is the vehicle's end of a pseudo-terminal. The vehicle has address 1."""

    def __init__(self, fd):
        self._fd = fd
        os.set_blocking(fd, False)
        self._came = b""

    def fileno(self):
        return self._fd

    def send(self, message):
        data = framed(message)
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                select.select([], [self._fd], [], SECONDS)

    def read(self):
        try:
            self._came += os.read(self._fd, 65536)
        except BlockingIOError:
            return []
        *frames, last = self._came.split(b"\x7e")
        self._came = b"\x7e" + last
        messages = [self._message(frame) for frame in (*frames, last)]
        if messages[-1] is not None:
            self._came = b""
        return [message for message in messages if message is not None]

    def _message(self, raw):
        octets = unstuffed(raw)
        size = 6 + struct.unpack_from("<H", octets, 2)[0] if len(octets) >= 4 else 0
        # A frame does not end after the first half of an escape.
        if not size or len(octets) != size or raw.endswith(b"\x7d"):
            return None
        message, crc = octets[4:-2], struct.unpack("<H", octets[-2:])[0]
        assert octets[:2] == b"\0\1" and crc == _crc16(message), octets
        return message

    def close(self):
        pass  # the test closes the pseudo-terminal


# --- the session ---------------------------------------------------------------------------


class Session:
    """``uxrSession`` with one stream of each kind.

    ``history`` is the depth of the reliable streams; their messages have at most ``slot`` bytes,
    four of which the library uses itself. Submessages are packed into one message until it is full;
    a submessage longer than a message is split into fragments.
    """

    def __init__(self, link, key, history, slot=512):
        self.link = link
        self.key = key
        self.mode = REPLACE  # the flags of CREATE
        self._history = history
        self._capacity = slot - 4
        self._request = 9
        self.statuses = {}
        self.infos = deque()
        self.samples = defaultdict(deque)  # object id → payloads of DATA
        self.times = deque()
        self.on_data = None  # called with (object id, payload) instead of storing it
        self.agent_status = None
        self._reset_streams()

    def _reset_streams(self):
        self._open = bytearray(4)
        self._waiting = deque()
        self._unacknowledged = {}
        self._sent = -1
        self._acknowledged = -1
        self._heartbeat_at = None
        self._best_effort = 0
        self._best_effort_in = 0xFFFF
        self._next_in = 0
        self._early = {}
        self._announced = -1
        self._fragments = b""

    # --- sending

    def fileno(self):
        return self.link.fileno()

    def _header(self, stream, number, session=SESSION_ID):
        return struct.pack("<BBH", session, stream, number & 0xFFFF)

    @staticmethod
    def submessage(kind, payload, flags=0):
        return struct.pack("<BBH", kind, flags | 1, len(payload)) + payload

    def _at_once(self, kind, payload, session=SESSION_ID):
        self.link.send(self._header(0, 0, session) + self.submessage(kind, payload))

    def request_id(self):
        self._request = 10 if self._request in (9, 0xFFFF) else self._request + 1
        return self._request

    def room(self):
        """The free slots in the history of the reliable stream."""
        return self._history - len(self._unacknowledged) - len(self._waiting)

    def buffer(self, kind, payload, flags=0):
        """Buffer a submessage for the reliable stream; False: there is no room, and it is lost."""
        whole = self.submessage(kind, payload, flags)
        pad = -len(self._open) % 4
        if len(self._open) + pad + len(whole) <= self._capacity:
            if self.room() < 1:
                return False
            self._open += bytes(pad) + whole
        elif 4 + len(whole) <= self._capacity:
            if self.room() < 2:
                return False
            self._close_message()
            self._open += whole
        else:
            return self._split(whole)
        return True

    def _split(self, whole):
        """Buffer fragments; the first one fills the rest of the open message."""
        if self.room() * (self._capacity - 8) < len(whole):
            return False
        self._open += bytes(-len(self._open) % 4)
        if len(self._open) + 4 >= self._capacity:
            self._close_message()
        while whole:
            part = whole[: self._capacity - len(self._open) - 4]
            whole = whole[len(part) :]
            self._open += self.submessage(FRAGMENT, part, 0 if whole else LAST_FRAGMENT)
            if whole:
                self._close_message()
        return True

    def _close_message(self):
        if len(self._open) > 4:
            self._waiting.append(bytes(self._open))
            self._open = bytearray(4)

    def flush(self):
        self._close_message()
        while self._waiting and len(self._unacknowledged) < self._history:
            self._sent += 1
            message = self._header(RELIABLE_STREAM, self._sent) + self._waiting.popleft()[4:]
            self._unacknowledged[self._sent] = message
            self.link.send(message)
        if self._unacknowledged and self._heartbeat_at is None:
            self._heartbeat_at = time.monotonic() + HEARTBEAT_SECONDS

    def tick(self):
        """Send a HEARTBEAT that is due; the seconds until the next one, or None."""
        self.flush()
        if self._heartbeat_at is None:
            return None
        now = time.monotonic()
        if now >= self._heartbeat_at:
            self._heartbeat_at = now + HEARTBEAT_SECONDS
            first, last = (self._acknowledged + 1) & 0xFFFF, self._sent & 0xFFFF
            self._at_once(HEARTBEAT, struct.pack("<HHB", first, last, RELIABLE_STREAM))
        return self._heartbeat_at - now

    def create(self, number, kind, form, content, parent):
        """Buffer a CREATE; its request id. ``parent`` is an object id, or a domain's number."""
        request = self.request_id()
        payload = struct.pack(">H", request) + object_id(number, kind) + bytes((kind, form, 0, 0))
        payload += (
            struct.pack("<I", len(content)) + content if form == IN_BINARY else string(content)
        )
        if kind == PARTICIPANT:
            payload += bytes(-len(payload) % 2) + struct.pack("<h", parent)
        else:
            payload += parent
        assert self.buffer(CREATE, payload, self.mode), "the stream is full"
        return request

    def participant_bin(self, number, domain, name):
        content = Cdr(b"\0")
        content += b"\0" if name is None else b"\1"
        if name is not None:
            content.text(name)
        return self.create(number, PARTICIPANT, IN_BINARY, bytes(content), domain)

    def topic_bin(self, number, participant, topic, type_name):
        content = Cdr().text(topic)
        content += b"\0\1"
        content.text(type_name)
        return self.create(number, TOPIC, IN_BINARY, bytes(content), participant)

    def group_bin(self, number, kind, participant):
        return self.create(number, kind, IN_BINARY, b"\0\0", participant)

    def endpoint_bin(self, number, kind, group, topic, flags, depth):
        content = Cdr(topic + b"\1")
        content.number("H", flags)
        content += b"\1" if depth else b"\0"
        if depth:
            content.number("H", depth)
        # No deadline, lifespan, user data. Writer: no strength. Reader: no time or content filter.
        content += bytes(4 if kind == WRITER else 5)
        return self.create(number, kind, IN_BINARY, bytes(content), group)

    def replier_bin(self, number, participant, name, types, topics):
        content = Cdr().text(name, *types)
        for topic in topics:
            content += b"\1"
            content.text(topic)
        return self.create(number, REPLIER, IN_BINARY, bytes(content), participant)

    def read_data(self, thing, stream):
        """Ask for an unlimited number of samples on ``stream``."""
        payload = struct.pack(">H", self.request_id()) + thing
        payload += bytes((stream, 0, 0, 1)) + struct.pack("<HHHH", 0xFFFF, 0, 0, 0)
        assert self.buffer(READ_DATA, payload), "the stream is full"

    def write_best_effort(self, writer, sample):
        head = struct.pack(">H", self.request_id()) + writer
        message = self._header(BEST_EFFORT_STREAM, self._best_effort)
        self._best_effort += 1
        self.link.send(message + self.submessage(WRITE_DATA, head + sample))

    def write_reliable(self, thing, sample):
        """Buffer WRITE_DATA; False: the history is full and the sample lost, as in ArduPilot."""
        head = struct.pack(">H", self.request_id()) + thing
        return self.buffer(WRITE_DATA, head + sample)

    # --- receiving

    def ready(self):
        for message in self.link.read():
            self.take(message)

    def take(self, message):
        session, stream, number = struct.unpack_from("<BBH", message)
        at = 8 if session < 0x80 else 4
        if session == 0x80 and message[at] == INFO:
            self.infos.append(message[at + 4 :])
        if session != SESSION_ID:
            return
        if stream < RELIABLE_STREAM:
            # Only a later number than the last: uxr_receive_best_effort_message.
            if stream and not 0 < (number - self._best_effort_in) & 0xFFFF < 0x8000:
                return
            if stream:
                self._best_effort_in = number
            self._submessages(message[at:])
            return
        ahead = (number - self._next_in) & 0xFFFF
        if ahead < self._history:
            self._early[number] = message[at:]
            self._announced = max(self._announced, self._next_in + ahead)
        while self._next_in & 0xFFFF in self._early:
            body = self._early.pop(self._next_in & 0xFFFF)
            self._next_in += 1
            self._submessages(body)
        self._acknowledge()

    def _acknowledge(self):
        missing = 0
        for bit in range(min(16, max(0, self._announced + 1 - self._next_in))):
            if (self._next_in + bit) & 0xFFFF not in self._early:
                missing |= 1 << bit
        first = struct.pack("<H", self._next_in & 0xFFFF)
        self._at_once(ACKNACK, first + struct.pack(">H", missing) + bytes((RELIABLE_STREAM,)))

    def _submessages(self, body):
        at = 0
        while at + 4 <= len(body):
            kind, flags, size = struct.unpack_from("<BBH", body, at)
            assert flags & 1 and at + 4 + size <= len(body), body.hex()
            self._submessage(kind, flags, body[at + 4 : at + 4 + size])
            at += 4 + size + -size % 4

    def _submessage(self, kind, flags, payload):
        if kind == STATUS_AGENT:
            self.agent_status = payload[0]
        elif kind == STATUS:
            self.statuses[struct.unpack(">H", payload[:2])[0]] = payload[4]
        elif kind == DATA:
            thing, sample = payload[2:4], payload[4:]
            if self.on_data is not None:
                self.on_data(thing, sample)
            else:
                self.samples[thing].append(sample)
        elif kind == INFO:
            self.infos.append(payload)
        elif kind == TIMESTAMP_REPLY:
            self.times.append(struct.unpack("<iIiIiI", payload))
        elif kind == HEARTBEAT:
            last = struct.unpack_from("<H", payload, 2)[0]
            self._announced = (
                self._next_in
                + struct.unpack("<h", struct.pack("<H", (last - self._next_in) & 0xFFFF))[0]
            )
            self._acknowledge()
        elif kind == ACKNACK:
            first = struct.unpack_from("<H", payload)[0]
            self._acknowledged_to(first, struct.unpack_from(">H", payload, 2)[0])
        elif kind == FRAGMENT:
            self._fragments += payload
            if flags & LAST_FRAGMENT:
                whole, self._fragments = self._fragments, b""
                self._submessages(whole)
        elif kind == GET_INFO:
            self._at_once(INFO, payload[:4] + bytes(4))

    def _acknowledged_to(self, first, missing):
        count = (first - 1 - self._acknowledged) & 0xFFFF
        if count > self._history:
            return  # an old ACKNACK
        for _ in range(count):
            self._acknowledged += 1
            self._unacknowledged.pop(self._acknowledged, None)
        if missing:
            for message in self._unacknowledged.values():
                self.link.send(message)
        self._heartbeat_at = None
        self.flush()

    # --- the library's calls

    def ping(self, session=0x80):
        """Send a ping; :attr:`infos` gets the answer."""
        self._at_once(GET_INFO, b"\0\x0a" + AGENT_ID + struct.pack("<I", 2), session)

    def pong(self):
        """The result of ``uxr_ping_agent_session``: 1 in session, 2 not, 0 for no answer."""
        if not self.infos:
            return 0
        info = self.infos.popleft()
        at = 7
        if info[6]:  # the configuration: of an agent, without properties
            assert info[7:12] == b"\x0dXRCE" and not info[16], info.hex()
            at = 17
        assert info[at : at + 2] == b"\x01\x0d", info.hex()
        at += 2 + at % 2
        if struct.unpack_from("<h", info, at)[0] <= 0:
            return 0
        return 1 if info[5] else 2

    def create_client(self):
        """Send CREATE_CLIENT."""
        self._reset_streams()
        self.agent_status = None
        payload = b"XRCE\1\0\1\x0f" + struct.pack(">I", self.key)
        payload += bytes((SESSION_ID, 0)) + struct.pack("<H", 508)
        self._at_once(CREATE_CLIENT, payload, 0x80)
        self._request = 9

    def delete_client(self):
        """Send DELETE of the client; its request id is 2."""
        self._at_once(DELETE, b"\0\2" + CLIENT_ID)

    def ask_time(self, seconds, nanoseconds):
        self._at_once(TIMESTAMP, struct.pack("<iI", seconds, nanoseconds))


def until(done, *parts, seconds=SECONDS, what="it does not come"):
    """Serve ``parts`` (``fileno``, ``ready``, ``tick``) until ``done()``, or fail with ``what``."""
    if not wait(done, *parts, seconds=seconds):
        raise AssertionError(what() if callable(what) else what)


def wait(done, *parts, seconds):
    """Serve ``parts`` until ``done()``, for at most ``seconds``; whether it was done in time."""
    end = time.monotonic() + seconds
    while True:
        due = [wait_s for wait_s in [part.tick() for part in parts] if wait_s is not None]
        if done():
            return True
        left = end - time.monotonic()
        if left <= 0:
            return False
        ready = select.select(parts, [], [], max(0.0, min([left, *due])))[0]
        for part in ready:
            part.ready()


class Vehicle:
    """The common part of PX4's and ArduPilot's clients: requests that wait for their answers."""

    history = 4

    def __init__(self, link, key):
        self.session = Session(link, key, self.history)
        self.others = ()  # served while it waits

    def until(self, done, what="it does not come", seconds=SECONDS):
        until(done, self.session, *self.others, seconds=seconds, what=what)

    def find_agent(self):
        session = self.session
        session.infos.clear()
        for _ in range(20):
            session.ping()
            if wait(lambda: session.infos, session, *self.others, seconds=1.0):
                session.infos.clear()
                return
        raise AssertionError("no agent answers")

    def open(self):
        session = self.session
        session.create_client()
        self.until(lambda: session.agent_status is not None, "no answer to CREATE_CLIENT")
        assert session.agent_status == OK, session.agent_status

    def all_status(self, *requests):
        """Wait for the statuses of requests, as ``uxr_run_session_until_all_status`` does."""
        statuses = self.session.statuses
        self.until(lambda: all(request in statuses for request in requests), "a STATUS is missing")
        return [statuses.pop(request) for request in requests]

    def must(self, entity, *requests):
        """Check that the agent accepts the requests of an entity."""
        statuses = self.all_status(*requests)
        assert statuses == [OK] * len(requests), f"{entity}: {statuses}"

    def in_session(self, seconds=SECONDS):
        """``uxr_ping_agent_session``: whether the agent knows this session."""
        session = self.session
        session.infos.clear()
        session.ping(SESSION_ID)
        wait(lambda: session.infos, session, *self.others, seconds=seconds)
        return session.pong() == 1

    def lost(self):
        """Whether three pings in a row get no answer, as both clients count them."""
        return not any(self.in_session(0.2) for _ in range(3))

    def land(self):
        """Close the session. An agent confirms that for an unknown session too."""
        session = self.session
        session.statuses.clear()
        session.delete_client()
        self.until(lambda: 2 in session.statuses, "no answer to the DELETE of the client")

    def settle(self):
        """Wait until the agent has acknowledged the whole reliable stream."""
        self.until(
            lambda: not self.session._unacknowledged and not self.session._waiting,
            "the agent does not acknowledge",
        )
