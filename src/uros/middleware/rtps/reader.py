"""A reader's side of RTPS: what it has of each writer, and what it asks for.

A :class:`StatefulReader` takes submessages and the time, and gives samples, acknowledgements and a
deadline (RTPS 8.4.10, 8.4.12). It uses neither sockets nor a clock.

A reliable reader delivers each writer's samples in order and once. Where it lacks some, it asks for
them when a heartbeat says that the writer has them; what the writer no longer has, or says is not
for this reader, is passed over. A best-effort reader delivers what is newer than the last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from ..guid import CYCLONE_DDS, FAST_DDS
from . import ids, parameters
from .kinds import Data, DataFrag, Gap, Heartbeat, HeartbeatFrag
from .parameters import InlineQos
from .reassembly import MAX_INCOMPLETE, IncompleteSample, OctetBudget
from .submessages import MAX_BITS, MalformedError, encode_acknack, encode_nack_frag, unpadded

# Attack: samples far ahead of what is expected, each of which would be held. Numbers, and what an
# entry costs besides its octets.
MAX_AHEAD: Final = 4096
_OVERHEAD: Final = 200
# Attack: gaps of any width. Numbers of a gap that are noted before their turn; the writer is asked
# for the others, and answers with the gap again.
_MAX_NOTED: Final = 256
# Attack: a sample that is refused each time, as there is no room. A request that brought nothing is
# repeated by the next heartbeat after a pause, which doubles; seconds.
_PAUSE_FIRST: Final = 0.005
_PAUSE_LAST: Final = 0.5
# A request that nothing answered is repeated after a time that doubles, not by the next
# heartbeat: that of Fast DDS comes after 3 s. Seconds.
_RETRY_FIRST: Final = 0.1
_RETRY_LAST: Final = 2.0
# A writer whose heartbeats, or best-effort samples, are behind what came from it for so long has
# begun anew; seconds.
_RESTART_AFTER: Final = 1.0
# A writer that does not answer the first acknowledgement with a heartbeat is asked again, after a
# time that doubles; Fast DDS repeats its own after 3 s. It is asked as long as it is there: each
# acknowledgement may be lost, and one that began anew counts none that comes within a second.
_ASK_FIRST: Final = 0.1
_ASK_LAST: Final = 6.4
# Samples that come before the first heartbeat wait for it, as the first of them may be lost, until
# so many questions were not answered; then the lowest of them is the first. At 30 % loss three in
# turn are not rare.
_MAX_UNANSWERED: Final = 6
_COUNT_HALF: Final = 0x8000_0000
_new = tuple.__new__


class Sample(NamedTuple):
    """A received sample.

    Attributes:
        payload: With its encapsulation header; None where it disposes or unregisters without one.
        writer: The GUID of its writer.
        number: Its sequence number.
        inline_qos: What its inline QoS says; None without one.
        is_key: Whether the payload is a key.
        expires: When its lifespan is over, which began when it arrived: clocks of other machines
            differ and jump. Infinity: never.
        source_ns: The source time that its writer gave (Unix ns); 0: unknown.
    """

    payload: bytes | None
    writer: bytes
    number: int
    inline_qos: InlineQos | None
    is_key: bool
    expires: float = math.inf
    source_ns: int = 0


def is_newer(counter: int, last: int | None) -> bool:
    """Return whether a counter of 32 bits that wraps is above the last one."""
    return last is None or 0 < (counter - last) & 0xFFFF_FFFF < _COUNT_HALF


class WriterProxy:
    """What a reader knows of one matched writer.

    Attributes:
        guid: The writer's GUID.
        reliable: Whether it repeats what is lost.
        expected: The number after the last that was delivered or passed over. None at first: a
            reliable writer's is set by the first HEARTBEAT, or from what is held after questions
            that were not answered; a best-effort writer's by the first sample.
        held: Samples beyond ``expected`` by number; None for numbers that are passed over.
        lifespan: Seconds that its samples count.
        lost: Samples that the writer no longer had.
        progress: Counts samples and fragments that were taken, and numbers that were passed over.
        in_vain: Requests in a row that brought nothing.
        behind_since: When the counter of its heartbeats fell, or its best-effort samples began to
            be behind what came from it; None: they are not.
        last_at_match: The last number of its first heartbeat; 0: none has come.
    """

    __slots__ = (
        "ack_at", "asked", "behind_since", "expected", "guid", "heartbeat_counter", "held",
        "held_octets", "highest", "in_vain", "incomplete", "last_at_match", "lifespan", "lost",
        "participant", "progress", "reliable", "requested_at", "retry_at",
    )  # fmt: skip

    def __init__(self, guid: bytes, reliable: bool, now: float) -> None:
        self.guid = guid
        self.participant = guid[: ids.PREFIX_SIZE]
        self.reliable = reliable
        self.lifespan = math.inf
        self.expected: int | None = None
        self.held: dict[int, Sample | None] = {}
        self.held_octets = 0
        self.incomplete: dict[int, IncompleteSample] = {}
        self.highest = 0  # the last number that the writer is known to have
        self.last_at_match = 0
        self.heartbeat_counter: int | None = None
        self.progress = 0
        self.requested_at = -1  # the progress
        self.in_vain = 0
        self.retry_at: float | None = None
        self.behind_since: float | None = None
        self.lost = 0
        self.asked = 0  # first acknowledgements that no heartbeat answered
        self.ack_at: float | None = now if reliable else None


class StatefulReader:
    """A reader with its matched writers.

    Attributes:
        guid: Its GUID.
        reliable: Whether it asks for what is lost.
        writers: Its matched writers by GUID.
        malformed: Samples whose inline QoS was not valid, which were dropped.
        on_change: Called with the reader when its deadline may have changed other than by a poll.

    Args:
        guid: Its GUID.
        reliable: Whether it is reliable.
        from_first: Whether it wants what a writer wrote before they matched (transient local).
        deliver: Called with each sample, in order; returns False where there is no room: a reliable
            reader then does not acknowledge it and gets it again.
        budget: For samples that are incomplete or early.
        on_early: Called with a sample that waits for others before it, besides ``deliver``.
    """

    def __init__(
        self,
        guid: bytes,
        reliable: bool,
        from_first: bool,
        deliver: Callable[[Sample], bool],
        budget: OctetBudget,
        on_early: Callable[[Sample], object] | None = None,
    ) -> None:
        self.guid = guid
        self.reliable = reliable
        self.writers: dict[bytes, WriterProxy] = {}
        self.malformed = 0
        self._lost_before = 0  # of writers that have left
        self.on_change: Callable[[StatefulReader], None] = lambda reader: None
        self._from_first = from_first
        self._deliver = deliver
        self._budget = budget
        self._on_early = on_early
        self._entity = guid[ids.PREFIX_SIZE :]
        # Of acknowledgements. They rise across matches with one writer, which may not have noticed
        # that it was forgotten, and drops counters that do not rise.
        self._counter = 0

    # --- writers --------------------------------------------------------------------------

    def match(self, guid: bytes, reliable: bool, now: float, lifespan: float = math.inf) -> None:
        """Add a writer, or update the lifespan of its samples in seconds."""
        if guid not in self.writers:
            self.writers[guid] = WriterProxy(guid, reliable and self.reliable, now)
            self.on_change(self)
        self.writers[guid].lifespan = lifespan

    def unmatch(self, guid: bytes) -> None:
        """Remove a writer with what is held of it; idempotent."""
        proxy = self.writers.pop(guid, None)
        if proxy is not None:
            self._lost_before += proxy.lost
            self.on_change(self)
            self._budget.give_back(proxy.held_octets, proxy.participant)
            for incomplete in proxy.incomplete.values():
                incomplete.close()

    def lost(self) -> int:
        """Return how many samples of all writers were lost until now."""
        return self._lost_before + sum(proxy.lost for proxy in self.writers.values())

    def unmatch_participant(self, prefix: bytes) -> None:
        """Remove all writers of a participant."""
        for guid in [guid for guid in self.writers if guid.startswith(prefix)]:
            self.unmatch(guid)

    def ask(self, guid: bytes, now: float) -> None:
        """Send a writer an acknowledgement now, if it has something to answer."""
        proxy = self.writers.get(guid)
        if proxy is not None and (proxy.heartbeat_counter is None or self._lacks(proxy)):
            proxy.ack_at = now
            self.on_change(self)

    def close(self) -> None:
        """Remove all writers."""
        for guid in list(self.writers):
            self.unmatch(guid)

    # --- what comes -----------------------------------------------------------------------

    def receive(
        self,
        writer: bytes,
        submessage: Data | DataFrag | Heartbeat | HeartbeatFrag | Gap,
        now: float,
        source_ns: int = 0,
    ) -> bool:
        """Handle a submessage of a writer; False where the writer has begun anew.

        Args:
            writer: The writer's GUID.
            submessage: The submessage.
            now: The time in seconds.
            source_ns: The time of the INFO_TS before it (Unix ns); 0: unknown.
        """
        is_same = True
        if type(submessage) is Data:
            is_same = self.is_continued(writer, submessage.number, now)
            self.on_data(
                writer, submessage.number, submessage.payload, submessage.inline_qos,
                submessage.little, submessage.is_key, now, source_ns,
            )  # fmt: skip
        elif type(submessage) is DataFrag:
            is_same = self.is_continued(writer, submessage.number, now)
            self.on_fragments(writer, submessage, now, source_ns)
        elif isinstance(submessage, Heartbeat):
            is_same = self.on_heartbeat(writer, submessage, now)
        elif isinstance(submessage, Gap):
            self.on_gap(writer, submessage)
        else:
            self.on_heartbeat_frag(writer, submessage, now)
        return is_same

    def on_data(
        self,
        writer: bytes,
        number: int,
        payload: bytes | memoryview | None,
        inline_qos: bytes | None,
        little: bool,
        is_key: bool,
        now: float,
        source_ns: int = 0,
    ) -> None:
        """Handle DATA of a matched writer; of another it is dropped.

        Args:
            writer: The writer's GUID.
            number: The sequence number.
            payload: The sample with its encapsulation header; None without one.
            inline_qos: The inline QoS as octets; None without one.
            little: Its byte order.
            is_key: Whether the payload is a key.
            now: The time in seconds.
            source_ns: Its source time (Unix ns); 0: unknown.
        """
        proxy = self.writers.get(writer)
        if proxy is None or not self._is_wanted(proxy, number):
            return
        qos = None
        if inline_qos is not None:
            try:
                qos = parameters.read_inline_qos(inline_qos, little)
            except MalformedError:
                self.malformed += 1
                if proxy.reliable:
                    self._pass_over(proxy, number)  # it would be asked for without end
                    self._deliver_held(proxy)
                return
        octets = None if payload is None else bytes(payload)
        if octets is not None and len(octets) > 3 and octets[3] & 3:
            octets = unpadded(octets)
        expires = now + proxy.lifespan
        # As Sample(...), which is a call of Python: for each sample.
        sample = _new(Sample, (octets, writer, number, qos, is_key, expires, source_ns))
        self._accept(proxy, sample)

    def is_continued(self, writer: bytes, number: int, now: float) -> bool:
        """Return whether a sample's number is not one of a best-effort writer that began anew.

        Of reliable writers the heartbeats tell.
        """
        proxy = self.writers.get(writer)
        if proxy is None or proxy.reliable:
            return True
        if proxy.expected is None or number >= proxy.expected:
            proxy.behind_since = None
        elif proxy.behind_since is None:
            proxy.behind_since = now
        else:
            return now - proxy.behind_since < _RESTART_AFTER
        return True

    def on_fragments(
        self, writer: bytes, fragment: DataFrag, now: float, source_ns: int = 0
    ) -> None:
        """Handle DATA_FRAG of a matched writer; of another it is dropped."""
        proxy = self.writers.get(writer)
        number = fragment.number
        if proxy is None or not self._is_wanted(proxy, number) or number in proxy.held:
            return
        incomplete = proxy.incomplete.get(number)
        if incomplete is None:
            if not IncompleteSample.is_acceptable(fragment, self._budget):
                if proxy.reliable and proxy.expected is not None:
                    self._pass_over(proxy, number)  # it would be asked for without end
                    self._deliver_held(proxy)
                return
            if len(proxy.incomplete) >= MAX_INCOMPLETE:
                oldest = min(proxy.incomplete)
                if proxy.reliable and oldest < number:
                    return  # the older one first; this one is asked for later
                proxy.incomplete.pop(oldest).close()
            incomplete = proxy.incomplete[number] = IncompleteSample(
                fragment, self._budget, proxy.participant
            )
        payload = incomplete.add(fragment)
        proxy.progress += incomplete.has_progressed
        if payload is None:
            return
        qos, is_key = incomplete.inline_qos, incomplete.is_key
        del proxy.incomplete[number]
        incomplete.close()
        raw, little = qos if qos is not None else (None, True)
        self.on_data(writer, number, payload, raw, little, is_key, now, source_ns)

    def on_heartbeat(self, writer: bytes, heartbeat: Heartbeat, now: float) -> bool:
        """Handle HEARTBEAT of a matched reliable writer; one that comes late is dropped.

        Returns:
            False where the writer has begun anew, as after a restart of its participant under the
            same GUID: what is known of the participant no longer holds.
        """
        proxy = self.writers.get(writer)
        if proxy is None or not proxy.reliable:
            return True
        is_new = is_newer(heartbeat.counter, proxy.heartbeat_counter)
        if is_new:  # whatever its last number: Fast DDS's falls when it drops the last samples
            proxy.behind_since = None
        elif proxy.behind_since is None:
            proxy.behind_since = now
        elif now - proxy.behind_since >= _RESTART_AFTER:
            return False
        if not is_new:
            return True
        ack_before = proxy.ack_at
        if proxy.heartbeat_counter is None:
            proxy.last_at_match = heartbeat.last
        proxy.heartbeat_counter = heartbeat.counter
        proxy.asked = 0
        pending = None if proxy.expected is None else proxy.ack_at
        proxy.ack_at = None
        proxy.highest = max(proxy.highest, heartbeat.last)
        if proxy.expected is None:
            first = heartbeat.first
            if not self._from_first and writer.startswith(CYCLONE_DDS):
                # Cyclone repeats for a volatile reader what it wrote before they matched.
                first = heartbeat.last + 1
            proxy.expected = min([first, *proxy.held])
        if heartbeat.first > proxy.expected:
            before = proxy.expected
            proxy.lost -= self._advance(proxy, heartbeat.first)
            proxy.lost += proxy.expected - before
        self._deliver_held(proxy)
        if not heartbeat.final or self._lacks(proxy):
            pause = 0.0
            if proxy.in_vain and proxy.progress == proxy.requested_at:
                pause = min(_PAUSE_LAST, _PAUSE_FIRST * 2 ** min(proxy.in_vain, 10))
            proxy.ack_at = now + pause if pending is None else min(pending, now + pause)
        if proxy.ack_at != ack_before:
            self.on_change(self)
        return True

    def on_gap(self, writer: bytes, gap: Gap) -> None:
        """Handle GAP of a matched reliable writer."""
        proxy = self.writers.get(writer)
        if proxy is None or not proxy.reliable:
            return
        proxy.highest = max(proxy.highest, gap.base - 1, *gap.irrelevant)
        start = gap.start
        if proxy.expected is not None and start <= proxy.expected:
            self._advance(proxy, gap.base)
            start = proxy.expected
        for number in (*range(start, min(gap.base, start + _MAX_NOTED)), *gap.irrelevant):
            self._pass_over(proxy, number)
        self._deliver_held(proxy)

    def on_heartbeat_frag(self, writer: bytes, heartbeat: HeartbeatFrag, now: float) -> None:
        """Handle HEARTBEAT_FRAG: ask for the fragments that should have come."""
        proxy = self.writers.get(writer)
        if proxy is None or not proxy.reliable:
            return
        incomplete = proxy.incomplete.get(heartbeat.number)
        if incomplete is not None:
            incomplete.highest = max(incomplete.highest, min(heartbeat.last, incomplete.last))
            proxy.ack_at = now
            self.on_change(self)

    def _is_wanted(self, proxy: WriterProxy, number: int) -> bool:
        if proxy.expected is None:
            return len(proxy.held) < MAX_AHEAD
        if number < proxy.expected:
            return False
        return not proxy.reliable or number < proxy.expected + MAX_AHEAD

    def _accept(self, proxy: WriterProxy, sample: Sample) -> None:
        number = sample.number
        proxy.highest = max(proxy.highest, number)
        if not proxy.reliable:
            if proxy.expected is not None:
                proxy.lost += number - proxy.expected
            proxy.expected = number + 1
            if proxy.incomplete:
                for old in [number for number in proxy.incomplete if number <= sample.number]:
                    proxy.incomplete.pop(old).close()
            if not self._deliver(sample):
                proxy.lost += 1
            return
        if number == proxy.expected:
            if self._deliver(sample):
                proxy.progress += 1
                proxy.expected = number + 1
                if proxy.held:
                    self._deliver_held(proxy)
            return
        if number in proxy.held:
            return
        octets = _OVERHEAD + (len(sample.payload) if sample.payload is not None else 0)
        if self._budget.take(octets, proxy.participant):
            proxy.progress += 1
            proxy.held_octets += octets
            proxy.held[number] = sample
            if self._on_early is not None:
                self._on_early(sample)

    def _pass_over(self, proxy: WriterProxy, number: int) -> None:
        """Note that a number is not for this reader."""
        if not self._is_wanted(proxy, number) or number in proxy.held:
            return
        if not self._budget.take(_OVERHEAD, proxy.participant):
            return
        proxy.progress += 1
        proxy.held_octets += _OVERHEAD
        proxy.held[number] = None
        incomplete = proxy.incomplete.pop(number, None)
        if incomplete is not None:
            incomplete.close()

    def _advance(self, proxy: WriterProxy, to: int) -> int:
        """Deliver what is held below ``to``, and pass over the rest of it; how many were held."""
        assert proxy.expected is not None
        count = 0
        # Attack: many small steps, each of which would search all that is held.
        steps = range(proxy.expected, to)
        if len(steps) < len(proxy.held):
            held = [number for number in steps if number in proxy.held]
        else:
            held = sorted(number for number in proxy.held if number < to)
        for number in held:
            sample = proxy.held[number]
            if sample is not None and not self._deliver(sample):
                to = number  # it is asked for again, if the writer still has it
                break
            self._release(proxy, number)
            count += 1
        for number in [number for number in proxy.incomplete if number < to]:
            proxy.incomplete.pop(number).close()
        proxy.progress += to > proxy.expected
        proxy.expected = max(proxy.expected, to)
        return count

    def _release(self, proxy: WriterProxy, number: int) -> None:
        sample = proxy.held.pop(number)
        octets = _OVERHEAD
        if sample is not None and sample.payload is not None:
            octets += len(sample.payload)
        proxy.held_octets -= octets
        self._budget.give_back(octets, proxy.participant)

    def _deliver_held(self, proxy: WriterProxy) -> None:
        """Deliver what is held and now in order."""
        while proxy.expected is not None and proxy.expected in proxy.held:
            sample = proxy.held[proxy.expected]
            if sample is not None and not self._deliver(sample):
                return
            self._release(proxy, proxy.expected)
            proxy.expected += 1

    def resume(self, now: float) -> None:
        """Deliver what had no room before, and ask for the rest; the caller has made room."""
        self.on_change(self)
        for proxy in self.writers.values():
            if proxy.reliable and proxy.expected is not None:
                self._deliver_held(proxy)
                if self._lacks(proxy):
                    proxy.in_vain = 0
                    proxy.ack_at = now

    # --- what it sends -----------------------------------------------------------------------

    def _lacks(self, proxy: WriterProxy) -> bool:
        return proxy.expected is not None and proxy.expected <= proxy.highest

    def next_deadline(self) -> float | None:
        """Return when :meth:`poll` has something to send, or None."""
        deadline = None
        for proxy in self.writers.values():
            for at in (proxy.ack_at, proxy.retry_at):
                if at is not None and (deadline is None or at < deadline):
                    deadline = at
        return deadline

    def poll(self, now: float) -> Iterator[tuple[bytes, bytes]]:
        """Yield (GUID of the writer, submessages) of the acknowledgements that are due."""
        for proxy in list(self.writers.values()):
            is_due = proxy.ack_at is not None and proxy.ack_at <= now
            if proxy.retry_at is not None and proxy.retry_at <= now:
                proxy.retry_at = None
                is_due |= self._lacks(proxy)
            if is_due:
                yield proxy.guid, self._answer(proxy, now)

    def _answer(self, proxy: WriterProxy, now: float) -> bytes:
        entity = proxy.guid[ids.PREFIX_SIZE :]
        if proxy.heartbeat_counter is None:
            # Nothing is known of the writer: an empty acknowledgement that asks for a heartbeat.
            # Fast DDS answers one of base 0, which others do not accept.
            base = 0 if proxy.guid.startswith(FAST_DDS) else proxy.expected or 1
            proxy.ack_at = None
            if proxy.held and proxy.asked >= _MAX_UNANSWERED and proxy.expected is None:
                proxy.expected = min(proxy.held)
                self._deliver_held(proxy)
            proxy.ack_at = now + min(_ASK_LAST, _ASK_FIRST * 2 ** min(proxy.asked, 10))
            proxy.asked += 1
            return self._acknack(proxy, entity, base, [], False)
        proxy.ack_at = None
        assert proxy.expected is not None
        base = proxy.expected
        stop = min(proxy.highest, base + MAX_BITS - 1)
        missing, fragments = [], b""
        for number in range(base, stop + 1):
            if number in proxy.held:
                continue
            incomplete = proxy.incomplete.get(number)
            if incomplete is None:
                missing.append(number)
                continue
            # While fragments arrive, those behind the highest may be on their way.
            lacking = incomplete.missing(
                incomplete.highest if incomplete.has_progressed else incomplete.last
            )
            incomplete.has_progressed = False
            if lacking:
                self._counter += 1
                fragments += encode_nack_frag(
                    self._entity, entity, number, lacking, self._counter & 0x7FFF_FFFF
                )
        if missing or fragments:
            proxy.in_vain = proxy.in_vain + 1 if proxy.progress == proxy.requested_at else 0
            proxy.requested_at = proxy.progress
            pause = _RETRY_FIRST * 2 ** min(proxy.in_vain, 10)
            proxy.retry_at = now + min(_RETRY_LAST, pause)
        return self._acknack(proxy, entity, base, missing, not missing) + fragments

    def _acknack(
        self, proxy: WriterProxy, entity: bytes, base: int, missing: list[int], final: bool
    ) -> bytes:
        self._counter += 1
        counter = self._counter & 0x7FFF_FFFF
        return encode_acknack(self._entity, entity, base, missing, counter, final)
