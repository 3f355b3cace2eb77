"""XRCE session on the client's side: datagrams in, datagrams out, without I/O and without a clock.

Requests and reliable samples are sent on stream 0x80 in the order they are made. The window limits
the number of messages in flight; later messages are queued, and no method waits for the agent.
Buffers of messages in flight are reused: once they are allocated, sending a sample allocates
nothing. Times are integer milliseconds modulo 2^30, given by the caller.
"""

from struct import pack_into, unpack_from

from ..ticks import ticks_add, ticks_diff
from ..wire import ids
from ..wire.cdr import Writer
from ..wire.errors import DecodeError, EncodeError, WireError
from ..wire.streams import (
    HEARTBEAT_MS,
    RESEND_HOLD_MS,
    SEQUENCE_MASK,
    WINDOW,
    BestEffortIn,
    Fragments,
    ReliableIn,
)

try:
    from typing import Any, Callable, Final

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

FIRST_SESSION_ID: Final = 0x81
LAST_SESSION_ID: Final = 0xFE
# Smaller request ids are reserved (XRCE 7.7.3.1).
FIRST_REQUEST: Final = 10
DELETE_CLIENT_REQUEST: Final = 9  # ends the session
# Offsets in a message: of its submessage header, of a request's two ids, and of the sample.
_SUBHEADER: Final = 4
_IDS: Final = 8
_SAMPLE: Final = 12
# Longest request, unless the MTU is larger. A request for an object with long names does not fit
# the 63 bytes of a CAN frame and is sent in fragments.
MAX_REQUEST: Final = 512
# Bit mask of the ring of slots.
_RING: Final = WINDOW - 1
# Bit mask of buffer lengths, which are multiples of 32, so that a sample slightly longer than the
# one before fits the same buffer.
_ROUND: Final = 31
# Shortest valid payload of each submessage kind that agents send; shorter ones are malformed.
_LEAST: Final = b"\0\0\0\0\1\6\6\0\0\4\5\5\0\0\0\30"


