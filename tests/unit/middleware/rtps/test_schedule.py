"""A schedule of many items does what a walk over all of them would do."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rtps_network import BEST_EFFORT, LATCHED, Network, cdr, writer_of

from uros.middleware.rtps import participant
from uros.middleware.rtps.remote import RemoteParticipant
from uros.middleware.rtps.schedule import Schedule
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

TIMES = st.one_of(st.none(), st.integers(0, 20).map(float))


class Item:
    """Something with a deadline."""

    def __init__(self):
        self.at = None
        self.asked = 0

    def next_deadline(self):
        self.asked += 1
        return self.at


@given(
    st.lists(
        st.tuples(st.sampled_from(["set", "remove", "ask", "take"]), st.integers(0, 5), TIMES),
        max_size=60,
    )
)
def test_what_is_due_and_when_is_that_of_a_walk(operations):
    schedule, items, known = Schedule(), [Item() for _ in range(6)], set()
    for operation, index, at in operations:
        item = items[index]
        if operation == "set":
            item.at = at
            schedule.touch(item)
            known.add(item)
        elif operation == "remove":
            schedule.remove(item)
            known.discard(item)
        deadlines = [item.at for item in known if item.at is not None]
        if operation == "ask":
            assert schedule.next_deadline() == min(deadlines, default=None)
        elif operation == "take":
            now = 0.0 if at is None else at
            due = schedule.take_due(now)
            assert [item.at for item in due] == sorted(
                due_at for due_at in deadlines if due_at <= now
            )
            assert len(set(due)) == len(due)
            for item in due:
                item.at = None if index % 2 else now + index
    assert schedule.next_deadline() == min(
        (item.at for item in known if item.at is not None), default=None
    )


def test_only_what_has_changed_is_asked():
    schedule, items = Schedule(), [Item() for _ in range(1000)]
    for item in items:
        schedule.touch(item)
        schedule.touch(item)
    for _ in range(3):
        assert schedule.next_deadline() is None and not schedule.take_due(5.0)
    assert all(item.asked == 1 for item in items)
    items[7].at = 3.0
    schedule.touch(items[7])
    assert schedule.next_deadline() == 3.0 and schedule.take_due(3.0) == [items[7]]
    assert sum(item.asked for item in items) == 1001


def test_deadlines_that_move_often_leave_nothing_behind():
    """A lease is renewed by each datagram, for ten minutes perhaps."""
    schedule, items, first = Schedule(), [Item() for _ in range(10)], Item()
    first.at = 1.0
    schedule.touch(first)
    for turn in range(10_000):
        for item in items:
            item.at = 600.0 + turn
            schedule.touch(item)
        assert schedule.next_deadline() == 1.0
    assert len(schedule._heap) < 200


# --- of a participant -----------------------------------------------------------------------------


class Checked(Schedule):
    """Compares each answer with a walk over all that was ever scheduled.

    A lease that is extended is looked at when it would have ended before.
    """

    def __init__(self):
        super().__init__()
        self._items = {}

    def touch(self, item):
        super().touch(item)
        self._items[item] = None

    def remove(self, item):
        super().remove(item)
        self._items.pop(item, None)

    def _deadlines(self):
        found = {item: item.next_deadline() for item in self._items}
        for item in found:
            if isinstance(item, RemoteParticipant) and item not in self.touched:
                assert self._due[item] <= found[item]
                found[item] = self._due[item]
        return {item: at for item, at in found.items() if at is not None}

    def next_deadline(self):
        expected = min(self._deadlines().values(), default=None)
        assert super().next_deadline() == expected
        return expected

    def take_due(self, now):
        expected = {item for item, at in self._deadlines().items() if at <= now}
        due = super().take_due(now)
        assert len(due) == len(expected) and set(due) == expected
        for item in self._items.keys() - expected:
            if not isinstance(item, RemoteParticipant):
                assert not list(item.poll(now)), "work that is not due"
        return due


PROFILES = [
    QoSProfile(),
    BEST_EFFORT,
    LATCHED,
    QoSProfile(history=HistoryPolicy.KEEP_ALL),
    QoSProfile(lifespan_ms=300, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(liveliness_lease_ms=500),
]


class Story:
    """Three participants, and what happens to them."""

    def __init__(self):
        self.network = Network()
        self.participants = [self.network.add(number) for number in (1, 2, 3)]
        self.writers, self.readers = [], []
        self.samples, self.room = [], 5

    def deliver(self, sample):
        if len(self.samples) >= self.room:
            return False
        self.samples.append((sample.writer, sample.number))
        return True

    def do(self, operation, first, second):
        network, member = self.network, self.participants[first % 3]
        topic, qos = f"rt/{second % 2}", PROFILES[second % len(PROFILES)]
        if operation == "writer":
            self.writers.append((member, writer_of(network, member, topic=topic, qos=qos)))
        elif operation == "reader":
            reader = member.create_reader(topic, TYPE, qos, self.deliver, network.now, 0)
            self.readers.append((member, reader))
        elif operation == "write" and self.writers:
            self.writers[second % len(self.writers)][1].write(cdr(first), 0, network.now)
        elif operation == "large" and self.writers:
            self.writers[second % len(self.writers)][1].write(cdr(1, 5000), 0, network.now)
        elif operation == "delete":
            owners = self.writers if first % 2 else self.readers
            if owners:
                owner, endpoint = owners.pop(second % len(owners))
                owner.delete(endpoint, network.now, 0)
        elif operation == "take":
            self.room = len(self.samples) + 5
            for _, reader in self.readers:
                reader.state.resume(network.now)
        elif operation == "silence":
            network.loss = float(first % 2)
        elif operation == "close":
            member.close()
        self.turn((0.0, 0.01, 0.1, 0.7, 3.0, 25.0)[second % 6])

    def turn(self, pause):
        self.network.carry()
        for member in self.participants:
            member.next_deadline()
        self.network.now += pause


TYPE = "std_msgs::msg::dds_::String_"
OPERATIONS = ["writer", "reader", "write", "large", "delete", "take", "silence", "time", "close"]


@settings(deadline=None, max_examples=100)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(OPERATIONS[:-1] * 3 + ["close"]), st.integers(0, 5), st.integers(0, 11)
        ),
        max_size=30,
    )
)
def test_a_participant_does_at_each_time_what_a_walk_finds(operations):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(participant, "EndpointSchedule", Checked)
        story = Story()
    for operation in operations:
        story.do(*operation)
    for _ in range(10):
        story.turn(0.3)


def test_a_writer_without_its_reader_and_without_samples_is_due_no_more():
    network = Network()
    qos = QoSProfile(lifespan_ms=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    state = writer_of(network, network.add(1), qos=qos).state
    schedule = Schedule()
    state.on_change = schedule.touch
    state.match(bytes(16), True, False, 0.0)
    state.write(cdr(1), 0, 0.0)
    for unmatch in (state.unmatch, lambda guid: state.unmatch_participant(guid[:12])):
        assert schedule.next_deadline() < 1.0
        unmatch(bytes(16))
        assert schedule.next_deadline() == 1.0
        state.match(bytes(16), True, True, 0.0)
    state.unmatch(bytes(16))
    assert not state.history(1.0)
    assert schedule.next_deadline() is None
