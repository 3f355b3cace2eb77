"""Sequence numbers, windows, acknowledgements, resends and fragments.

The rules (XRCE 8.4):

* Numbers are 16 bits and wrap; the first of a stream is 0. ``a`` comes before
  ``b`` if ``b - a`` modulo 2^16 is below 2^15.
* Best effort: a message is accepted when its number is after the last accepted,
  or when the sender's numbers have jumped (see below).
* Reliable in: messages are delivered in order, each once. Early messages are
  kept if they are less than ``depth`` ahead of the next expected one; others
  are dropped, and the sender resends them. An ACKNACK carries the number
  expected next, and which of the 16 messages from there on are missing, up to
  the highest number known to be sent.
* Reliable out: a message is kept until acknowledged; at most ``window`` are in
  flight, the rest wait. HEARTBEATs are sent while messages are in flight;
  messages that an ACKNACK reports as missing are sent again, the same one at
  most once in ``RESEND_HOLD_MS``.
* A message whose numbers contradict the stream's state is assumed to be a late
  one of an earlier session with the same id, and changes nothing. After
  ``DOUBTS`` of them in a row, over at least ``DOUBT_MS`` and with no consistent
  message between them, the peer's numbers are accepted.
* Fragments carry one submessage, header included, in consecutive messages.

Times are integer milliseconds modulo 2^30, given by the caller.
"""

from ..ticks import ticks_add, ticks_diff
from . import ids
from .errors import LimitError

try:
    from typing import Any, Final

    from .cdr import Buffer
except ImportError:  # MicroPython
    pass

SEQUENCE_MASK: Final = 0xFFFF

# eProsima's client and agent keep 16 messages a stream; an ACKNACK can request 16.
WINDOW: Final = 16
# Period of HEARTBEATs, the default of the C++ agent and of the C client.
HEARTBEAT_MS: Final = 200
# Shortest time between two transmissions of the same message.
RESEND_HOLD_MS: Final = 10

# Inconsistent messages are not late ones of an earlier session if DOUBTS of them arrive in a row,
# over at least DOUBT_MS.
DOUBTS: Final = 8
DOUBT_MS: Final = 2000

# Fewer than half of all numbers may be in use at once: with more, the order of two numbers would be
# ambiguous.
MAX_HELD: Final = 0x7FFF

# Longest submessage that is reassembled from fragments. The limit prevents this attack: fragments
# without end. The largest known messages are camera images and point clouds of a few megabytes.
MAX_MESSAGE: Final = 8 * 1024 * 1024
# Replaces an empty buffer, since there may be no memory to allocate one.
_NOTHING: "Any" = b""


def sequence_after(a: int, b: int) -> bool:
    """Whether number ``a`` comes after number ``b``."""
    return 0 < (a - b) & SEQUENCE_MASK < 0x8000


def _doubted(stream: "BestEffortIn | ReliableIn", now: int) -> bool:
    """Count an inconsistent message; return whether there were too many of them in a row."""
    if not stream.doubts:
        stream.since = now
    stream.doubts += 1
    return stream.doubts >= DOUBTS and ticks_diff(now, stream.since) >= DOUBT_MS


class BestEffortIn:
    """Receiving end of a best-effort stream: drops old and duplicate messages.

    If only messages with old numbers keep coming, the sender's numbers have jumped:
    more than half of all numbers were lost, or ``last`` is from an earlier session.
    The stream then continues at the sender's number. Duplicates, and messages that
    others have overtaken by less than ``WINDOW``, do not count as such.
    """

    __slots__ = ("doubts", "last", "since")
    since: "int"  # time of the first inconsistent message in a row

    def __init__(self) -> None:
        self.last = SEQUENCE_MASK
        self.doubts = 0

    def accept(self, sequence: int, now: int) -> bool:
        """Return whether the message is a new one, which the caller must handle."""
        back = (self.last - sequence) & SEQUENCE_MASK
        if back <= 0x8000 and (back < WINDOW or not _doubted(self, now)):
            return False
        self.last = sequence
        self.doubts = 0
        return True


