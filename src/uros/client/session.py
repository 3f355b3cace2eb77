"""One XRCE session from the client's side: datagrams in, datagrams out. No I/O and no clock.

Requests and reliable samples go out on stream 0x80 in the order they are made, as many at a time
as the window holds; the rest waits here, and nothing here waits for the agent. Times are integer
milliseconds modulo 2^30 and come from the caller.
"""

from ..wire import ids
from ..wire.cdr import Reader
from ..wire.data import REQUEST_SIZE
from ..wire.errors import DecodeError, EncodeError, WireError
from ..wire.header import MessageWriter, pull_header, pull_subheader, push_header, push_subheader
from ..wire.session import (
    acknack_message,
    pull_acknack,
    pull_heartbeat,
    pull_status,
    pull_timestamp_reply,
    push_create_client,
    push_get_info,
    push_heartbeat,
    push_request,
    push_timestamp,
)
from ..wire.streams import (
    BestEffortIn,
    Fragments,
    ReliableIn,
    ReliableOut,
    sequence_after,
    split,
    ticks_diff,
)

try:
    from typing import Any, Callable, Final, Protocol

    from ..wire.cdr import Buffer

    class Owner(Protocol):
        """Who is told what the agent says."""

        def on_agent(self, status: int) -> None:
            """The session was opened, or refused."""

        def on_pong(self) -> None:
            """There is an agent: the answer to a ping outside of a session."""

        def on_unknown(self) -> None:
            """The agent says that it does not know the session."""

        def on_status(self, request_id: int, status: int) -> None:
            """What became of a request."""

        def on_time(
            self, transmit: "tuple[int, int]", receive: "tuple[int, int]"
        ) -> None:
            """The agent's clock on sending and on receiving, in seconds and nanoseconds."""

        def on_data(
            self, object_id: int, buf: "Buffer", start: int, stop: int, little: bool
        ) -> None:
            """A sample; ``buf`` is the caller's only until the call returns."""

except ImportError:  # MicroPython
    pass

FIRST_SESSION_ID: Final = 0x81
LAST_SESSION_ID: Final = 0xFE
# Smaller request ids have a meaning of their own (XRCE 7.7.3.1).
FIRST_REQUEST: Final = 10
GOODBYE: Final = 9
# A message header, a submessage header, and the two ids of a WRITE_DATA.
_SUBHEADER: Final = 4
_IDS: Final = 8
_SAMPLE: Final = 12
# The longest request but where the MTU is more: one of an object with long names does not fit
# into the 63 bytes of a CAN frame, and goes out in fragments.
MAX_REQUEST: Final = 512
# So many heartbeats, one after the other and for so long, are not late.
_BEHIND: Final = 8
_BEHIND_MS: Final = 2000
# Most messages that may wait behind each other: the rest of MAX_HELD is for requests.
_MOST: Final = 0x7000


