"""A client with the reliable streams of eProsima's C client, which never creates a new session.

Its streams are modelled after ``output_reliable_stream.c`` and ``input_reliable_stream.c``, with
the behaviour that matters when an agent restarts: the client frees every message that an ACKNACK
acknowledges, accepts no sequence number twice, uses only the last number of a HEARTBEAT, and waits
for ever for a missing message.
An ACKNACK below the acknowledged sequence number would make the C client go through all sequence
numbers and lose its history; here it raises AssertionError.
"""

import select
import socket
import time

from uros.wire import data, entities, ids, session
from uros.wire.cdr import Reader, Writer
from uros.wire.header import MessageWriter

HISTORY = 16
HEARTBEAT = 0.1
FRAGMENT_ROOM = 488


def _ahead(a, b):
    """``a - b``, signed."""
    return ((a - b + 0x8000) & 0xFFFF) - 0x8000


class StubbornClient:
    """A client with a session at the agent on ``port`` of this machine.

    ``acknowledged`` counts messages of its reliable stream; ``samples`` are payloads of DATA.
    """

    def __init__(self, port, key, session_id=0x81):
        self.key = key
        self.session_id = session_id
        self._connect(port)
        # As C clients that run their session more often than each 100 ms.
        self.without_heartbeats = False
        self.last_acknown = 0xFFFF
        self.last_sent = 0xFFFF
        self._out = {}
        self.acknowledged = 0
        self._beat_at = 0.0
        self.last_handled = 0xFFFF
        self._announced = 0xFFFF
        self._in = {}
        self._best_effort_in = 0xFFFF
        self._best_effort_out = 0
        self.samples = []
        self.statuses = {}
        self._agent_status = None
        self._request = 0
        self._open()

    def close(self):
        self.sock.close()

    # --- transport to the agent: a test may override it ------------------------------------

    def _connect(self, port):
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", 0))
        self._address = ("127.0.0.1", port)

    def _send(self, message):
        try:
            self.sock.sendto(message, self._address)
        except OSError:  # no agent listens now
            pass

    def _receive(self, seconds):
        """A message that arrives within ``seconds``, or None."""
        if not select.select([self.sock], [], [], seconds)[0]:
            return None
        try:
            return self.sock.recv(65536)
        except OSError:
            return None

    def _now(self):
        return time.monotonic()

    # --- out -----------------------------------------------------------------------------

    def _header(self, stream, number):
        head = bytes((self.session_id, stream, number & 0xFF, number >> 8))
        return head if self.session_id & 0x80 else head + self.key.to_bytes(4, "big")

    @property
    def room(self):
        return HISTORY - len(self._out)

    def put(self, kind, payload, flags=1):
        """Send a submessage on the reliable stream, in fragments where it is long.

        The caller has checked :attr:`room`.
        """
        size = len(payload)
        whole = bytes((kind, flags, size & 0xFF, size >> 8)) + payload
        parts = [whole]
        if len(whole) > FRAGMENT_ROOM + 4:
            pieces = [whole[at : at + FRAGMENT_ROOM] for at in range(0, len(whole), FRAGMENT_ROOM)]
            flags = [1] * (len(pieces) - 1) + [1 | ids.FLAG_LAST_FRAGMENT]
            parts = [
                bytes((ids.FRAGMENT, flag, len(piece) & 0xFF, len(piece) >> 8)) + piece
                for flag, piece in zip(flags, pieces, strict=True)
            ]
        assert len(parts) <= self.room
        for part in parts:
            self.last_sent = (self.last_sent + 1) & 0xFFFF
            message = self._out[self.last_sent] = (
                self._header(ids.STREAM_RELIABLE, self.last_sent) + part
            )
            self._send(message)

    def write(self, thing, cdr):
        """Send WRITE_DATA; the value of ``acknowledged`` once it is acknowledged."""
        self._request = (self._request + 1) & 0x7FFF or 1
        self.put(ids.WRITE_DATA, self._request.to_bytes(2, "big") + thing.to_bytes(2, "big") + cdr)
        return self.acknowledged + len(self._out)

    def write_best_effort(self, thing, cdr):
        payload = bytes((0, 9)) + thing.to_bytes(2, "big") + cdr
        head = bytes((ids.WRITE_DATA, 1, len(payload) & 0xFF, len(payload) >> 8))
        self._send(self._header(1, self._best_effort_out) + head + payload)
        self._best_effort_out = (self._best_effort_out + 1) & 0xFFFF

    def _single(self, kind, push, *values):
        w = MessageWriter(bytearray(256), self.session_id, 0, 0, self.key)
        w.begin(kind)
        push(w, *values)
        self._send(w.finish())

    def _beat(self):
        now = self._now()
        if not self._out or self.without_heartbeats:
            self._beat_at = now + HEARTBEAT
        elif now >= self._beat_at:
            self._beat_at = now + HEARTBEAT
            first = (self.last_acknown + 1) & 0xFFFF
            self._single(
                ids.HEARTBEAT, session.push_heartbeat, first, self.last_sent, ids.STREAM_RELIABLE
            )

    def _acknack(self, first, missing):
        steps = (first - 1 - self.last_acknown) & 0xFFFF
        assert steps <= len(self._out), (
            f"client {self.key:X}: the agent expects {first}; sent: {self.last_sent},"
            f" acknowledged before: {self.last_acknown}"
        )
        for _ in range(steps):
            self.last_acknown = (self.last_acknown + 1) & 0xFFFF
            del self._out[self.last_acknown]
        self.acknowledged += steps
        if missing:
            for message in self._out.values():
                self._send(message)

    # --- in ------------------------------------------------------------------------------

    def turn(self, seconds):
        """Process one message that arrives within ``seconds``; whether one arrived."""
        self._beat()
        message = self._receive(seconds)
        if message is None:
            return False
        at = 4 if message[0] & 0x80 else 8
        stream, number, body = message[1], message[2] | message[3] << 8, message[at:]
        if stream >= ids.STREAM_RELIABLE:
            self._reliable(number, body)
            self._tell()
        elif not stream or _ahead(number, self._best_effort_in) > 0:
            if stream:
                self._best_effort_in = number
            self._submessages(body)
        return True

    def until(self, done, what, seconds=20.0):
        end = self._now() + seconds
        while not done():
            assert self._now() < end, f"client {self.key:X}: {what}, {vars(self)}"
            self.turn(0.05)

    def _reliable(self, number, body):
        if 0 < _ahead(number, self.last_handled) <= HISTORY:
            following = (self.last_handled + 1) & 0xFFFF
            if body[0] != ids.FRAGMENT and number == following:
                self.last_handled = number
                self._submessages(body)
            else:
                self._in.setdefault(number, body)
            while self._next():
                pass
        if _ahead(number, self._announced) > 0:
            self._announced = number

    def _next(self):
        """Process the next message if it is stored, whole or in fragments; whether it was."""
        whole, number = b"", self.last_handled
        while True:
            number = (number + 1) & 0xFFFF
            body = self._in.get(number)
            if body is None or (whole and body[0] != ids.FRAGMENT):
                return False
            if body[0] != ids.FRAGMENT:
                whole = body
                break
            whole += body[4 : 4 + (body[2] | body[3] << 8)]
            if body[1] & ids.FLAG_LAST_FRAGMENT:
                break
        while self.last_handled != number:
            self.last_handled = (self.last_handled + 1) & 0xFFFF
            del self._in[self.last_handled]
        self._submessages(whole)
        return True

    def _tell(self):
        """Send ACKNACK."""
        first = self.last_handled
        for ahead in range(1, HISTORY + 1):
            if (self.last_handled + ahead) & 0xFFFF not in self._in:
                first = (self.last_handled + ahead) & 0xFFFF
                break
        count = (self._announced + 1 - first) & 0xFFFF
        missing = 0
        for index in range(min(16, count) if count < 0x8000 else 0):
            if (first + index) & 0xFFFF not in self._in:
                missing |= 1 << index
        self._single(ids.ACKNACK, session.push_acknack, first, missing, ids.STREAM_RELIABLE)

    def _submessages(self, body):
        at = 0
        while at + 4 <= len(body):
            kind, flags, size = body[at], body[at + 1], body[at + 2] | body[at + 3] << 8
            payload = body[at + 4 : at + 4 + size]
            r = Reader(payload, 0, len(payload), bool(flags & 1))
            if kind == ids.STATUS_AGENT:
                self._agent_status = session.pull_status_agent(r)[0]
            elif kind == ids.STATUS:
                request, _, status, _ = session.pull_status(r)
                self.statuses[request] = status
            elif kind == ids.DATA:
                self.samples.append(payload[4:])
            elif kind == ids.ACKNACK:
                first, missing, stream = session.pull_acknack(r)
                if stream == ids.STREAM_RELIABLE:
                    self._acknack(first, missing)
            elif kind == ids.HEARTBEAT:
                _, last, stream = session.pull_heartbeat(r)
                if stream == ids.STREAM_RELIABLE:
                    if _ahead(last, self._announced) > 0:
                        self._announced = last
                    self._tell()
            at += 4 + size + (-size & 3)

    # --- requests ----------------------------------------------------------------------------

    def _open(self):
        w = MessageWriter(bytearray(128), self.session_id & 0x80, ids.STREAM_NONE, 0, self.key)
        w.begin(ids.CREATE_CLIENT)
        session.push_create_client(w, self.key, self.session_id, 512)
        self._send(w.finish())
        self.until(lambda: self._agent_status is not None, "no session")
        assert self._agent_status == ids.STATUS_OK

    def request(self, kind, push, thing, *values, wait=True):
        self._request += 1
        w = Writer(bytearray(4096))
        push(w, self._request, thing, *values)
        number = self._request
        self.until(lambda: self.room > 0, "acknowledges nothing")
        self.put(kind, bytes(w.buf[: w.offset]))
        if wait:
            self.until(lambda: number in self.statuses, f"no STATUS for 0x{thing:04X}")
            assert self.statuses[number] == ids.STATUS_OK, ids.status_name(self.statuses[number])
        return thing

    def create(self, thing, parent, push, *values, **named):
        w = Writer(bytearray(1024))
        push(w, *values, **named)
        content = bytes(w.buf[: w.offset])
        return self.request(ids.CREATE, entities.push_create, thing, ids.IN_BINARY, content, parent)

    def topic(self, name, type_name):
        """Create a participant and a topic, numbered 1."""
        self.create(0x11, 0, entities.push_binary_participant, f"board_{self.key:x}", None)
        self.create(0x12, 0x11, entities.push_binary_topic, name, type_name)

    def writer(self, qos=ids.QOS_RELIABLE | ids.QOS_KEEP_LAST, depth=200):
        self.create(0x13, 0x11, entities.push_binary_group, None, None)
        return self.create(0x15, 0x13, entities.push_binary_endpoint, 0x12, qos, depth)

    def reader(self, stream=ids.STREAM_RELIABLE, qos=ids.QOS_RELIABLE | ids.QOS_KEEP_LAST):
        self.create(0x14, 0x11, entities.push_binary_group, None, None)
        self.create(0x16, 0x14, entities.push_binary_endpoint, 0x12, qos, 200, reader=True)
        control = (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0)
        self.request(ids.READ_DATA, data.push_read_data, 0x16, stream, 0, None, control, wait=False)
        return 0x16