class ReliableIn:
    """Receiving end of a reliable stream.

    ``next`` is the number expected next. ``announced`` is the highest number known
    to be sent: ``next - 1`` or later, by less than half of all numbers. Only
    messages between ``next`` and ``next + depth`` are kept, so a peer can make the
    stream hold ``depth`` datagrams at most.
    """

    __slots__ = ("announced", "depth", "doubts", "next", "since", "waiting")
    since: "int"  # time of the first inconsistent message in a row

    def __init__(self, depth: int = WINDOW) -> None:
        self.depth = depth
        self.next = 0
        self.announced = SEQUENCE_MASK
        self.doubts = 0
        self.waiting: "dict[int, bytes]" = {}

    def receive(self, sequence: int, body: "Buffer") -> bool:
        """Return whether the message is the next one, which the caller must handle now.

        If so, the stream expects the one after it. An early message is copied and kept
        for :meth:`pop`; an old, duplicate or too early one is dropped.
        """
        ahead = (sequence - self.next) & SEQUENCE_MASK
        if ahead >= self.depth:
            return False
        if sequence_after(sequence, self.announced):
            self.announced = sequence
        if ahead:
            if sequence not in self.waiting:
                self.waiting[sequence] = bytes(body)
            return False
        self.next = (sequence + 1) & SEQUENCE_MASK
        self.doubts = 0
        # The message may have been kept as an early one, if the caller has not popped it since.
        self.waiting.pop(sequence, None)
        return True

    def pop(self) -> "bytes | None":
        """Return the next message in order, or None if it is missing."""
        body = self.waiting.pop(self.next, None)
        if body is not None:
            self.next = (self.next + 1) & SEQUENCE_MASK
        return body

    def heartbeat(self, first: int, last: int, now: int) -> bool:
        """Handle a HEARTBEAT: the sender holds ``first`` to ``last``; all before is acknowledged.

        A range without ``next`` contradicts this stream. One such HEARTBEAT may be a late one of
        an earlier session, so it changes nothing. To follow it would do harm: a C client accepts
        an ACKNACK of any number, and then drops messages that it has not sent yet.

        Returns:
            Whether so many HEARTBEATs in a row contradict this stream that the sender must have
            dropped messages or restarted its numbers; the caller restarts the stream then.
        """
        count = (last + 1 - first) & SEQUENCE_MASK
        if count <= MAX_HELD:
            if (self.next - first) & SEQUENCE_MASK > count:
                return _doubted(self, now)
            self.doubts = 0
            if sequence_after(last, self.announced):
                self.announced = last
        return False

    def restart(self, first: int, last: int) -> None:
        """Expect ``first`` to ``last`` next; what was kept ahead is dropped and requested again."""
        self.next = first
        self.announced = last
        self.waiting.clear()

    def acknack(self) -> "tuple[int, int]":
        """Return ``(first unacknowledged, missing)`` for an ACKNACK."""
        missing = 0
        # How many messages from `next` on the sender is known to have sent.
        sent = (self.announced + 1 - self.next) & SEQUENCE_MASK
        for i in range(min(16, sent)):
            if (self.next + i) & SEQUENCE_MASK not in self.waiting:
                missing |= 1 << i
        return self.next, missing


