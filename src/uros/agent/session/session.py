"""One client's XRCE session at the agent: streams, submessages, acknowledgements.

It takes datagrams, calls its handler for their content, and collects the answers in
:attr:`Session.outgoing`. It uses neither sockets nor a clock: the caller gives ``now``
in integer milliseconds modulo 2^30.

WRITE_DATA to a datawriter is the hot path: its four bytes of ids become the
encapsulation header in place, and the writer gets a memoryview of the receive
buffer. If a writer has no room for a sample, the reliable stream stalls: nothing
further is handled or acknowledged until :meth:`Session.poll` has written the sample.

No message of a client raises an error; its faults go to ``fault`` of the handler.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Final

from ...middleware.base import MiddlewareError
from ...ticks import ticks_add, ticks_diff
from ...wire import ids
from ...wire.cdr import Reader, Writer
from ...wire.errors import DecodeError, LimitError
from ...wire.header import MessageWriter, push_subheader
from ...wire.session import (
    acknack_message,
    pull_acknack,
    pull_heartbeat,
    push_get_info,
    push_heartbeat,
)
from ...wire.streams import (
    MAX_MESSAGE,
    BestEffortIn,
    Fragments,
    ReliableIn,
    ReliableOut,
    sequence_after,
    split,
)
from ..log import unexpected
from ..policy.memory_budget import MESSAGE_BYTES, MemoryBudget, unlimited
from .handler import GONE, Handler
from .reassembly import NONE, beginning, long_stop, surplus

# The header of a message but for the client key, and that of a submessage (XRCE 8.3.2, 8.3.4).
_HALF_HEADER: Final = struct.Struct("<BBH")

WriteSample = Callable[[memoryview], bool]

# Smaller than this, not even a STATUS or one byte of a fragment would fit.
MIN_MTU: Final = 32
# A client that answers no heartbeat for so long gets no more until it is heard again, which is
# checked every SILENT_CHECK_MS.
SILENT_MS: Final = 30_000
SILENT_CHECK_MS: Final = 1000
# The most streams of each kind, because a client could open all 255, with a window of messages
# each.
MAX_STREAMS: Final = 8
# The most messages of a stream that wait for an acknowledgement, because a client may never
# acknowledge the answers to its requests.
MAX_HELD: Final = 4096
# The most bytes of such answers, because they may be long. The last one may exceed this limit.
MAX_ANSWERS: Final = 1024 * 1024
# The first and the longest pause before a stalled message is tried again, in milliseconds. The
# pauses grow while nothing can be written.
STALL_RETRY_MS: Final = 5
STALL_RETRY_MOST_MS: Final = 40
# A C client reassembles what fits the history of its stream, 4 messages by default; with more the
# stream stalls for good. It does not announce how many.
SAFE_FRAGMENTS: Final = 4


class _Stalled(Exception):
    """A writer has no room; handling continues at ``offset`` of the message."""

    def __init__(self, offset: int) -> None:
        self.offset = offset


class _In:
    """A reliable input stream with what belongs to it at the agent."""

    __slots__ = (
        "ack_due", "first_fragment", "fragment_at", "fragments", "stalled", "stream"
    )  # fmt: skip

    def __init__(self, limit: int) -> None:
        self.stream = ReliableIn()
        self.fragments = Fragments(limit)
        self.fragment_at = 0  # the number after that of the message with the last fragment
        self.first_fragment = 0  # length of the first of a message; 0: before the agent's start
        self.ack_due = False
        # Messages that wait for a writer's room, in order; all but the last of a
        # datagram are reassembled ones.
        self.stalled: list[bytearray] = []


class Session:
    """A session; see the module.

    Args:
        key: The client key.
        session_id: The id of the session.
        mtu: The longest message that the client can take, in octets.
        handler: Called for the content of messages.
        budget: The memory account that what it keeps is charged to.
        limit: The longest message in both directions, in octets.
    """

    __slots__ = (
        "_asking_since", "_best_effort_in", "_best_effort_out", "_budget", "_handler",
        "_heard_before", "_in", "_key_octets", "_limit", "_out", "_resumed", "_retry_at",
        "_retry_ms", "_scratch", "_warned", "acknowledged", "delivered", "dropped", "given_up",
        "heard", "key", "lost", "mtu", "outgoing", "received", "received_bytes", "resent",
        "round_trips_ms", "sent", "sent_bytes", "session_id", "writers",
    )  # fmt: skip

    def __init__(
        self,
        key: int,
        session_id: int,
        mtu: int,
        handler: Handler,
        budget: MemoryBudget | None = None,
        limit: int = MAX_MESSAGE,
    ) -> None:
        self._budget = budget or unlimited()
        self._limit = limit
        self.key = key
        self.session_id = session_id
        self._key_octets = b"" if session_id & 0x80 else key.to_bytes(4, "big")
        self.mtu = mtu
        self.heard = 0
        # Counters of the snapshot; the agent counts what is sent.
        self.received = 0  # messages, and their bytes
        self.received_bytes = 0
        self.lost = 0  # numbers of best-effort streams that never came, or came too late
        self.given_up = 0  # long messages of which the client sent the first fragments only
        self.sent = 0
        self.sent_bytes = 0
        self.resent = 0  # messages that were sent again, each time counts
        self.dropped = 0  # samples that found no room on a best-effort stream
        # Acknowledgements of new messages, and the sum of their times since the last sending.
        self.acknowledged = 0
        self.round_trips_ms = 0
        self.outgoing: list[bytes] = []
        self.delivered = False  # whether samples were sent since the server last looked
        self.writers: dict[int, WriteSample] = {}  # datawriters' object ids
        self._handler: Handler = handler
        self._scratch = bytearray(256)
        self._warned = False
        self._clear()

    def _clear(self) -> None:
        self._best_effort_in: dict[int, BestEffortIn] = {}
        self._best_effort_out: dict[int, int] = {}
        self._in: dict[int, _In] = {}
        self._out: dict[int, ReliableOut] = {}
        self._retry_at: int | None = None
        self._retry_ms = STALL_RETRY_MS
        self._resumed = False  # a session of before the agent's start
        # What `heard` was at the last heartbeat (-1: none is known), and since when
        # heartbeats go out without anything heard.
        self._heard_before = -1
        self._asking_since = 0

    def end(self) -> None:
        """Release what the session keeps, except messages that are still to be sent.

        The reference to the client is released too: the reference cycle would keep both in memory
        until the garbage collector runs.
        """
        self._clear()
        self._handler = GONE

    def reset(self) -> None:
        """Reset all streams, at RESET and CREATE_CLIENT of the client."""
        freed = list(self._out)
        self._clear()
        self.outgoing.clear()
        for stream_id in freed:
            self._handler.room(stream_id)

    # --- receiving -----------------------------------------------------------

    def receive(self, buf: bytearray, view: memoryview, length: int, now: int) -> bool:
        """Handle the datagram in ``buf[:length]``, whose header names this session.

        Args:
            buf: The datagram, which may be changed; the caller may use it again afterwards.
            view: A memoryview of ``buf``.
            length: Its octets.
            now: The time, in milliseconds modulo 2^30.

        Returns:
            Whether the session needs :meth:`finish`, has something to send, or a new deadline.
        """
        self.heard = now
        self.received += 1
        self.received_bytes += length
        stream_id = buf[1]
        sequence = buf[2] | buf[3] << 8
        start = 4 if buf[0] & 0x80 else 8
        if stream_id >= ids.STREAM_RELIABLE:
            self._receive_reliable(stream_id, sequence, buf, view, start, length, now)
            return True
        if stream_id:
            stream = self._best_effort_in.get(stream_id)
            if stream is None:
                if len(self._best_effort_in) >= MAX_STREAMS:
                    self._handler.fault("too many streams", f"stream: {stream_id}")
                    return False
                stream = self._best_effort_in[stream_id] = BestEffortIn()
                if self._resumed:
                    stream.last = (sequence - 1) & 0xFFFF
            gap = (sequence - stream.last) & 0xFFFF
            if gap == 1 and not stream.doubts:
                stream.last = sequence  # what accept() does, without two calls
            elif not stream.accept(sequence, now):
                return False
            elif gap < 0x8000:
                self.lost += gap - 1
        try:
            self._submessages(buf, view, start, length, stream_id, now)
        except DecodeError as error:
            self._handler.fault("deserialization error", str(error))
        return bool(self.outgoing) or not stream_id

    def _receive_reliable(
        self,
        stream_id: int,
        sequence: int,
        buf: bytearray,
        view: memoryview,
        start: int,
        length: int,
        now: int,
    ) -> None:
        incoming = self._in.get(stream_id)
        if incoming is None:
            if len(self._in) >= MAX_STREAMS:
                self._handler.fault("too many streams", f"stream: {stream_id}")
                return
            incoming = self._in[stream_id] = _In(self._limit)
        incoming.ack_due = True
        stream = incoming.stream
        if incoming.stalled and sequence == stream.next:
            # It is the next one once the stalled message is handled: keep it for pop().
            if sequence not in stream.waiting:
                stream.waiting[sequence] = bytes(view[start:length])
                if sequence_after(sequence, stream.announced):
                    stream.announced = sequence
        elif stream.receive(sequence, view[start:length]):
            if self._handle(incoming, buf, view, start, length, stream_id, now) and stream.waiting:
                self._catch_up(incoming, stream_id, now)
            return
        if sequence in stream.waiting and not self._budget.keep(length - start):
            del stream.waiting[sequence]  # the client sends it again

    def _handle(
        self,
        incoming: _In,
        buf: bytearray,
        view: memoryview,
        start: int,
        end: int,
        stream_id: int,
        now: int,
    ) -> bool:
        """Handle one message of a reliable stream; return False if it stalled."""
        try:
            self._submessages(buf, view, start, end, stream_id, now)
        except _Stalled as stalled:
            if stalled.offset == 0:
                incoming.stalled.append(buf)  # no copy is needed: the session owns this buffer
            elif stalled.offset < end:
                incoming.stalled.append(bytearray(view[stalled.offset : end]))
            self._retry_at = ticks_add(now, self._retry_ms)
            return False
        except DecodeError as error:
            self._handler.fault("deserialization error", str(error))
        return stream_id in self._in  # False if the message reset the session

    def _submessages(
        self, buf: bytearray, view: memoryview, offset: int, end: int, stream_id: int, now: int
    ) -> None:
        """Handle the submessages in ``buf[offset:end]``, in order.

        They start at multiples of 4, and so does ``offset``. A submessage for which there is no
        room is dropped, except on a reliable stream.

        Raises:
            _Stalled: There is no room for one of a reliable stream; it has the offset of that one.
            DecodeError: A submessage is invalid; those before it have been handled.
        """
        while offset + 4 <= end:
            kind = buf[offset]
            flags = buf[offset + 1]
            start = offset + 4
            stop = start + (buf[offset + 2] | buf[offset + 3] << 8)
            if stop > end or end - start > 0xFFFF:
                if end - start <= 0xFFFF:
                    raise DecodeError(
                        f"submessage {kind} announces {stop - start} bytes, {end - start} are there"
                    )
                stop = long_stop(stop, start, end)
            write = None
            if kind == ids.WRITE_DATA and not flags & ids.FORMAT_MASK and stop - start > 4:
                write = self.writers.get(buf[start + 2] << 8 | buf[start + 3])
            if write is not None:
                saved = buf[start : start + 4]
                buf[start] = 0
                buf[start + 1] = flags & 1
                buf[start + 2] = 0
                buf[start + 3] = 0
                try:
                    done = write(view[start:stop])
                except MiddlewareError as error:
                    self._handler.fault("middleware error", str(error))
                    done = True
                except Exception as error:  # the submessages after it must be handled
                    self._handler.fault("internal error", unexpected(error))
                    done = True
                if not done:
                    buf[start : start + 4] = saved
            elif kind == ids.ACKNACK:
                self._acknack(Reader(view, start, stop, bool(flags & 1)), now)
                done = True
            elif kind == ids.HEARTBEAT:
                self._heartbeat(Reader(view, start, stop, bool(flags & 1)), now)
                done = True
            elif kind == ids.FRAGMENT and not self._budget.keep(stop - start):
                done = False
            elif kind == ids.FRAGMENT:
                if not self._fragment(stream_id, flags, view[start:stop], now):
                    raise _Stalled(stop + (-stop & 3))
                done = True
            elif kind == ids.RESET:
                self.reset()
                return
            else:
                done = self._handler.submessage(kind, flags, stream_id, view[start:stop])
            if not done:
                if stream_id >= ids.STREAM_RELIABLE:
                    raise _Stalled(offset)
                self.dropped += 1
            offset = stop + (-stop & 3)

    def _fragment(self, stream_id: int, flags: int, part: memoryview, now: int) -> bool:
        """Handle one fragment; return False if the message that it completes stalled."""
        incoming = self._in.get(stream_id)
        if incoming is None:
            raise DecodeError("a fragment outside of a reliable stream")
        number = incoming.stream.next
        if number != incoming.fragment_at:
            # C clients abandon a long message if publish() runs out of time, with some of its
            # fragments in the stream, and send others next (on_full_output_buffer_fragmented).
            if incoming.fragments.pending and number != (incoming.fragment_at + 1) & 0xFFFF:
                incoming.fragments.drop()
                self._given_up(stream_id)
            incoming.fragment_at = number
        last = bool(flags & ids.FLAG_LAST_FRAGMENT)
        if not incoming.fragments.pending or not (incoming.first_fragment or last):
            incoming.first_fragment = len(part)
        if len(self._in) > 1:  # all streams together hold no more than one may
            total = sum(
                stream_in.fragments.pending + sum(map(len, stream_in.stalled))
                for stream_in in self._in.values()
            )
            incoming.fragments.limit = self._limit - total + incoming.fragments.pending
        whole = incoming.fragments.add(part, last)
        if whole is None:
            return True
        if len(whole) < 4 or whole[0] == ids.FRAGMENT:
            raise DecodeError("fragments of what is no submessage, or of fragments")
        start = beginning(whole, incoming.first_fragment, len(part), self.writers)
        if start:
            self._given_up(stream_id)
            if start == NONE:
                return True
            whole = whole[start:]  # a copy: the session store identifies a message by its buffer
        del whole[len(whole) - surplus(whole) :]  # one submessage; the rest is padding
        try:
            self._submessages(whole, memoryview(whole), 0, len(whole), stream_id, now)
        except _Stalled:
            incoming.stalled.append(whole)
            return False
        except DecodeError as error:  # of this message; the submessages after it are handled
            self._handler.fault("deserialization error", str(error))
        return True

    def _given_up(self, stream_id: int) -> None:
        self.given_up += 1
        self._handler.fault(
            "message given up", f"its last fragment never came, stream: {stream_id}"
        )

    def _acknack(self, reader: Reader, now: int) -> None:
        first, missing, stream_id = pull_acknack(reader)
        stream = self._out.get(stream_id)
        if stream is None:
            return
        had_room = stream.available() > 0
        sent = stream.sent
        sent_at = stream.sent_at((first - 1) & 0xFFFF)
        if sent_at is not None:
            self.acknowledged += 1
            self.round_trips_ms += max(0, ticks_diff(now, sent_at))
        messages = stream.acknack(first, missing, now)
        self.resent += len(messages) - ((stream.sent - sent) & 0xFFFF)
        self.outgoing.extend(messages)
        if not had_room and stream.available() > 0:
            self._handler.room(stream_id)

    def _heartbeat(self, reader: Reader, now: int) -> None:
        first, last, stream_id = pull_heartbeat(reader)
        if stream_id < ids.STREAM_RELIABLE:
            return
        incoming = self._in.get(stream_id)
        if incoming is None:
            if len(self._in) >= MAX_STREAMS:
                raise LimitError("too many streams")
            incoming = self._in[stream_id] = _In(self._limit)
        incoming.ack_due = True
        if incoming.stalled:
            return
        stream = incoming.stream
        expected = stream.next
        if stream.heartbeat(first, last, now):
            stream.restart(first, last)
            incoming.fragments.interrupt()
            self._handler.fault(
                "stream out of step",
                f"stream: {stream_id}, expected: {expected}, the client holds: {first} to {last}",
            )

    def _catch_up(self, incoming: _In, stream_id: int, now: int) -> None:
        """Handle messages that came early and follow without a gap now."""
        while True:
            body = incoming.stream.pop()
            if body is None:
                return
            buf = bytearray(body)
            if not self._handle(incoming, buf, memoryview(buf), 0, len(buf), stream_id, now):
                return

    # --- time ----------------------------------------------------------------

    def finish(self) -> None:
        """Acknowledge what came in a burst of datagrams, once for each stream."""
        for stream_id, incoming in self._in.items():
            if incoming.ack_due and not incoming.stalled:
                incoming.ack_due = False
                first, missing = incoming.stream.acknack()
                self.outgoing.append(
                    acknack_message(self.session_id, self.key, first, missing, stream_id)
                )

    def held(self) -> int:
        """Return about how many bytes are kept for the client."""
        return sum(
            stream.size + MESSAGE_BYTES * len(stream) for stream in self._out.values()
        ) + sum(
            incoming.fragments.pending
            + sum(len(message) + MESSAGE_BYTES for message in incoming.stalled)
            + sum(len(message) + MESSAGE_BYTES for message in incoming.stream.waiting.values())
            for incoming in self._in.values()
        )

    def streams(self) -> tuple[dict[int, _In], dict[int, ReliableOut], dict[int, int]]:
        """Return the streams, whose state the session store saves.

        They are the reliable ones from the client and to it, and the next sequence numbers of the
        best-effort ones to it. After a reset these are other dictionaries.
        """
        return self._in, self._out, self._best_effort_out

    def resume(
        self,
        incoming: Mapping[int, tuple[int, bytearray, bool]],
        outgoing: Mapping[int, tuple[int, int, int, dict[int, bytes]]],
        best_effort: Mapping[int, int],
        now: int,
    ) -> None:
        """Continue the session of an agent that has ended.

        Args:
            incoming: By stream: the next number, an incomplete fragmented message, and whether its
                rest is to be dropped.
            outgoing: By stream: the first number not acknowledged, the next to send, the next to
                assign, and the messages from the first on.
            best_effort: The next number by stream.
            now: The time, in milliseconds modulo 2^30.
        """
        self._resumed = True
        for stream_id, (number, part, skip) in incoming.items():
            stream = self._in[stream_id] = _In(self._limit)
            stream.stream.restart(number, (number - 1) & 0xFFFF)
            stream.fragments.restore(part, skip)
            stream.fragment_at = number
        for stream_id, (acked, sent, after, messages) in outgoing.items():
            out = self._out[stream_id] = ReliableOut(limit=MAX_HELD)
            out.restore(acked, sent, after, messages, now)
        self._best_effort_out.update(best_effort)

    def request_retransmit(self) -> None:
        """Request all messages that the client keeps on its reliable streams.

        A C client that runs its session more often than each 100 ms never sends a HEARTBEAT. So
        messages that were lost with the former agent would never be sent again.
        """
        for stream_id, incoming in self._in.items():
            if not incoming.stalled:
                self.outgoing.append(
                    acknack_message(
                        self.session_id, self.key, incoming.stream.next, 0xFFFF, stream_id
                    )
                )

    def queues(self) -> tuple[int, int, int, int]:
        """Return the sizes of its queues.

        Returns:
            Messages that are not acknowledged, messages that wait for room in a writer, messages
            that came early, and bytes of fragments.
        """
        return (
            sum(len(stream) for stream in self._out.values()),
            sum(len(incoming.stalled) for incoming in self._in.values()),
            sum(len(incoming.stream.waiting) for incoming in self._in.values()),
            sum(incoming.fragments.pending for incoming in self._in.values()),
        )

    def unacknowledged_ms(self, now: int) -> int:
        """Return how long ago the oldest message without acknowledgement was last sent."""
        sent = (stream.sent_at(stream.acked) for stream in self._out.values())
        return max((ticks_diff(now, at) for at in sent if at is not None), default=0)

    def next_deadline(self) -> int | None:
        """Return when :meth:`poll` has something to do, or None."""
        soonest = self._retry_at
        for stream in self._out.values():
            deadline = stream.deadline
            if deadline is not None and (soonest is None or ticks_diff(deadline, soonest) < 0):
                soonest = deadline
        return soonest

    def poll(self, now: int) -> None:
        """Send heartbeats that are due, and try stalled writes again."""
        if self._retry_at is not None and ticks_diff(now, self._retry_at) >= 0:
            self._retry_at = None
            self._retry_ms = min(2 * self._retry_ms, STALL_RETRY_MOST_MS)
            for stream_id, incoming in list(self._in.items()):
                if incoming.stalled:
                    self._retry(incoming, stream_id, now)
            self.finish()
        silent = self._silent(now)
        for stream_id, stream in self._out.items():
            due = stream.heartbeat(now)
            if due is not None and silent:
                stream.deadline = ticks_add(now, SILENT_CHECK_MS)
                continue
            if due is not None:
                w = self._message(ids.HEARTBEAT)
                push_heartbeat(w, due[0], due[1], stream_id)
                self.outgoing.append(w.finish())

    def _silent(self, now: int) -> bool:
        """Return whether nothing was heard in SILENT_MS of heartbeats.

        Silence before the first heartbeat does not count: a subscriber may have had nothing to
        send.
        """
        asking = any(stream.deadline is not None for stream in self._out.values())
        if self.heard != self._heard_before:
            self._asking_since = now
        # What is heard in this same millisecond must differ the next time.
        self._heard_before = self.heard if asking and self.heard != now else -1
        if ticks_diff(now, self._asking_since) <= SILENT_MS:
            return False
        self._asking_since = ticks_add(now, -SILENT_MS - 1)  # kept within reach of ticks_diff
        return True

    def _retry(self, incoming: _In, stream_id: int, now: int) -> None:
        messages, incoming.stalled = incoming.stalled, []
        for index, message in enumerate(messages):
            if not self._handle(
                incoming, message, memoryview(message), 0, len(message), stream_id, now
            ):
                if stream_id in self._in:
                    incoming.stalled.extend(messages[index + 1 :])
                return
            self._retry_ms = STALL_RETRY_MS
        self._catch_up(incoming, stream_id, now)

    # --- sending ---------------------------------------------------------------

    def _message(self, kind: int) -> MessageWriter:
        w = MessageWriter(self._scratch, self.session_id, ids.STREAM_NONE, 0, self.key)
        w.begin(kind)
        return w

    def probe(self) -> None:
        """Ask the client to answer; any message of it counts.

        C clients answer GET_INFO. Others may answer HEARTBEAT only, if they have a reliable
        stream; it announces the messages that are in the stream.
        """
        w = self._message(ids.GET_INFO)
        push_get_info(w, 0, ids.OBJECT_CLIENT, 0)
        self.outgoing.append(w.finish())
        stream = self._out.get(ids.STREAM_RELIABLE)
        first, after = (0, 0) if stream is None else (stream.acked, stream.sent)
        w = self._message(ids.HEARTBEAT)
        push_heartbeat(w, first, (after - 1) & 0xFFFF, ids.STREAM_RELIABLE)
        self.outgoing.append(w.finish())

    def room(self, stream_id: int) -> int:
        """Return how many messages the stream would send at once; 1 if it is best effort."""
        if stream_id < ids.STREAM_RELIABLE:
            return 1
        stream = self._out.get(stream_id)
        return stream.available() if stream is not None else 16

    def last_received(self, stream_id: int) -> int:
        """Return the number of the last message handled on a reliable stream; 0xFFFF: none."""
        incoming = self._in.get(stream_id)
        return 0xFFFF if incoming is None else (incoming.stream.next - 1) & 0xFFFF

    def last_acknowledged(self, stream_id: int) -> int:
        """Return the number of the last message that the client acknowledged; 0xFFFF: none."""
        stream = self._out.get(stream_id)
        return 0xFFFF if stream is None else (stream.acked - 1) & 0xFFFF

    def answer(self, kind: int, stream_id: int, now: int, push: Callable[[Writer], None]) -> None:
        """Send one small submessage whose payload ``push`` writes."""
        w = Writer(self._scratch)
        push(w)
        self.send(kind, ids.FLAG_LITTLE_ENDIAN, stream_id, bytes(self._scratch[: w.offset]), now)

    def send(self, kind: int, flags: int, stream_id: int, payload: bytes, now: int) -> bool:
        """Send one submessage on a stream, in fragments if it is longer than a message.

        Returns:
            False if it is dropped because it is too large for the stream.

        Raises:
            LimitError: Too many messages are not acknowledged.
        """
        head = len(self._key_octets) + 4
        size = len(payload)
        if size > self._limit:
            return self._too_large(size, stream_id)
        if kind != ids.DATA and stream_id in self._out and self._out[stream_id].size > MAX_ANSWERS:
            raise LimitError(f"over {MAX_ANSWERS} bytes of answers are not acknowledged")
        if head + 4 + size <= self.mtu:
            self._put(stream_id, kind, flags, payload, now)
            return True
        if stream_id < ids.STREAM_RELIABLE:
            return self._too_large(size, stream_id)
        parts = split(4 + size, self.mtu - head - 4)
        stream = self._out.get(stream_id)
        if len(parts) + (len(stream) if stream is not None else 0) > MAX_HELD:
            return self._too_large(size, stream_id)  # a part of it would make the stream unusable
        if len(parts) > SAFE_FRAGMENTS and not self._warned:
            self._warned = True
            self._handler.many_fragments(size, len(parts))
        whole = bytearray(4 + size)
        push_subheader(whole, 0, kind, flags, size)
        whole[4:] = payload
        for start, stop, fragment_flags in parts:
            self._put(stream_id, ids.FRAGMENT, fragment_flags, bytes(whole[start:stop]), now)
        return True

    def _too_large(self, size: int, stream_id: int) -> bool:
        self.dropped += 1
        self._handler.fault(
            "message dropped", f"{size} bytes are too many for stream {stream_id}, mtu: {self.mtu}"
        )
        return False

    def _put(self, stream_id: int, kind: int, flags: int, payload: bytes, now: int) -> None:
        stream = None
        sequence = 0
        if stream_id >= ids.STREAM_RELIABLE:
            stream = self._out.get(stream_id)
            if stream is None:
                if len(self._out) >= MAX_STREAMS:
                    raise LimitError("too many streams")
                stream = self._out[stream_id] = ReliableOut(limit=MAX_HELD)
            sequence = stream.next
        elif stream_id:
            sequence = self._best_effort_out.get(stream_id, 0)
            self._best_effort_out[stream_id] = (sequence + 1) & 0xFFFF
        # As push_header() and push_subheader() of the wire, which take longer.
        message = (
            _HALF_HEADER.pack(self.session_id, stream_id, sequence)
            + self._key_octets
            + _HALF_HEADER.pack(kind, flags, len(payload) & 0xFFFF)
            + payload
        )
        if stream is None:
            self.outgoing.append(message)
        else:
            stream.put(message)
            self._budget.since += len(message)
            self.outgoing.extend(stream.take(now))
