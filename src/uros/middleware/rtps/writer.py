"""A writer's side of RTPS: its history, and what each matched reader has of it.

A :class:`StatefulWriter` takes samples, acknowledgements and the time, and gives submessages and a
deadline (RTPS 8.4.7, 8.4.9). It uses neither sockets nor a clock.

The history keeps what late readers may want (transient local), and what reliable readers have not
acknowledged, within the depth and the lifespan. A number that a reader asks for and that is not
kept, was not for it, or is from before it matched, is answered by a GAP.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

from ...token_bucket import TokenBucket
from . import ids
from .changes import Change, Packet, gaps, holes, runs
from .kinds import AckNack, NackFrag
from .reader import is_newer
from .reader_proxy import HEARTBEAT_FIRST, ReaderProxy
from .submessages import encode_data, encode_data_frag, encode_heartbeat, encode_timed_data

# Seconds between heartbeats while a reader has not acknowledged everything, at last: a reader that
# does not answer is asked more and more seldom.
_HEARTBEAT_LAST: Final = 2.0
# What readers are not asked to acknowledge behind each burst: samples of a reader, octets in all.
_UNASKED: Final = 16
_UNASKED_OCTETS: Final = 16 * 1024
# Attack: a request for all of a large sample, again and again. Octets that are sent again to one
# reader at once; the rest follows after a pause, in seconds.
_RESEND_OCTETS: Final = 32 * 1024
_RESEND_PAUSE: Final = 0.002
# Attack: the same of many readers. Octets a second that all writers of a participant repeat to all
# readers, and at once.
_REPEAT_RATE: Final = 32 * 1024 * 1024
_REPEAT_BURST: Final = 128 * 1024
# Samples of megabytes that nobody acknowledges. Octets in the history with ``depth`` None.
MAX_HISTORY: Final = 64 * 1024 * 1024
# Attack: a reader that never acknowledges, for which a writer that keeps all would wait for ever.
# After so many seconds without an acknowledgement, a full history is kept for others only.
_PATIENCE: Final = 10.0
# A reader whose acknowledgements are behind its earlier ones, for so many seconds, has begun anew.
_RESTART_AFTER: Final = 1.0


def repeat_budget() -> TokenBucket:
    """Return a token bucket of octets that may be repeated, for the writers of a participant."""
    return TokenBucket(_REPEAT_BURST, _REPEAT_RATE)


class StatefulWriter:
    """A writer with its matched readers.

    Attributes:
        guid: Its GUID.
        reliable: Whether it sends again what is lost.
        readers: Its matched readers by GUID.
        reliable_readers: Those of them that acknowledge.
        transient_local: Whether late readers get what is in the history.
        depth: Samples that the history keeps; None: see the argument.
        last: The last sequence number written; 0: none.
        on_change: Called with the writer when its deadline may have changed other than by a poll.

    Args:
        guid: Its GUID.
        reliable: Whether it is reliable.
        transient_local: Whether late readers get what is in the history.
        depth: Samples that the history keeps; None: all that are not acknowledged, and all for
            late readers, up to ``limit``.
        fragment_size: Octets of a fragment; longer samples are sent in fragments.
        limit: The most samples in the history with ``depth`` None.
        is_manual: Whether writing asserts its liveliness (MANUAL_BY_TOPIC).
        lifespan: Seconds that the history keeps a sample at most; infinity: no limit.
        repeats: What may be repeated; None: no more than this writer alone may.
    """

    def __init__(
        self,
        guid: bytes,
        reliable: bool,
        transient_local: bool,
        depth: int | None,
        fragment_size: int,
        limit: int = 5000,
        is_manual: bool = False,
        lifespan: float = math.inf,
        repeats: TokenBucket | None = None,
    ) -> None:
        self.guid = guid
        self.reliable = reliable
        self.readers: dict[bytes, ReaderProxy] = {}
        self.reliable_readers: dict[bytes, ReaderProxy] = {}
        self.last = 0
        self.on_change: Callable[[StatefulWriter], None] = lambda writer: None
        self.transient_local = transient_local
        self.depth = depth
        self._limit = limit
        self._fragment_size = fragment_size
        self._is_manual = is_manual
        self._lifespan = lifespan
        self._repeats = repeats if repeats is not None else repeat_budget()
        self._history: dict[int, Change] = {}  # in order of their numbers
        self._octets = 0  # in the history
        self._expiring: set[int] = set()  # numbers that late readers do not get
        self._counter = 0  # of heartbeats
        self._entity = guid[ids.PREFIX_SIZE :]

    # --- readers --------------------------------------------------------------------------

    def match(
        self, guid: bytes, reliable: bool, wants_history: bool, now: float,
        wants_header: bool = False, since: float = math.inf,
    ) -> list[Packet]:  # fmt: skip
        """Add a reader, or change nothing where it is known.

        Args:
            guid: The reader's GUID.
            reliable: Whether it is reliable.
            wants_history: Whether it is transient local.
            now: The time in seconds.
            wants_header: Whether it expects the identity of a request in the payload.
            since: From when on a reliable reader that is volatile gets what is in the history.

        Returns:
            What it is sent at once: the history for a best-effort reader, else a heartbeat.
        """
        if guid in self.readers:
            return []
        self.on_change(self)
        self._drop_expired(now)
        late = wants_history and self.transient_local and bool(self._history)
        first = next(iter(self._history)) if late else self.last + 1
        last = self.last
        if self.transient_local and not late and since <= now:
            # It begins here whatever implementation it is of: see _heartbeat().
            first = next((n for n, c in self._history.items() if c.written_at >= since), first)
            last = first - 1
        proxy = self.readers[guid] = ReaderProxy(
            guid, reliable and self.reliable, first, last, wants_header, now
        )
        if proxy.reliable:
            self.reliable_readers[guid] = proxy
            self._schedule_heartbeat(proxy, now)
            return [Packet(guid, self._heartbeat(proxy), None)]
        if not late:
            return []
        return [
            packet
            for change in list(self._history.values())
            if change.is_for(guid)
            for packet in self._data(change, proxy)
        ]

    def unmatch(self, guid: bytes) -> None:
        """Remove a reader; idempotent."""
        if self.readers.pop(guid, None) is not None:
            self.reliable_readers.pop(guid, None)
            self.on_change(self)
            self._trim()

    def unmatch_participant(self, prefix: bytes) -> None:
        """Remove all readers of a participant."""
        guids = [guid for guid in self.readers if guid.startswith(prefix)]
        for guid in guids:
            del self.readers[guid]
            self.reliable_readers.pop(guid, None)
        if guids:
            self.on_change(self)
            self._trim()

    def ask(self, guid: bytes, now: float) -> None:
        """Send a reader its next heartbeat now, if it has something to answer."""
        proxy = self.reliable_readers.get(guid)
        if proxy is not None and (proxy.waits_until is not None or proxy.acked < self.last):
            proxy.heartbeat_at = now
            self.on_change(self)

    # --- samples --------------------------------------------------------------------------

    def has_room(self) -> bool:
        """Return whether a sample can be written: False with ``depth`` None and a full history."""
        if not self._is_full():
            return True
        if self.transient_local:  # the oldest that all readers have makes room
            return self._acked() >= next(iter(self._history))
        return False

    def _is_full(self) -> bool:
        return self.depth is None and (
            len(self._history) >= self._limit or self._octets >= MAX_HISTORY
        )

    def _acked(self) -> int:
        """The number up to which all readers have everything that is kept for them."""
        return min(
            (proxy.acked for proxy in self.reliable_readers.values() if not proxy.is_stalled),
            default=self.last,
        )

    def write(
        self,
        payload: bytes | None,
        time_ns: int | None,
        now: float,
        inline_qos: bytes = b"",
        readers: frozenset[bytes] | None = None,
        is_key: bool = False,
        with_header: bytes | None = None,
    ) -> list[Packet]:
        """Write a sample; call it only if :meth:`has_room`.

        Args:
            payload: The sample with its encapsulation header; None for a farewell.
            time_ns: The time, in ns since 1970; None: unknown.
            now: The time of deadlines, in seconds.
            inline_qos: Inline QoS, little endian, with its sentinel; empty without one.
            readers: The GUIDs of the only readers that it is for; None: for all.
            is_key: Whether the payload is a key.
            with_header: The payload for readers that want the header, see :class:`Change`.

        Returns:
            What is to be sent.
        """
        self.last += 1
        reliable = self.reliable_readers
        is_kept = bool(reliable) or self.transient_local
        if not is_kept and not self.readers:
            return []
        change = Change(
            self.last, payload, inline_qos, time_ns, readers, is_key, with_header,
            now, now + self._lifespan,
        )  # fmt: skip
        if is_kept:
            self._keep(change)
        is_for_all = readers is None and with_header is None and not self._has_waiting()
        packets = self._data(change, None) if is_for_all and self.readers else []
        for proxy in (reliable if is_for_all else self.readers).values():
            if proxy.waits_until is not None:
                self._schedule_heartbeat(proxy, now)
                if proxy.heartbeat_pause == HEARTBEAT_FIRST and change.is_for(proxy.guid):
                    proxy.heartbeat_at = now  # it may know the writer by now
                    self.on_change(self)
                continue
            if not is_for_all and change.is_for(proxy.guid):
                packets += self._data(change, proxy)
            if not proxy.reliable:
                continue
            if not change.is_for(proxy.guid):
                # Otherwise its next acknowledgement would ask for it.
                packets += gaps(self._entity, proxy.guid, [(self.last, self.last)])
            self._schedule_heartbeat(proxy, now)
        return packets

    def write_once(self, payload: bytes, time_ns: int) -> bytes | None:
        """Write a sample that the history does not keep, which takes less than :meth:`write`.

        Args:
            payload: The sample with its encapsulation header.
            time_ns: The time, in ns since 1970.

        Returns:
            The submessages for all readers, empty where there is none; or None, and nothing is
            written, where the history keeps samples or this one needs fragments.
        """
        if self.transient_local or self.reliable_readers or len(payload) > self._fragment_size:
            return None
        self.last += 1
        if not self.readers:
            return b""
        return encode_timed_data(self._entity, self.last, payload, time_ns)

    def heartbeats_for_burst(self) -> list[Packet]:
        """Return heartbeats to follow a burst of samples.

        Readers answer where they lack something. Where much is not acknowledged, they are asked to
        acknowledge it; else the heartbeat of the next pause asks them.
        """
        last, waits, behind = self.last, False, 0
        lacking = []
        for proxy in self.reliable_readers.values():  # for each burst: one loop
            if proxy.waits_until is not None:
                waits = True
            elif proxy.acked < last:
                lacking.append(proxy)
                behind = max(behind, last - proxy.acked)
        if not lacking:
            return []
        # With the DATA lost, it still shows that the writer is alive.
        liveliness = self._is_manual
        final = not self.transient_local and self._octets < _UNASKED_OCTETS and behind < _UNASKED
        if not waits:
            return [Packet(None, self._heartbeat(None, liveliness, final), None)]
        return [
            Packet(proxy.guid, self._heartbeat(proxy, liveliness, final), None) for proxy in lacking
        ]

    def _has_waiting(self) -> bool:
        for proxy in self.reliable_readers.values():  # without a generator: for each sample
            if proxy.waits_until is not None:
                return True
        return False

    def _keep(self, change: Change) -> None:
        """Add a sample to the history."""
        if self._lifespan != math.inf or self.depth is None:
            self.on_change(self)  # it may be the first to expire, or the last that finds room
        self._make_room()
        self._history[change.number] = change
        self._octets += change.octets

    def _make_room(self) -> None:
        """Keep the history within its depth when one is added."""
        if self.depth is not None:
            while len(self._history) >= self.depth:
                self._drop(next(iter(self._history)))
            return
        acked = self._acked() if self._is_full() else 0
        while self._is_full() and next(iter(self._history)) <= acked:
            self._drop(next(iter(self._history)))

    def _drop(self, number: int) -> None:
        self._octets -= self._history.pop(number).octets

    def _drop_expired(self, now: float) -> None:
        """Drop samples whose lifespan is over; all have the same, so the oldest go first."""
        while self._history:
            oldest = next(iter(self._history.values()))
            if oldest.expires > now:
                break
            self.remove(oldest.number)

    def _trim(self) -> None:
        """Drop what all reliable readers have, where no late reader wants it."""
        acked = self._acked()
        if self.transient_local:
            for number in [number for number in self._expiring if number <= acked]:
                self.remove(number)
            return
        while self._history:
            oldest = next(iter(self._history))
            if oldest > acked:
                break
            self._drop(oldest)

    def history(self, now: float) -> list[Change]:
        """Return the samples that a late reader gets, oldest first."""
        if not self.transient_local:
            return []
        self.on_change(self)
        self._drop_expired(now)
        return [change for change in self._history.values() if change.readers is None]

    def remove(self, number: int) -> None:
        """Drop a sample from the history; idempotent."""
        if number in self._history:
            self.on_change(self)
            self._drop(number)
        self._expiring.discard(number)

    def expire(self, number: int) -> None:
        """Drop a sample as soon as the readers that are matched now have acknowledged it."""
        self._expiring.add(number)
        self._trim()

    def _first(self) -> int:
        """The first number in the history; behind the last where it is empty."""
        return next(iter(self._history), self.last + 1)

    # --- what comes -----------------------------------------------------------------------

    def on_acknack(self, reader: bytes, acknack: AckNack, now: float) -> bool:
        """Handle ACKNACK of a matched reader; one that comes late is dropped.

        Returns:
            False where the reader has begun anew: its participant was restarted, or has forgotten
            this writer meanwhile.
        """
        proxy = self.readers.get(reader)
        if proxy is None or not proxy.reliable:
            return True
        if is_newer(acknack.counter, proxy.acknack_counter):
            proxy.behind_since = None
        elif proxy.behind_since is None:
            proxy.behind_since = now
            return True
        elif now - proxy.behind_since < _RESTART_AFTER:
            return True
        if proxy.acked >= proxy.first >= acknack.base:
            return False
        self.on_change(self)
        proxy.acknack_counter = acknack.counter
        proxy.heard_at = now
        proxy.is_stalled = False
        if proxy.waits_until is not None and (acknack.final or acknack.missing):
            self._begin(proxy, now)  # else it asks for a heartbeat: it may know of none yet
        acked = min(acknack.base - 1, self.last)
        if acked > proxy.acked:
            proxy.acked = acked
            proxy.heartbeat_pause = HEARTBEAT_FIRST
            proxy.requested = {number for number in proxy.requested if number > acked}
            for number in [number for number in proxy.fragments if number <= acked]:
                del proxy.fragments[number]
            self._trim()
        asked = [number for number in acknack.missing if acked < number <= self.last]
        if asked:
            proxy.requested.update(asked)
            proxy.resend_at = proxy.resend_at or now
        if proxy.acked >= self.last:
            proxy.heartbeat_at = None
        else:
            self._schedule_heartbeat(proxy, now)
        if not acknack.final and not asked:
            proxy.heartbeat_at = now  # it asks what there is
        return True

    def _begin(self, proxy: ReaderProxy, now: float) -> None:
        """Send a reader all that is for it."""
        proxy.waits_until = None
        if self.last >= proxy.first:
            there = [number for number in self._history if number >= proxy.first]
            proxy.requested.update(there)
            proxy.holes = holes(there, max(proxy.first, self._first()), self.last)
            if proxy.first < self._first():
                proxy.requested.add(proxy.first)  # what is gone is answered by gaps
            proxy.resend_at = now
            proxy.heartbeat_at = now

    def on_nack_frag(self, reader: bytes, nack: NackFrag, now: float) -> None:
        """Handle NACK_FRAG of a matched reader; one that comes late is dropped."""
        proxy = self.readers.get(reader)
        if proxy is None or not proxy.reliable:
            return
        if not is_newer(nack.counter, proxy.nack_frag_counter):
            return
        proxy.nack_frag_counter = nack.counter
        change = self._history.get(nack.number)
        if change is not None:
            last = -(-change.octets // self._fragment_size)
            asked = [number for number in nack.missing if number <= last]
            if asked:
                proxy.fragments.setdefault(nack.number, set()).update(asked)
        elif nack.number <= self.last:
            proxy.requested.add(nack.number)  # what is gone is answered by a gap
        proxy.resend_at = proxy.resend_at or now
        self.on_change(self)

    # --- what it sends -----------------------------------------------------------------------

    def next_deadline(self) -> float | None:
        """Return when :meth:`poll` has something to send, or None."""
        deadline = None
        if self._lifespan != math.inf and self._history:
            deadline = next(iter(self._history.values())).expires
        is_full = self._is_full()
        for proxy in self.reliable_readers.values():
            stalls_at = None
            if is_full and not proxy.is_stalled and proxy.acked < self.last:
                stalls_at = proxy.heard_at + _PATIENCE
            for at in (proxy.resend_at, proxy.heartbeat_at, proxy.waits_until, stalls_at):
                if at is not None and (deadline is None or at < deadline):
                    deadline = at
        return deadline

    def poll(self, now: float) -> Iterator[Packet]:
        """Yield what is due: samples to send again, gaps and heartbeats; drop what has expired."""
        self._drop_expired(now)
        if self._is_full():
            self._give_up_stalled(now)
        for proxy in list(self.reliable_readers.values()):
            if proxy.waits_until is not None and proxy.waits_until <= now:
                self._begin(proxy, now)
            if proxy.resend_at is not None and proxy.resend_at <= now:
                if self._repeats.available(now) > 0:
                    yield from self._resend(proxy, now)
                    if proxy.guid in self.reliable_readers:  # behind the others that wait
                        self.reliable_readers[proxy.guid] = self.reliable_readers.pop(proxy.guid)
                else:
                    proxy.resend_at = now + _RESEND_PAUSE
            if proxy.heartbeat_at is not None and proxy.heartbeat_at <= now:
                yield Packet(proxy.guid, self._heartbeat(proxy), None)
                proxy.heartbeat_at = None
                if proxy.acked < self.last or proxy.waits_until is not None:
                    proxy.heartbeat_at = now + proxy.heartbeat_pause
                    proxy.heartbeat_pause = min(_HEARTBEAT_LAST, proxy.heartbeat_pause * 2)

    def _give_up_stalled(self, now: float) -> None:
        """Keep the history no longer for readers that have not acknowledged for long."""
        for proxy in self.readers.values():
            if proxy.acked < self.last and now >= proxy.heard_at + _PATIENCE:
                proxy.is_stalled = True
        self._trim()

    def _schedule_heartbeat(self, proxy: ReaderProxy, now: float) -> None:
        if proxy.heartbeat_at is None:
            proxy.heartbeat_at = now + proxy.heartbeat_pause
            self.on_change(self)

    def _heartbeat(
        self, proxy: ReaderProxy | None, liveliness: bool = False, final: bool = False
    ) -> bytes:
        self._counter += 1
        reader = ids.ENTITY_UNKNOWN if proxy is None else proxy.guid[ids.PREFIX_SIZE :]
        first, last = self._first(), self.last
        if proxy is not None and proxy.waits_until is not None:
            # Cyclone takes the first heartbeat of a writer for that of all its readers: volatile
            # ones begin after the last number, others ask for what is up to it.
            last = proxy.last_at_match
            first = min(first, last + 1)
        return encode_heartbeat(
            reader, self._entity, first, last, self._counter & 0x7FFF_FFFF, final, liveliness
        )

    def _data(self, change: Change, proxy: ReaderProxy | None) -> list[Packet]:
        """DATA, or DATA_FRAG of all fragments; for all readers, or for one in its form."""
        guid, reader = None, ids.ENTITY_UNKNOWN
        payload, inline_qos = change.payload, change.inline_qos
        if proxy is not None:
            guid, reader = proxy.guid, proxy.guid[ids.PREFIX_SIZE :]
            payload, inline_qos = _form(change, proxy)
        if payload is None or len(payload) <= self._fragment_size:
            data = encode_data(
                reader, self._entity, change.number, payload, inline_qos, change.is_key
            )
            return [Packet(guid, data, change.time_ns)]
        return [
            Packet(guid, self._fragment(change, proxy, number), change.time_ns)
            for number in range(1, -(-len(payload) // self._fragment_size) + 1)
        ]

    def _fragment(self, change: Change, proxy: ReaderProxy | None, number: int) -> bytes:
        payload, inline_qos = _form(change, proxy)
        assert payload is not None
        start = (number - 1) * self._fragment_size
        return encode_data_frag(
            ids.ENTITY_UNKNOWN if proxy is None else proxy.guid[ids.PREFIX_SIZE :],
            self._entity, change.number, number, self._fragment_size, len(payload),
            memoryview(payload)[start : start + self._fragment_size], inline_qos,
        )  # fmt: skip

    def _resend(self, proxy: ReaderProxy, now: float) -> Iterator[Packet]:
        """What the reader asked for, up to so many octets."""
        proxy.resend_at = None
        octets = 0
        irrelevant: list[int] = []
        reached: float = math.inf
        for number in sorted(proxy.requested | proxy.fragments.keys()):
            if octets >= _RESEND_OCTETS:
                reached = number
                break
            change = self._history.get(number)
            if change is None or number < proxy.first or not change.is_for(proxy.guid):
                proxy.requested.discard(number)
                proxy.fragments.pop(number, None)
                irrelevant.append(number)
                continue
            for packet in self._asked_data(proxy, change):
                octets += len(packet.submessages)
                self._repeats.spend(len(packet.submessages))
                yield packet
                if octets >= _RESEND_OCTETS:
                    break
        yield from gaps(self._entity, proxy.guid, [run for run in proxy.holes if run[0] < reached])
        proxy.holes = [run for run in proxy.holes if run[0] >= reached]
        yield from gaps(self._entity, proxy.guid, runs(irrelevant))
        if proxy.requested or proxy.fragments:
            proxy.resend_at = now + _RESEND_PAUSE
        else:  # whether it has all of it
            proxy.heartbeat_pause = HEARTBEAT_FIRST
            proxy.heartbeat_at = now

    def _asked_data(self, proxy: ReaderProxy, change: Change) -> Iterator[Packet]:
        number = change.number
        payload, _ = _form(change, proxy)
        if payload is None or len(payload) <= self._fragment_size:
            proxy.requested.discard(number)
            proxy.fragments.pop(number, None)
            yield from self._data(change, proxy)
            return
        last = -(-len(payload) // self._fragment_size)
        asked = proxy.fragments.setdefault(number, set())
        if number in proxy.requested:
            proxy.requested.discard(number)
            asked.update(range(1, last + 1))
        for fragment in sorted(asked):
            asked.discard(fragment)
            if not asked:
                del proxy.fragments[number]
            if fragment <= last:
                yield Packet(proxy.guid, self._fragment(change, proxy, fragment), change.time_ns)


def _form(change: Change, proxy: ReaderProxy | None) -> tuple[bytes | None, bytes]:
    """Payload and inline QoS in the form of a reader."""
    if proxy is not None and proxy.wants_header and change.with_header is not None:
        return change.with_header, b""
    return change.payload, change.inline_qos