class Session:
    """XRCE session of a client.

    The transport's ``send(buf, size)`` is called with each datagram to send. Subclasses implement
    the handlers of the agent's messages:

    * ``on_agent(status)``: the session was opened or refused.
    * ``on_pong()``: there is an agent.
    * ``on_unknown()``: the agent does not know the session.
    * ``on_status(request_id, status)``: the result of a request.
    * ``on_time(transmit, receive)``: the agent's time of sending and of receiving.
    * ``on_data(object_id, buf, start, stop, little)``: a sample. The buffer belongs to the caller
      and is valid until the call returns.
    * ``on_line(error)``: the transport raised OSError.

    ``now`` is the time of the last call that passed one.

    Args:
        transport: Its ``mtu`` is the largest datagram in bytes.
        key: The client key.
        limit: Most bytes that may wait in either direction; a larger sample can be neither sent nor
            received.
    """

    on_agent: "Callable[[int], object]"
    on_pong: "Callable[[], object]"
    on_unknown: "Callable[[], object]"
    on_status: "Callable[[int, int], object]"
    on_time: "Callable[[tuple[int, ...], tuple[int, ...]], object]"
    on_data: "Callable[[int, Buffer, int, int, bool], object]"
    on_line: "Callable[[OSError], object]"

    def __init__(self, transport: "Any", key: int, limit: int) -> None:
        self.transport = transport
        self.key = key
        self.id = FIRST_SESSION_ID
        mtu: int = transport.mtu
        self.mtu = mtu
        self.limit = limit
        self.now = 0
        self.ready = False  # whether samples may be written; set by make_ready
        self.oom_count = 0  # MemoryErrors while a datagram was sent or read
        self.dropped = 0  # datagrams that were malformed, or for another session
        self._fragments = Fragments(limit)
        self._part = (mtu - _IDS) & ~3  # octets in a fragment
        self._nothing = (None,) * (WINDOW + 1)
        self._reset()

    def _reset(self) -> None:
        self.request_id = FIRST_REQUEST
        self.next = 0  # number of the next message to send
        self.acked = 0  # first number not acknowledged
        self.deadline: "int | None" = None  # when tick() has something to send, as ticks
        self.waiting: "list[Any]" = []  # messages queued behind the window
        self._queued = 0  # bytes of the queued messages that are in memory
        self._split_at = 0  # octets of the first queued message already sent in fragments
        self._in = ReliableIn()
        self._best_in = BestEffortIn()
        self._best_out = SEQUENCE_MASK  # the last number sent
        self._fragments.drop()
        self._acknowledge = False
        self._asked: "tuple[int, int] | None" = None  # the time in the last TIMESTAMP
        self.trim()

    def renew(self) -> None:
        """Reset the state for a new session.

        The new session has another id, so that late datagrams of this session are not accepted.
        """
        self.id = FIRST_SESSION_ID if self.id >= LAST_SESSION_ID else self.id + 1
        self._reset()

    def trim(self) -> None:
        """Free the buffers that hold no message in flight."""
        if not self.in_flight():
            # By sequence number: the buffers of messages in flight, and when they were resent.
            self.slots: "list[bytearray | None]" = [None] * WINDOW
            self._again_at = [0] * WINDOW
        # Idle buffers are a stack of ``free`` entries, from index 1 on; index 0 is None.
        self._idle: "list[bytearray | None]" = [None] * (WINDOW + 1)
        self.free = 0
        # For publishers. It is the stack of idle buffers while samples may be written and the last
        # one was sent at once in one message; the next one will be, too, if it fits the top buffer.
        # Otherwise it is a stack of None.
        self.stack: "Any" = self._nothing
        # Buffer of messages that are never resent, and of requests under construction.
        self._spare = bytearray(_ROUND + 1)

    def in_flight(self) -> int:
        """Return the number of messages sent and not acknowledged."""
        return (self.next - self.acked) & SEQUENCE_MASK

    def held(self) -> int:
        """Return the number of messages in flight and waiting."""
        return self.in_flight() + len(self.waiting)

    def size(self) -> int:
        """Return the bytes of the messages held."""
        size = self._queued
        for i in range(self.in_flight()):
            size += self._size(self.slots[(self.acked + i) & _RING])
        return size

    def _size(self, buf: "Any") -> int:
        """Return the length of a message in flight, which has one submessage."""
        length: int = buf[6] | buf[7] << 8
        return length + _IDS

    def make_ready(self, ready: bool) -> None:
        """Set whether samples may be written."""
        self.ready = ready
        self.stack = self._nothing

    def available(self) -> bool:
        """Return whether a request made now would be sent at once."""
        return not self.waiting and self.in_flight() < WINDOW

    # --- messages without a stream ------------------------------------------------------------

    def _short(self, session_id: int, kind: int, payload: "Buffer") -> None:
        buf = self._spare
        pack_into("<BBHBBH", buf, 0, session_id, ids.STREAM_NONE, 0, kind, 1, len(payload))
        size = _IDS + len(payload)
        buf[_IDS:size] = payload
        self.send(buf, size)

    def ping(self, inside: bool) -> None:
        """Send GET_INFO.

        Args:
            inside: Send it in the session, to ask whether the agent knows the session.
        """
        self._short(
            self.id if inside else ids.SESSION_NONE_WITHOUT_KEY, ids.GET_INFO,
            b"\0\x0a\xff\xfd\2\0\0\0",  # request 10, the agent, its activity
        )  # fmt: skip

    def create_session(self) -> None:
        """Send CREATE_CLIENT."""
        payload = bytearray(b"XRCE\1\0\1\x0f....\0\0..")
        pack_into(">IB", payload, 8, self.key, self.id)
        pack_into("<H", payload, 14, self.mtu)
        self._short(ids.SESSION_NONE_WITHOUT_KEY, ids.CREATE_CLIENT, payload)

    def delete_session(self) -> None:
        """Send DELETE of the client, which ends the session at the agent.

        ``on_status`` gets the answer as that of request DELETE_CLIENT_REQUEST.
        """
        self._short(self.id, ids.DELETE, b"\0\x09\xff\xfe")

    def ask_time(self, seconds: int, nanoseconds: int) -> None:
        """Send TIMESTAMP with our time; ``on_time`` gets the reply to the last one, once."""
        self._asked = (seconds & 0xFFFFFFFF, nanoseconds)
        asked = bytearray(8)
        pack_into("<II", asked, 0, self._asked[0], nanoseconds)
        self._short(self.id, ids.TIMESTAMP, asked)

    # --- requests and samples -----------------------------------------------------------------

    def begin(self, object_id: int) -> Writer:
        """Begin a request about an object; return the writer for what follows the two ids."""
        size = max(self.mtu, MAX_REQUEST)
        if len(self._spare) < size:
            self._spare = bytearray(size)
        w = Writer(self._spare, _IDS)
        w.be16(self.request_id)
        w.be16(object_id)
        return w

    def request(self, kind: int, flags: int, w: Writer) -> int:
        """Send the request begun by :meth:`begin` on the reliable stream; return its id.

        Raises:
            EncodeError: The request is longer than the MTU and MAX_REQUEST.
        """
        size = w.offset
        buf = self._slot(size) if size <= self.mtu and self.available() else bytearray(size)
        buf[:size] = memoryview(self._spare)[:size]
        return self._put(buf, size, kind, flags)

    def write(self, object_id: int, message: "Any", prefix: bytes, reliable: "bool | int") -> int:
        """Send WRITE_DATA of a generated message behind ``prefix``.

        Returns:
            The request id, or 0 if the session is not ready or the queue is full; then nothing was
            sent.

        Raises:
            EncodeError: The sample is too large to be ever sent. Errors of packing are passed on;
                nothing is sent in part.
        """
        if not self.ready:
            return 0
        start = _SAMPLE + len(prefix)
        size: int = start + message.cdr_size()
        buf = self._buffer(size, message, reliable)
        if buf is None:
            return 0
        message.pack_into(buf, start, start)
        buf[_SAMPLE:start] = prefix
        pack_into(">HH", buf, _IDS, self.request_id, object_id)
        if reliable:
            return self._put(buf, size, ids.WRITE_DATA, ids.FLAG_LITTLE_ENDIAN)
        self._best_out = (self._best_out + 1) & SEQUENCE_MASK
        pack_into(
            "<BBHBBH", buf, 0, self.id, ids.STREAM_BEST_EFFORT, self._best_out,
            ids.WRITE_DATA, ids.FLAG_LITTLE_ENDIAN, size - _IDS,
        )  # fmt: skip
        self.send(buf, size)
        return self.next_request()

    def _buffer(self, size: int, message: "Any", reliable: "bool | int") -> "bytearray | None":
        """Return a buffer for a sample of ``size`` bytes, or None if the queue is full."""
        most = self.limit if reliable else self.mtu
        if size > most:
            raise EncodeError(
                "%s takes %d bytes, the %s allows %d"
                % (message._TYPE, size, "limit" if reliable else "mtu of best effort", most)
            )
        if not reliable:
            if len(self._spare) < size:
                self._spare = bytearray(size | _ROUND)
            return self._spare
        if size + self.size() > self.limit:
            return None
        if size <= self.mtu and self.available():
            if self.limit >= WINDOW * self.mtu:  # a full window is below the limit
                self.stack = self._idle
            return self._slot(size)
        self.stack = self._nothing
        return bytearray(size)

    def next_request(self) -> int:
        """Take the next request id."""
        request = self.request_id
        self.request_id = request + 1 & 0xFFFF or FIRST_REQUEST
        return request

    # --- the reliable stream out --------------------------------------------------------------

    def _slot(self, size: int) -> bytearray:
        """Return the top of the stack of idle buffers, with ``size`` bytes or more.

        An idle buffer that is long enough is moved to the top; otherwise a new one replaces the
        top. There are never more buffers than were in flight at once.
        """
        idle = self._idle
        top = self.free
        for i in range(top, 0, -1):
            buf: "Any" = idle[i]
            if len(buf) >= size:
                idle[i] = idle[top]
                idle[top] = buf
                return buf  # type: ignore[no-any-return]
        if top:
            self.free = top - 1
        else:
            top = 1
        buf = idle[top] = bytearray(min(size | _ROUND, self.mtu))
        self.free = top
        return buf  # type: ignore[no-any-return]

    def _put(self, buf: bytearray, size: int, kind: int, flags: int) -> int:
        """Send or queue a submessage that is complete except for its header; return its request id.

        It is sent now if ``buf`` is the top of the stack of idle buffers, otherwise when the window
        reaches it.
        """
        # Over 64 kB the length is 0: eProsima's agent then takes the rest of the message.
        length = size - _IDS if size - _IDS <= 0xFFFF else 0
        pack_into("<BBH", buf, _SUBHEADER, kind, flags, length)
        if buf is self._idle[self.free]:
            self._launch(buf, size)
        else:
            self.defer(buf)
        return self.next_request()

    def defer(self, buf: "Any") -> None:
        """Queue a complete message, or a source of its parts, until the window reaches it."""
        self.stack = self._nothing
        self.waiting.append(buf)
        if isinstance(buf, bytearray):
            self._queued += len(buf)
        try:
            self._flush()
        except MemoryError:  # the message is queued, and sent when memory is free
            self.oom_count += 1

    def _launch(self, buf: bytearray, size: int) -> None:
        """Send a complete message, the top of the stack, with the next sequence number."""
        i = self.next & _RING
        pack_into("<BBH", buf, 0, self.id, ids.STREAM_RELIABLE, self.next)
        self.free -= 1
        self.slots[i] = buf
        self.next = (self.next + 1) & SEQUENCE_MASK
        self.send(buf, size)

    def send(self, buf: bytearray, size: int) -> None:
        """Send a datagram; it is lost if the transport raises."""
        try:
            self.transport.send(buf, size)
        except Exception as error:
            self.unsent(error)

    def unsent(self, error: Exception) -> None:
        """Handle an exception of the transport.

        OSError is passed to ``on_line``, MemoryError is counted, other exceptions are raised.
        """
        if isinstance(error, OSError):
            self.on_line(error)
        elif isinstance(error, MemoryError):  # reliable messages are resent
            self.oom_count += 1
        else:
            raise error

    def _flush(self) -> None:
        """Send queued messages as far as the window reaches, in fragments if longer than the MTU.

        After a MemoryError the next call resumes at the same place.
        """
        while self.waiting and self.in_flight() < WINDOW:
            whole = self.waiting[0]
            size = len(whole)
            first = self._split_at or _SUBHEADER
            stop = size
            head = first
            if size > self.mtu:
                stop = min(size, first + self._part)
                head = _IDS
            part = self._slot(head + stop - first)
            if isinstance(whole, bytearray):
                part[head : head + stop - first] = memoryview(whole)[first:stop]
            else:
                whole.fill(part, head, first, stop)
            if size > self.mtu:
                flags = ids.FLAG_LITTLE_ENDIAN
                if stop == size:
                    flags |= ids.FLAG_LAST_FRAGMENT
                pack_into("<BBH", part, _SUBHEADER, ids.FRAGMENT, flags, stop - first)
            self._split_at = stop
            try:
                if stop == size:
                    self._split_at = 0
                    if isinstance(whole, bytearray):
                        self._queued -= size
                    self.waiting.pop(0)
            finally:  # pop() may raise MemoryError: shrinking a list allocates
                self._launch(part, head + stop - first)

    def _acknowledged(self, first: int, missing: int) -> None:
        """Free acknowledged messages, resend missing ones, then send queued ones.

        An ACKNACK for numbers never sent is a fault of the agent and is ignored.
        """
        if (first - self.acked) & SEQUENCE_MASK > self.in_flight():
            return
        news = self.acked != first or missing
        while self.acked != first:
            i = self.acked & _RING
            self.free += 1
            self._idle[self.free] = self.slots[i]
            self._again_at[i] = 0
            self.acked = (self.acked + 1) & SEQUENCE_MASK
        held_back = False
        again = self._again_at
        while missing and first != self.next:
            i = first & _RING
            if missing & 1:
                if again[i] and ticks_diff(self.now, again[i]) < RESEND_HOLD_MS:
                    held_back = True
                else:
                    again[i] = self.now or 1
                    buf: "Any" = self.slots[i]
                    self.send(buf, self._size(buf))
            missing >>= 1
            first = (first + 1) & SEQUENCE_MASK
        self._flush()
        if self.acked == self.next:
            self.deadline = None
        elif held_back:
            self.deadline = ticks_add(self.now, RESEND_HOLD_MS)
        elif news:
            # Not at every ACKNACK: repeated ones would postpone the HEARTBEAT for ever.
            self.deadline = ticks_add(self.now, HEARTBEAT_MS)

    # --- time ---------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """Send ACKNACK and HEARTBEAT if due.

        ``deadline`` is when the next one is due if nothing is received before.
        """
        self.now = now
        self._flush()
        if self.deadline is None and self.next != self.acked:
            self.deadline = ticks_add(now, HEARTBEAT_MS)
        if self._acknowledge:
            self._acknowledge = False
            first, missing = self._in.acknack()
            missing = missing >> 8 | (missing & 0xFF) << 8
            self._report(ids.ACKNACK, first, missing)
        if self.deadline is not None and ticks_diff(now, self.deadline) >= 0:
            self.deadline = ticks_add(now, HEARTBEAT_MS)
            self._report(ids.HEARTBEAT, self.acked, (self.next - 1) & SEQUENCE_MASK)

    def _report(self, kind: int, first: int, second: int) -> None:
        pack_into(
            "<BBHBBHHHB", self._spare, 0, self.id, ids.STREAM_NONE, 0, kind,
            ids.FLAG_LITTLE_ENDIAN, 5, first, second, ids.STREAM_RELIABLE,
        )  # fmt: skip
        self.send(self._spare, 13)

    # --- receiving ----------------------------------------------------------------------

    def receive(self, message: "Buffer", now: int) -> bool:
        """Process any datagram; return whether it is the agent's and for this session."""
        self.now = now
        if len(message) < _IDS:
            self.dropped += 1
            return False
        if message[0] != self.id:
            if message[0] == ids.SESSION_NONE_WITHOUT_KEY and message[_SUBHEADER] == ids.INFO:
                self.on_pong()
            else:
                self.dropped += 1
            return False
        stream = message[1]
        number = message[2] | message[3] << 8
        if stream == ids.STREAM_RELIABLE:
            self._acknowledge = True
            if self._in.receive(number, memoryview(message)[_SUBHEADER:]):
                self._read(message, _SUBHEADER)
                self._catch_up()
        elif stream == ids.STREAM_NONE:
            self._read(message, _SUBHEADER)
        elif stream == ids.STREAM_BEST_EFFORT and self._best_in.accept(number, now):
            self._read(message, _SUBHEADER)
        return True

    def _read(self, buf: "Buffer", at: int) -> None:
        """Handle a message; a malformed one is counted and does not block later ones."""
        try:
            self._submessages(buf, at, len(buf))
        except WireError:
            self.dropped += 1
        except MemoryError:
            if buf[at] == ids.FRAGMENT:  # it is not resent, so its message stays incomplete
                self._fragments.drop(buf[at + 1] & ids.FLAG_LAST_FRAGMENT)
            raise

    def _catch_up(self) -> None:
        body = self._in.pop()
        while body is not None:
            self._read(body, 0)
            body = self._in.pop()

    def _submessages(self, buf: "Buffer", at: int, end: int) -> None:
        while at + 4 <= end:
            kind = buf[at]
            start = at + 4
            stop = start + (buf[at + 2] | buf[at + 3] << 8)
            if end - start > 0xFFFF:  # the 16-bit length is invalid
                stop = end
            if stop > end or (kind < 16 and stop - start < _LEAST[kind]):
                raise DecodeError("truncated submessage")
            little = bool(buf[at + 1] & ids.FLAG_LITTLE_ENDIAN)
            if kind == ids.DATA:
                reader_id = buf[start + 2] << 8 | buf[start + 3]
                self.on_data(reader_id, buf, start + 4, stop, little)
            elif kind == ids.FRAGMENT:
                whole = self._fragments.add(
                    memoryview(buf)[start:stop], buf[at + 1] & ids.FLAG_LAST_FRAGMENT
                )
                if whole is not None:
                    if whole and whole[0] == ids.FRAGMENT:  # nesting could overflow the stack
                        raise DecodeError("fragments of fragments")
                    self._read(whole, 0)
            else:
                self._control(kind, buf, start, little)
            at = stop + (-stop & 3)

    def _control(self, kind: int, buf: "Buffer", at: int, little: bool) -> None:
        if kind == ids.STATUS:
            self.on_status(buf[at] << 8 | buf[at + 1], buf[at + 4])
        elif kind == ids.INFO:
            # Agents from 3.0 on answer unknown sessions, with 0 here.
            if not buf[at + 5]:
                self.on_unknown()
        elif kind == ids.STATUS_AGENT:
            self.on_agent(buf[at])
        elif kind == ids.TIMESTAMP_REPLY:
            times = unpack_from("<6I" if little else ">6I", buf, at)
            if times[4:] == self._asked:  # not a late reply to the TIMESTAMP before
                self._asked = None
                self.on_time(times[:2], times[2:4])
        elif kind == ids.ACKNACK or kind == ids.HEARTBEAT:
            if buf[at + 4] == ids.STREAM_RELIABLE:
                big = 1 - little
                first = buf[at + big] | buf[at + 1 - big] << 8
                if kind == ids.ACKNACK:
                    self._acknowledged(first, buf[at + 2] << 8 | buf[at + 3])
                else:
                    self._acknowledge = True
                    # The agent gave up messages or restarted: its session is not this one.
                    last = buf[at + 2 + big] | buf[at + 3 - big] << 8
                    if self._in.heartbeat(first, last, self.now):
                        self.on_unknown()