class Session:
    """See the module. ``send`` gets each datagram that is to go out.

    ``mtu`` is the largest datagram in bytes, ``limit`` how many bytes may wait in either
    direction: a larger sample than that cannot be sent or received at all.
    """

    def __init__(
        self,
        owner: "Owner",
        send: "Callable[[Buffer], None]",
        key: int,
        mtu: int,
        limit: int,
    ) -> None:
        self.key = key
        self.id = FIRST_SESSION_ID
        self.mtu = mtu
        self.limit = limit
        self.dropped = 0  # datagrams that made no sense, or were for another session
        self.request_id = FIRST_REQUEST
        self._owner = owner
        self._send = send
        self._buf = bytearray(max(mtu, MAX_REQUEST))
        self._fragments = Fragments(limit)
        self._part = (mtu - _IDS) & ~3  # octets in a fragment
        self._acknowledge = False
        self._reset()

    def _reset(self) -> None:
        self.out = ReliableOut()
        self._in = ReliableIn()
        self._best_in = BestEffortIn()
        self._best_out = 0
        self._fragments.clear()
        self._acknowledge = False
        self._asked: "tuple[int, int] | None" = None  # the time that the last TIMESTAMP told
        self._behind = 0  # heartbeats one after the other that told of less than has come
        self._behind_since = 0

    def begun(self) -> bool:
        """Whether anything of a reliable stream has come through, in either direction."""
        return bool(self.out.acked or self._in.next)

    def renew(self) -> None:
        """Forget all of the session; the next one has another id, so that no late datagram of
        this one is taken for its own."""
        self.id = FIRST_SESSION_ID if self.id >= LAST_SESSION_ID else self.id + 1
        self.request_id = FIRST_REQUEST
        self._reset()

    # --- outside of streams -----------------------------------------------------------

    def _message(
        self, session_id: int, kind: int, push: "Callable[..., None]", *values: "Any"
    ) -> None:
        w = MessageWriter(self._buf, session_id, ids.STREAM_NONE, 0)
        w.begin(kind)
        push(w, *values)
        self._send(w.finish())

    def hello(self) -> None:
        """CREATE_CLIENT; the answer is ``on_agent``."""
        self._message(
            ids.SESSION_NONE_WITHOUT_KEY, ids.CREATE_CLIENT,
            push_create_client, self.key, self.id, self.mtu,
        )  # fmt: skip

    def ping(self, within: bool) -> None:
        """GET_INFO about the agent, within the session or without one (then ``on_pong``)."""
        session_id = self.id if within else ids.SESSION_NONE_WITHOUT_KEY
        self._message(
            session_id, ids.GET_INFO,
            push_get_info, FIRST_REQUEST, ids.OBJECT_AGENT, ids.INFO_ACTIVITY,
        )  # fmt: skip

    def ask_time(self, seconds: int, nanoseconds: int) -> None:
        """TIMESTAMP with our own time; the answer to the last one is ``on_time``."""
        self._asked = (seconds & 0xFFFFFFFF, nanoseconds)
        self._message(self.id, ids.TIMESTAMP, push_timestamp, *self._asked)

    def goodbye(self) -> None:
        """DELETE the client; the answer is ``on_status``, for request GOODBYE."""
        self._message(self.id, ids.DELETE, push_request, GOODBYE, ids.OBJECT_CLIENT)

    # --- reliable and best effort -----------------------------------------------------

    def next_request(self) -> int:
        """The request id of the next request."""
        request = self.request_id
        self.request_id = FIRST_REQUEST if request >= 0xFFFF else request + 1
        return request

    def request(
        self, kind: int, flags: int, now: int, push: "Callable[..., None]", *values: "Any"
    ) -> int:
        """A request on the reliable stream; its id, which ``push`` gets before the values.

        Raises EncodeError where it is longer than the MTU and MAX_REQUEST.
        """
        w = MessageWriter(self._buf, self.id, ids.STREAM_RELIABLE, self.out.next)
        w.begin(kind, flags)
        request = self.next_request()
        push(w, request, *values)
        self._put(w.finish(), now)
        return request

    def write(
        self, object_id: int, message: "Any", prefix: bytes, reliable: "bool | int", now: int
    ) -> int:
        """WRITE_DATA of a generated message behind ``prefix``; the request id.

        0 where too much waits already: nothing was sent. Raises EncodeError for a sample that
        can never be sent, and what packing raises; nothing is half sent.
        """
        start = _SAMPLE + len(prefix)
        size = start + message.cdr_size()
        limit = self.limit if reliable else self.mtu
        if size > limit:
            raise EncodeError(
                "%s takes %d bytes, the %s allows %d"
                % (message._TYPE, size, "limit" if reliable else "mtu of best effort", limit)
            )
        if reliable and (
            size + self.out.size > self.limit
            or len(self.out) + size // self._part >= _MOST
        ):
            return 0
        buf = bytearray(size)
        message.pack_into(buf, start, start)
        push_subheader(buf, _SUBHEADER, ids.WRITE_DATA, ids.FLAG_LITTLE_ENDIAN, size - _IDS)
        request = self.next_request()
        buf[_IDS] = request >> 8
        buf[_IDS + 1] = request & 0xFF
        buf[_IDS + 2] = object_id >> 8
        buf[_IDS + 3] = object_id & 0xFF
        buf[_SAMPLE:start] = prefix
        if not reliable:
            push_header(buf, self.id, ids.STREAM_BEST_EFFORT, self._best_out)
            self._best_out = (self._best_out + 1) & 0xFFFF
            self._send(buf)
            return request
        push_header(buf, self.id, ids.STREAM_RELIABLE, self.out.next)
        self._put(buf, now)
        return request

    def _put(self, buf: "bytes | bytearray", now: int) -> None:
        """A message of the reliable stream, in fragments where it is longer than the MTU."""
        size = len(buf)
        if size <= self.mtu:
            self.out.put(buf)
        else:
            view = memoryview(buf)
            for first, stop, flags in split(size - _SUBHEADER, self._part):
                part = bytearray(_IDS + stop - first)
                push_header(part, self.id, ids.STREAM_RELIABLE, self.out.next)
                push_subheader(part, _SUBHEADER, ids.FRAGMENT, flags, stop - first)
                part[_IDS:] = view[_SUBHEADER + first : _SUBHEADER + stop]
                self.out.put(part)
        self._flush(now)

    def _flush(self, now: int) -> None:
        for message in self.out.take(now):
            self._send(message)

    # --- time ---------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """Send what is due by time or owed to the agent: acknowledgements, heartbeats.

        ``out.deadline`` tells when the next is due, if nothing comes before.
        """
        if self._acknowledge:
            self._acknowledge = False
            first, missing = self._in.acknack()
            self._send(acknack_message(self.id, self.key, first, missing, ids.STREAM_RELIABLE))
        beat = self.out.heartbeat(now)
        if beat:
            self._message(
                self.id, ids.HEARTBEAT, push_heartbeat, beat[0], beat[1], ids.STREAM_RELIABLE
            )

    # --- receiving ----------------------------------------------------------------------

    def receive(self, message: "Buffer", now: int) -> bool:
        """Take one datagram, whatever it is; whether it was the agent's, for this session."""
        end = len(message)
        try:
            session_id, stream, sequence, _, start = pull_header(message, end)
            if session_id != self.id:
                if session_id == ids.SESSION_NONE_WITHOUT_KEY and message[start] == ids.INFO:
                    self._owner.on_pong()
                else:
                    self.dropped += 1
                return False
            if stream == ids.STREAM_RELIABLE:
                self._acknowledge = True
                if self._in.receive(sequence, memoryview(message)[start:]):
                    self._take(message, start, now)
                    self._catch_up(now)
            elif stream == ids.STREAM_NONE or (
                stream == ids.STREAM_BEST_EFFORT and self._best_in.accept(sequence)
            ):
                self._take(message, start, now)
        except WireError:
            self.dropped += 1
            return False
        return True

    def _take(self, buf: "Buffer", at: int, now: int) -> None:
        """Handle a message. Nonsense in one is no reason to keep those behind it."""
        try:
            self._submessages(buf, at, len(buf), now)
        except WireError:
            self.dropped += 1

    def _catch_up(self, now: int) -> None:
        body = self._in.pop()
        while body is not None:
            self._take(body, 0, now)
            body = self._in.pop()

    def _submessages(self, buf: "Buffer", at: int, end: int, now: int) -> None:
        while at + 4 <= end:
            kind, flags, start, stop = pull_subheader(buf, at, end)
            little = bool(flags & ids.FLAG_LITTLE_ENDIAN)
            if kind == ids.DATA:
                if stop - start >= REQUEST_SIZE:
                    thing = buf[start + 2] << 8 | buf[start + 3]
                    self._owner.on_data(thing, buf, start + REQUEST_SIZE, stop, little)
            elif kind == ids.FRAGMENT:
                whole = self._fragments.add(
                    memoryview(buf)[start:stop], bool(flags & ids.FLAG_LAST_FRAGMENT)
                )
                if whole is not None:
                    if whole and whole[0] == ids.FRAGMENT:  # and in it more, deeper than stacks
                        raise DecodeError("fragments of fragments")
                    self._take(whole, 0, now)
            else:
                self._control(kind, Reader(buf, start, stop, little), now)
            at = stop + (-stop & 3)

    def _control(self, kind: int, r: Reader, now: int) -> None:
        if kind == ids.ACKNACK:
            first, missing, stream = pull_acknack(r)
            if stream == ids.STREAM_RELIABLE:
                for message in self.out.acknack(first, missing, now):
                    self._send(message)
        elif kind == ids.HEARTBEAT:
            first, last, stream = pull_heartbeat(r)
            if stream == ids.STREAM_RELIABLE:
                self._acknowledge = True
                # A late heartbeat does so too; but that many are an agent which has begun anew.
                if not sequence_after(self._in.next, last + 1):
                    self._behind = 0
                else:
                    if not self._behind:
                        self._behind_since = now
                    self._behind += 1
                    if (
                        self._behind >= _BEHIND
                        and ticks_diff(now, self._behind_since) >= _BEHIND_MS
                    ):
                        self._owner.on_unknown()
                if self._in.heartbeat(first, last):
                    self._fragments.lost()
                self._catch_up(now)
        elif kind == ids.STATUS:
            request, _, status, _ = pull_status(r)
            self._owner.on_status(request, status)
        elif kind == ids.INFO:
            # Agents from 3.0 on answer sessions that they do not know, and say 0 here.
            if pull_status(r)[3] == 0:
                self._owner.on_unknown()
        elif kind == ids.STATUS_AGENT:
            self._owner.on_agent(r.u8())
        elif kind == ids.TIMESTAMP_REPLY:
            transmit, receive, originate = pull_timestamp_reply(r)
            if originate == self._asked:  # not a late answer to the question before
                self._asked = None
                self._owner.on_time(transmit, receive)
