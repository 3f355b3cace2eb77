"""Faults between RTPS participants: rough links, restarts, pauses, clocks that jump."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.rtps_network import (
    BEST_EFFORT,
    GROUP,
    LATCHED,
    Inbox,
    Network,
    Stranger,
    announcement,
    cdr,
    is_acknowledged,
    prefix,
    writer_of,
)

from uros.middleware.rtps import ids, submessages
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import ParticipantData
from uros.qos import HistoryPolicy, QoSProfile

KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
PEERS = ("10.0.0.1", "10.0.0.2")


class RoughNetwork(Network):
    """Loses, doubles and delays datagrams at these rates; ``stopped`` members get no turn."""

    def __init__(self, seed=0, loss=0.0, doubling=0.0, delay=0.0):
        super().__init__(loss, seed)
        self.doubling, self.delay = doubling, delay
        self.late = []  # (when, source, address, datagram)
        self.stopped = set()
        self.queued = {}  # what waits in the sockets of those that are stopped

    def carry(self):
        for _ in range(100):
            sent = []
            for address, member in self.members.items():
                if address not in self.stopped:
                    member.poll(self.now)
                    sent += [(address, *item) for item in member.take_datagrams()]
            self.log += sent
            due = [item for item in self.late if item[0] <= self.now]
            self.late = [item for item in self.late if item[0] > self.now]
            for source, datagram, place in sent:
                for address in self.members:
                    if place not in (GROUP, Locator(UDPV4, 7410, address)):
                        continue
                    for _ in range(1 + (self.random.random() < self.doubling)):
                        if self.random.random() < self.loss:
                            continue
                        wait = 0.0
                        if self.random.random() < self.delay:
                            wait = self.random.uniform(0.001, 0.3)
                        due.append((self.now + wait, source, address, datagram))
            if not due:
                return
            if self.delay:
                self.random.shuffle(due)
            for when, source, address, datagram in due:
                if when > self.now:
                    self.late.append((when, source, address, datagram))
                elif address in self.stopped:
                    waiting = self.queued.setdefault(address, [])
                    if len(waiting) < 300:  # a socket's buffer
                        waiting.append((source, datagram))
                elif address in self.members:
                    self.members[address].receive(memoryview(datagram), source, self.now)
        raise AssertionError("they do not stop talking")

    def stop(self, address, seconds):
        """A participant gets no turn for some time, as after SIGSTOP."""
        self.stopped.add(address)
        self.step(0.25, int(seconds * 4))
        self.stopped.discard(address)
        member = self.members[address]
        for source, datagram in self.queued.pop(address, []):
            member.receive(memoryview(datagram), source, self.now)


def matched_pair(network, qos=None, by_multicast=True):
    peers = () if by_multicast else PEERS
    one, two = network.add(1, peers=peers), network.add(2, peers=peers)
    sender, inbox = writer_of(network, one, qos=qos), Inbox(network, two, qos=qos)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    network.step(0.1, 20)
    return sender, inbox


def exchange(network, sender, inbox, first, count=5):
    """Write samples and wait for them; those before the reader has matched may be lost."""
    end = len(inbox.samples)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    network.step(0.1, 30)
    for number in range(first, first + count):
        sender.write(cdr(number), 0, network.now)
        network.step()
    network.until(lambda: cdr(first + count - 1) in inbox.samples[end:])
    assert inbox.samples[-count:] == [cdr(number) for number in range(first, first + count)]


# --- the link -------------------------------------------------------------------------------------


@given(
    st.integers(0, 10**6),
    st.tuples(*[st.sampled_from([0.0, 0.3])] * 3),
    st.lists(st.sampled_from([0, 100, 1400, 9000]), min_size=1, max_size=15),
)
def test_samples_arrive_once_and_in_order_both_ways(seed, rates, sizes):
    network = RoughNetwork(seed, *rates)
    one, two = network.add(1), network.add(2)
    senders = [
        writer_of(network, one, qos=KEEP_ALL),
        writer_of(network, two, "rt/back", qos=KEEP_ALL),
    ]
    inboxes = [Inbox(network, two, qos=KEEP_ALL), Inbox(network, one, "rt/back", qos=KEEP_ALL)]
    network.until(lambda: all(sender.matched() for sender in senders), 3000)
    network.until(lambda: all(inbox.reader.state.writers for inbox in inboxes), 3000)
    for number, size in enumerate(sizes):
        for sender in senders:
            assert sender.write(cdr(number, size), 0, network.now)
        if network.random.random() < 0.5:
            network.step()
    network.until(lambda: all(len(inbox.samples) >= len(sizes) for inbox in inboxes), 3000)
    network.step(0.1, 30)
    for inbox in inboxes:
        assert inbox.samples == [cdr(number, size) for number, size in enumerate(sizes)]
    network.until(lambda: all(is_acknowledged(sender.state) for sender in senders), 3000)
    assert one._budget.used == two._budget.used == 0


@given(st.integers(0, 10**6))
def test_transient_local_samples_arrive_on_a_link_that_loses_doubles_and_delays(seed):
    network = RoughNetwork(seed, 0.3, 0.3, 0.3)
    one, two = network.add(1), network.add(2)
    sender = writer_of(network, one, qos=LATCHED)
    for number in range(5):
        sender.write(cdr(number), 0, network.now)
    inbox = Inbox(network, two, qos=LATCHED)
    network.until(lambda: len(inbox.samples) >= 3, 3000)
    assert inbox.samples == [cdr(2), cdr(3), cdr(4)]


@given(st.integers(0, 10**6))
def test_best_effort_samples_are_whole_and_newer_each_time(seed):
    network = RoughNetwork(seed, 0.3, 0.3, 0.3)
    one, two = network.add(1), network.add(2)
    sender = writer_of(network, one, qos=BEST_EFFORT)
    inbox = Inbox(network, two, qos=BEST_EFFORT)
    network.until(lambda: sender.matched() and inbox.reader.state.writers, 3000)
    sizes = [random.Random(seed + number).choice((0, 100, 3000)) for number in range(30)]
    for number, size in enumerate(sizes):
        sender.write(cdr(number, size), 0, network.now)
        network.step(0.02)
    network.step(0.1, 10)
    found = [int.from_bytes(sample[4:8], "little") for sample in inbox.samples]
    assert found == sorted(set(found))
    assert inbox.samples == [cdr(number, sizes[number]) for number in found]


def test_numbers_go_beyond_32_bits_between_participants():
    network = RoughNetwork(3, 0.2, 0.2, 0.2)
    one, two = network.add(1), network.add(2)
    sender = writer_of(network, one, qos=KEEP_ALL)
    sender.state.last = 2**32 - 6
    inbox = Inbox(network, two, qos=KEEP_ALL)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    for number in range(12):
        sender.write(cdr(number, 3000 * (number % 2)), 0, network.now)
    network.until(lambda: len(inbox.samples) == 12, 2000)
    assert inbox.samples == [cdr(number, 3000 * (number % 2)) for number in range(12)]
    assert sender.state.last == 2**32 + 6


# --- restarts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_same", [False, True], ids=["new GUID", "same GUID"])
@pytest.mark.parametrize(
    "qos", [KEEP_ALL, BEST_EFFORT, LATCHED], ids=["all", "best effort", "latched"]
)
def test_a_participant_that_is_killed_and_comes_back_is_heard_again(is_same, qos):
    """Under its old GUID all its numbers begin anew, before its lease has ended."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, qos)
    exchange(network, sender, inbox, 0, 3)
    back = writer_of(network, network.members["10.0.0.2"], "rt/back", qos=qos)
    back_inbox = Inbox(network, network.members["10.0.0.1"], "rt/back", qos=qos)
    exchange(network, back, back_inbox, 0, 3)
    for number in range(20):
        back.write(cdr(number), 0, network.now)
        network.step()
    del network.members["10.0.0.2"]
    network.step(0.2, 10)
    again = network.add(2 if is_same else 7, address="10.0.0.2")
    fresh = Inbox(network, again, qos=qos)
    back = writer_of(network, again, "rt/back", qos=qos)
    network.step(0.1, 100)
    exchange(network, sender, fresh, 100)
    back_inbox.samples.clear()
    exchange(network, back, back_inbox, 200)