class ReliableOut:
    """Sending end of a reliable stream: ``bytes`` in, numbered datagrams out.

    A message is given with its sequence number, :attr:`next`, already in its header.
    """

    __slots__ = (
        "_held", "_sent_at", "acked", "deadline", "limit", "next", "sent", "size", "window",
    )  # fmt: skip

    def __init__(self, window: int = WINDOW, limit: int = MAX_HELD) -> None:
        self.window = window
        self.limit = limit  # most messages held, in flight and waiting
        self.next = 0  # number of the next message given
        self.sent = 0  # number of the next message to go out
        self.acked = 0  # first number not acknowledged
        self.size = 0  # bytes of the messages held
        self.deadline: "int | None" = None
        self._held: "dict[int, bytes]" = {}
        self._sent_at: "dict[int, int]" = {}

    def __len__(self) -> int:
        """Return the number of messages held, in flight and waiting."""
        return len(self._held)

    def available(self) -> int:
        """Return how many messages would be sent at once if given now."""
        return max(0, self.window - len(self._held))

    def sent_at(self, number: int) -> "int | None":
        """Return when a message in flight was last sent, in milliseconds; None for any other."""
        return self._sent_at.get(number)

    def export(self, first: "int | None" = None) -> "tuple[int, int, int, dict[int, bytes]]":
        """Return the stream's state as plain values; `restore` takes them.

        Args:
            first: Number of the first message wanted; by default all that are held.

        Returns:
            `acked`, `sent`, `next`, and the messages held from ``first`` on by their numbers.
        """
        if first is None:
            first = self.acked
        messages = {}
        for i in range((self.next - first) & SEQUENCE_MASK):
            number = (first + i) & SEQUENCE_MASK
            if number in self._held:
                messages[number] = self._held[number]
        return self.acked, self.sent, self.next, messages

    def restore(
        self, acked: int, sent: int, after: int, messages: "dict[int, bytes]", now: int
    ) -> None:
        """Set the state of a new stream to what `export` returned.

        Messages in flight are sent again as soon as the peer asks for them. If there are any, a
        HEARTBEAT is due at once.

        Args:
            acked: First number not acknowledged.
            sent: Number of the next message to go out.
            after: Number of the next message given.
            messages: Those from ``acked`` to before ``after``, by their numbers.
            now: The time in milliseconds modulo 2^30.
        """
        self.acked = acked
        self.sent = sent
        self.next = after
        self._held = dict(messages)
        self.size = 0
        for number in messages:
            self.size += len(messages[number])
        self._sent_at = {}
        for i in range((sent - acked) & SEQUENCE_MASK):
            self._sent_at[(acked + i) & SEQUENCE_MASK] = ticks_add(now, -RESEND_HOLD_MS)
        self.deadline = now if sent != acked else None

    def put(self, message: "bytes | bytearray") -> None:
        """Queue the message with the number :attr:`next`; nobody may change it afterwards.

        Raises:
            LimitError: The stream holds ``limit`` messages.
        """
        if len(self._held) >= self.limit:
            raise LimitError("%d messages wait already" % len(self._held))
        self._held[self.next] = message  # type: ignore[assignment]
        self.size += len(message)
        self.next = (self.next + 1) & SEQUENCE_MASK

    def take(self, now: int) -> "list[bytes]":
        """Return the messages to send now: those not sent yet that the window allows."""
        out = []
        while self.sent != self.next and (self.sent - self.acked) & SEQUENCE_MASK < self.window:
            out.append(self._held[self.sent])
            self._sent_at[self.sent] = now
            self.sent = (self.sent + 1) & SEQUENCE_MASK
        if out and self.deadline is None:
            self.deadline = ticks_add(now, HEARTBEAT_MS)
        return out

    def acknack(self, first: int, missing: int, now: int) -> "list[bytes]":
        """Drop acknowledged messages; return the messages to send now, missing ones first.

        An ACKNACK for numbers never sent is a fault of the peer and is ignored.
        """
        if (first - self.acked) & SEQUENCE_MASK > (self.sent - self.acked) & SEQUENCE_MASK:
            return []
        news = self.acked != first
        while self.acked != first:
            self.size -= len(self._held.pop(self.acked))
            del self._sent_at[self.acked]
            self.acked = (self.acked + 1) & SEQUENCE_MASK
        out = []
        held_back = False
        for i in range(16):
            if missing >> i & 1:
                number = (first + i) & SEQUENCE_MASK
                if number not in self._sent_at:
                    continue
                if ticks_diff(now, self._sent_at[number]) < RESEND_HOLD_MS:
                    held_back = True
                    continue
                self._sent_at[number] = now
                out.append(self._held[number])
        out.extend(self.take(now))
        if self.acked == self.sent:
            self.deadline = None
        elif held_back:
            self.deadline = ticks_add(now, RESEND_HOLD_MS)
        elif news or out or self.deadline is None:
            # Not at every ACKNACK, or repeated ones would postpone the HEARTBEAT for ever.
            self.deadline = ticks_add(now, HEARTBEAT_MS)
        return out

    def heartbeat(self, now: int) -> "tuple[int, int] | None":
        """Return ``(first unacknowledged, last sent)`` if a HEARTBEAT is due, else None."""
        if self.deadline is None or ticks_diff(now, self.deadline) < 0:
            return None
        self.deadline = ticks_add(now, HEARTBEAT_MS)
        return self.acked, (self.sent - 1) & SEQUENCE_MASK