@pytest.mark.parametrize(("times", "seed"), [(1, 2), (3, 2), (3, 4), (3, 5)])
def test_a_participant_that_comes_back_under_its_guid_again_and_again(times, seed):
    network = RoughNetwork(seed, 0.1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    for count in range(times):
        exchange(network, sender, inbox, count * 10)
        del network.members["10.0.0.2"]
        again = network.add(2, address="10.0.0.2")
        inbox = Inbox(network, again, qos=KEEP_ALL)
        network.step(0.1, 60)
    exchange(network, sender, inbox, 1000)


@pytest.mark.parametrize("by_multicast", [True, False], ids=["multicast", "peers"])
@pytest.mark.parametrize("killed", PEERS, ids=["writer", "reader"])
def test_the_lease_of_one_that_was_killed_does_not_end_its_successor(killed, by_multicast):
    """A process that is started again mostly has the ports of the one before."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL, by_multicast)
    exchange(network, sender, inbox, 0)
    del network.members[killed]
    again = network.add(7, address=killed, peers=() if by_multicast else PEERS)
    if killed == PEERS[0]:
        sender = writer_of(network, again, qos=KEEP_ALL)
    else:
        inbox = Inbox(network, again, qos=KEEP_ALL)
    exchange(network, sender, inbox, 100)
    for number in range(200, 300):  # for 30 s; the lease ends after 20 s
        sender.write(cdr(number), 0, network.now)
        network.step(0.3)
    assert inbox.samples[-100:] == [cdr(number) for number in range(200, 300)]


@pytest.mark.parametrize("by_multicast", [True, False], ids=["multicast", "peers"])
def test_a_peer_that_had_forgotten_us_gets_our_endpoints_again(by_multicast):
    """Its lease of us has ended while ours of it has not: its counters begin anew, ours do not."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL, by_multicast)
    one, two = network.members["10.0.0.1"], network.members["10.0.0.2"]
    exchange(network, sender, inbox, 0)
    back = writer_of(network, two, "rt/back", qos=KEEP_ALL)
    back_inbox = Inbox(network, one, "rt/back", qos=KEEP_ALL)
    exchange(network, back, back_inbox, 0)
    two._forget(two.remotes[prefix(1)])
    network.step(0.1, 80 if by_multicast else 200)
    assert len(two.remotes[prefix(1)].endpoints) == 2
    exchange(network, sender, inbox, 100)
    exchange(network, back, back_inbox, 200)


def test_two_participants_with_one_guid_do_not_harm_the_one_that_came_first():
    """Another address announces the GUID of our peer, and sends data in its name."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    one, two = network.members["10.0.0.1"], network.members["10.0.0.2"]
    twin = network.add(2, address="10.0.0.66")
    writer_of(network, twin, "rt/other", qos=KEEP_ALL)
    Inbox(network, twin, qos=KEEP_ALL)
    network.step(0.1, 50)
    assert one.remotes[prefix(2)].heard == {"10.0.0.2": None}
    exchange(network, sender, inbox, 0)
    assert two.remotes.keys() == {prefix(1)}
    # When the first one is gone, the other one has its place.
    two.close()
    network.carry()
    del network.members["10.0.0.2"]
    network.step(0.1, 50)
    assert one.remotes[prefix(2)].heard == {"10.0.0.66": None}


def test_our_guid_at_another_address_does_not_end_our_participant():
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    twin = network.add(1, address="10.0.0.66")
    writer_of(network, twin, qos=KEEP_ALL)
    network.step(0.1, 50)
    exchange(network, sender, inbox, 0)
    twin.close()
    network.carry()
    exchange(network, sender, inbox, 10)
    data = ParticipantData(network.members["10.0.0.1"].guid, domain=0)
    network.inject("10.0.0.66", announcement(data), network.members["10.0.0.1"])
    assert network.members["10.0.0.1"].remotes.keys() == {prefix(2)}


# --- pauses and clocks ----------------------------------------------------------------------------


@pytest.mark.parametrize("address", ["10.0.0.1", "10.0.0.2"], ids=["writer", "reader"])
@pytest.mark.parametrize("seconds", [5, 15, 25, 60])
def test_a_participant_that_was_stopped_goes_on(address, seconds):
    """SIGSTOP and SIGCONT, for less and for more than the leases of both."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    exchange(network, sender, inbox, 0)
    network.stop(address, seconds)
    network.step(0.1, 100)
    exchange(network, sender, inbox, 100)


def test_nothing_is_lost_while_a_reader_is_stopped_for_less_than_its_lease():
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    network.stopped.add("10.0.0.2")
    for number in range(50):
        assert sender.write(cdr(number, 2000), 0, network.now)
        network.step(0.2)
    network.stopped.clear()
    network.until(lambda: len(inbox.samples) == 50)
    assert inbox.samples == [cdr(number, 2000) for number in range(50)]


def test_after_a_pause_of_ours_the_announcements_that_wait_are_read_before_leases_end():
    network = RoughNetwork(1)
    sender, _ = matched_pair(network)
    one = network.members["10.0.0.1"]
    network.stopped.add("10.0.0.1")
    network.step(1.0, 30)
    one.poll(network.now)  # the turn by time comes before that of the sockets
    assert one.remotes and sender.matched()
    network.stopped.clear()
    network.queued.clear()
    del network.members["10.0.0.2"]
    network.step(0.5, 10)
    assert not one.remotes


@pytest.mark.parametrize("gap", [30.0, 3600.0, 1e6, 1e9])
def test_the_monotonic_clock_may_jump(gap):
    """A machine that was suspended, where the clock counts that."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    network.now += gap
    network.step(0.1, 100)
    exchange(network, sender, inbox, 0)
    network.carry()
    deadline = network.members["10.0.0.1"].next_deadline()
    assert network.now < deadline < network.now + 10


@pytest.mark.parametrize(
    "wall_s", [0, -1, -(2**31), 2**31 - 1, 2**31, 4_102_444_800, 2**32, 10**12]
)
def test_the_wall_clock_may_show_any_time(wall_s):
    """Stamps beyond 2038 and before 1970 arrive, or come round; samples arrive anyway."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    for number, ns in enumerate((0, 1, 999_999_999)):
        sender.write(cdr(number), wall_s * 1_000_000_000 + ns, network.now)
        network.step()
    assert inbox.samples == [cdr(0), cdr(1), cdr(2)]
    stamps = [
        part.time_ns
        for _, datagram, _ in network.log
        for part in submessages.read(memoryview(datagram))
        if isinstance(part, submessages.InfoTimestamp)
    ]
    assert wall_s % 2**32 in {None if ns is None else ns // 1_000_000_000 for ns in stamps}


def test_the_wall_clock_may_jump_between_samples():
    network = RoughNetwork(1, 0.2)
    sender, inbox = matched_pair(network, KEEP_ALL)
    for number, wall_s in enumerate((10**9, 5, 2 * 10**9, -(10**9), 10**10)):
        sender.write(cdr(number), wall_s * 10**9, network.now)
        network.step()
    network.until(lambda: len(inbox.samples) == 5)
    assert inbox.samples == [cdr(number) for number in range(5)]


def test_stamps_that_are_not_known_are_told_as_such():
    head = submessages.header(ids.NO_PREFIX)
    for encoded in (submessages.encode_info_ts(None), b"\x09\1\x08\0" + b"\xff" * 8):
        (part,) = submessages.read(memoryview(head + encoded))
        assert part.time_ns is None


def test_a_request_that_is_not_answered_is_repeated_without_a_heartbeat():
    """Fast DDS repeats its heartbeats after 3 s only, and the answer may be lost again."""
    network = RoughNetwork(1)
    sender, inbox = matched_pair(network, KEEP_ALL)
    one, two = network.members["10.0.0.1"], network.members["10.0.0.2"]
    state = inbox.reader.state
    (proxy,) = state.writers.values()
    del network.members["10.0.0.1"]  # nothing answers
    beat = submessages.encode_heartbeat(bytes(4), sender.data.guid[12:], 1, 1, 1000)
    head = submessages.header(prefix(1))
    network.inject("10.0.0.1", head + beat, two)
    network.log.clear()
    network.step(0.02, 250)

    def requests():
        return [
            part
            for _, datagram, _ in network.log
            for part in submessages.read(memoryview(datagram))
            if isinstance(part, submessages.AckNack)
        ]

    assert {part.missing for part in requests()} == {(1,)}
    assert 5 <= len(requests()) <= 8  # in 5 s: after 0.1, 0.2, 0.4 … 2 s
    assert len({part.counter for part in requests()}) == len(requests())
    network.inject("10.0.0.1", head + submessages.encode_data(
        bytes(4), sender.data.guid[12:], 1, cdr(1)
    ), two)  # fmt: skip
    network.log.clear()
    network.step(0.02, 150)
    assert inbox.samples == [cdr(1)] and proxy.retry_at is None
    assert not requests()
    assert one.remotes


@pytest.mark.parametrize("times", [1, 2])
def test_a_last_number_that_falls_is_no_restart(times):
    """Fast DDS forgets the announcement and the farewell of an endpoint, if they are the last."""
    network = RoughNetwork(1)
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce()
    before = one.remotes[stranger.prefix]
    for counter, last in enumerate((10, 8, 8, 8), 1):
        heartbeat = submessages.encode_heartbeat(
            bytes(4), ids.PUBLICATIONS_WRITER, 1, last, counter
        )
        for _ in range(times):  # to each of our addresses
            stranger.send(submessages.encode_info_dst(prefix(1)), heartbeat)
        stranger.send(
            submessages.encode_gap(bytes(4), ids.PUBLICATIONS_WRITER, 1, last + 1, []),
        )
        network.step(1.5)
    assert one.remotes[stranger.prefix] is before


def test_a_best_effort_writer_that_begins_anew_is_noticed_by_its_numbers():
    """Its participant came back under its GUID, with as many announcements as before."""
    network = RoughNetwork(1)
    one = network.add(1)
    inbox = Inbox(network, one, qos=BEST_EFFORT)
    stranger = Stranger(network, one)
    stranger.announce()
    entity = stranger.endpoint("rt/chatter", True)[12:]
    before = one.remotes[stranger.prefix]

    def send(number):
        stranger.send(submessages.encode_data(bytes(4), entity, number, cdr(number)))

    for number in (20, 21, 21, 5):
        send(number)
    network.now += 1.5
    send(22)  # a datagram came late, that was all
    send(1)
    network.now += 0.5
    send(2)
    assert one.remotes[stranger.prefix] is before
    network.now += 0.6
    send(3)
    assert one.remotes[stranger.prefix] is not before
    stranger.count = 0
    stranger.endpoint("rt/chatter", True, guid=stranger.prefix + entity)
    send(4)
    assert inbox.samples == [cdr(20), cdr(21), cdr(22), cdr(4)]


def test_a_participant_whose_lease_has_ended_is_told_so():
    """It may go on later: Fast DDS sends nothing again that was acknowledged before."""
    network = RoughNetwork(1)
    matched_pair(network)
    one, two = network.members["10.0.0.1"], network.members["10.0.0.2"]
    events = []
    two.on_participant = lambda data, is_there: events.append((data.guid, is_there))
    network.stopped.add("10.0.0.2")
    network.until(lambda: not one.remotes)
    network.carry()
    network.stopped.clear()
    for source, datagram in network.queued.pop("10.0.0.2"):
        two.receive(memoryview(datagram), source, network.now)
    assert (one.guid, False) in events
    network.until(lambda: one.remotes and two.remotes)


def test_a_participant_that_has_proven_nothing_is_not_told_that_its_lease_has_ended():
    network = RoughNetwork(1)
    one = network.add(1)
    Stranger(network, one).announce(lease_ms=1000)
    network.step(0.1, 5)
    network.log.clear()
    network.until(lambda: not one.remotes)
    network.carry()
    assert not any(
        isinstance(part, submessages.Data)
        for datagram in network.sent("10.0.0.1")
        for part in submessages.read(memoryview(datagram))
    )