class Fragments:
    """Reassembles fragmented submessages of at most ``limit`` bytes."""

    __slots__ = ("_skip", "_whole", "limit")

    def __init__(self, limit: int = MAX_MESSAGE) -> None:
        self.limit = limit
        # One buffer, not a list of parts. That prevents this attack: millions of fragments of one
        # byte or none, whose objects would take many times the memory of the bytes that the limit
        # counts.
        self._whole: "bytearray" = _NOTHING
        self._skip = False  # whether to drop the rest of an incomplete submessage

    @property
    def pending(self) -> int:
        """Number of bytes kept of an incomplete submessage."""
        return len(self._whole)

    def export(self) -> "tuple[bytearray, bool]":
        """Return the state as plain values; `restore` takes them.

        Returns:
            The bytes of an incomplete submessage, and whether the rest of a submessage is being
            dropped. The bytes are in the stream's own buffer: each fragment extends that object,
            and the next submessage begins another one, so its identity tells the two apart.
        """
        return self._whole, self._skip

    def restore(self, whole: "bytearray", skip: bool) -> None:
        """Set the state to what `export` returned; the buffer is used, not copied."""
        self._whole = whole
        self._skip = skip

    def add(self, part: "Buffer", last: int) -> "bytearray | None":
        """Add a fragment; return the whole submessage, header included, after the last one.

        Raises:
            LimitError: The submessage is longer than ``limit``; its other fragments are dropped.
        """
        if self._skip:
            self._skip = not last
            return None
        whole = self._whole or bytearray()
        if len(whole) + len(part) > self.limit:
            self.drop(last)
            raise LimitError("fragments of over %d bytes" % self.limit)
        whole.extend(part)
        self._whole = _NOTHING if last else whole
        return whole if last else None

    def drop(self, last: int = True) -> None:
        """Drop the fragments received, and unless ``last``, also those that follow.

        Allocates nothing, because it is also called when there is no memory for a fragment.
        """
        self._skip = not last
        self._whole = _NOTHING

    def interrupt(self) -> None:
        """Handle the loss of messages: drop an incomplete submessage, with fragments to come."""
        self.drop(not (self._skip or self._whole))


def split(size: int, room: int) -> "list[tuple[int, int, int]]":
    """Return how ``size`` bytes of one submessage are split into fragments of ``room`` bytes.

    The result is a list of ``(start, stop, flags)``, the last with FLAG_LAST_FRAGMENT.
    Fragments before the last are a multiple of 4 long, so that C clients find
    the next header aligned.
    """
    room &= ~3
    if room <= 0:
        raise LimitError("an MTU that leaves no room for a fragment")
    out = []
    start = 0
    while size - start > room:
        out.append((start, start + room, ids.FLAG_LITTLE_ENDIAN))
        start += room
    out.append((start, size, ids.FLAG_LITTLE_ENDIAN | ids.FLAG_LAST_FRAGMENT))
    return out
