"""The Gid size: set by ROS_DISTRO, or as other ROS participants in the domain have it."""

import select
import time

import pytest

from uros.middleware import user_data
from uros.middleware.dds import cyclone
from uros.middleware.dds.discovery import ParticipantDiscovery
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.discovery_info import codec
from uros.middleware.discovery_info.codec import decode
from uros.middleware.discovery_info.gid_size import configured_gid_size
from uros.qos import HistoryPolicy

SECONDS = 10
NODE = codec.NodeEntities("/", "peer", [], [bytes(range(16))])


class OtherParticipant:
    """A ROS participant that is not ours; it announces a node with Gids of ``size`` bytes."""

    def __init__(self, domain, size, user_data=b"enclave=/;"):
        self.entity = cyclone.create_participant(domain, user_data)
        self.guid = cyclone.guid(self.entity)
        topic = cyclone.create_topic(self.entity, codec.TOPIC, codec.TYPE)
        publisher = cyclone.create_group("publisher", self.entity)
        self._writer = cyclone.create_writer(publisher, topic, codec.qos(), b"")
        self.write(codec.encode(self.guid, [NODE], size))

    def write(self, sample):
        assert cyclone.write(self._writer, sample)

    def leave(self):
        cyclone.delete(self.entity)


class Ours:
    """A middleware with a node in the domain, what it announces, and its notices."""

    def __init__(self, domain):
        self.notices = []
        self.middleware = DdsMiddleware()
        self.middleware.on_notice = self.notices.append
        self.node = self.middleware.create_node(domain, "/garden", "weather")
        qos = codec.qos()
        qos.history = HistoryPolicy.KEEP_ALL
        # Reads what goes out, as another would.
        self._participant = cyclone.create_participant(domain, b"")
        topic = cyclone.create_topic(self._participant, codec.TOPIC, codec.TYPE)
        subscriber = cyclone.create_group("subscriber", self._participant)
        self._reader = cyclone.create_reader(subscriber, topic, qos)
        self.announced = None  # the size in the last announcement

    def turn(self, seconds):
        """Serve the middleware until something happened, or nothing did for so long."""
        due = self.middleware.next_deadline()
        if due is not None:
            seconds = min(seconds, max(0.0, due - time.monotonic()))
        if select.select([self.middleware.fileno()], [], [], seconds)[0]:
            self.middleware.dispatch()
        self.middleware.tick()
        for sample, _ in cyclone.take(self._reader, 1000):
            decoded = decode(sample)
            if decoded is not None and decoded[0] == self.node.participant.guid:
                self.announced = decoded[2]

    def until(self, done):
        end = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < end, (self.announced, self.notices)
            self.turn(0.1)

    def announces(self, size):
        self.until(lambda: self.announced == size)

    def settle(self, other):
        """Wait until the other's message has been read."""
        peers = self.middleware._domains[self.node.participant.domain]._peers
        self.until(lambda: other.guid in peers.gid_sizes and other.guid in peers.participants)


@pytest.fixture
def ours(own_domain_id):
    one = Ours(own_domain_id)
    yield one
    one.middleware.close()


@pytest.fixture
def distro(monkeypatch):
    return lambda name: monkeypatch.setenv("ROS_DISTRO", name)


def test_sixteen_bytes_as_long_as_nobody_says_otherwise(ours, own_domain_id):
    ours.announces(16)
    ours.settle(OtherParticipant(own_domain_id, 16))
    assert ours.announced == 16 and ours.notices == []


def test_where_peers_use_twenty_four_so_do_we_and_say_so_once(ours, own_domain_id):
    ours.announces(16)
    others = [OtherParticipant(own_domain_id, 24) for _ in range(2)]
    ours.announces(24)
    for other in others:
        ours.settle(other)
    (line,) = ours.notices
    assert line.startswith(f"domain {own_domain_id}: ") and "24-byte" in line
    assert "ROS_DISTRO" in line
    # A participant that is made later begins so.
    for number in range(50):
        ours.middleware.create_node(own_domain_id, "/", f"node{number}")
    shared = ours.middleware._domains[own_domain_id].participants
    assert [one.gid_size for one in shared] == [24, 24]


def test_when_the_old_ones_left_and_new_ones_came_we_are_new_again(ours, own_domain_id):
    old = OtherParticipant(own_domain_id, 24)
    ours.announces(24)
    old.leave()
    stay = OtherParticipant(own_domain_id, 16)
    ours.settle(stay)
    ours.announces(16)
    assert len(ours.notices) == 2 and "16-byte" in ours.notices[1]


def test_in_a_mixed_domain_the_many_decide_and_the_user_is_told(ours, own_domain_id):
    many = [OtherParticipant(own_domain_id, 16) for _ in range(2)]
    for other in many:
        ours.settle(other)
    few = OtherParticipant(own_domain_id, 24)
    ours.settle(few)
    ours.announces(16)
    (line,) = ours.notices
    assert "before Iron" in line and "24-byte" in line
    for _ in range(2):
        OtherParticipant(own_domain_id, 24)
    ours.announces(24)


@pytest.mark.parametrize(
    "user_data", [user_data.PARTICIPANT, b""], ids=["another agent of ours", "no ROS"]
)
def test_who_proves_nothing_changes_nothing(ours, own_domain_id, user_data):
    other = OtherParticipant(own_domain_id, 24, user_data)
    ours.settle(other)
    ours.announces(16)
    assert ours.notices == []


def test_two_agents_follow_the_others_and_not_each_other(ours, own_domain_id):
    """Else the first to have changed would hold the second, and be held by it."""
    second = Ours(own_domain_id)
    try:
        old = OtherParticipant(own_domain_id, 24)
        both = ours, second
        for one in both:
            one.announces(24)
        old.leave()
        OtherParticipant(own_domain_id, 16)
        for one in both:
            one.announces(16)
    finally:
        second.middleware.close()


@pytest.mark.parametrize(("name", "size", "other"), [("humble", 24, 16), ("jazzy", 16, 24)])
def test_a_distro_that_is_told_decides(distro, own_domain_id, name, size, other):
    distro(name)
    ours = Ours(own_domain_id)
    try:
        ours.announces(size)
        for _ in range(2):
            ours.settle(OtherParticipant(own_domain_id, other))
        assert ours.announced == size
        (line,) = ours.notices
        assert f"{other}: they do not see" in line and "set ROS_DISTRO" in line
    finally:
        ours.middleware.close()


def test_an_unknown_distro_decides_nothing(distro, own_domain_id):
    distro("zebra")
    ours = Ours(own_domain_id)
    try:
        ours.announces(16)
        OtherParticipant(own_domain_id, 24)
        ours.announces(24)
    finally:
        ours.middleware.close()


# --- what peers send ------------------------------------------------------------------------


def test_announcements_do_not_displace_each_other_before_they_are_taken(ours, own_domain_id):
    """The topic has no key: a reader that keeps one sample would keep that of one participant."""
    heard = ParticipantDiscovery(ours.middleware.context, ours.node.participant, lambda: None)
    others = [OtherParticipant(own_domain_id, 16) for _ in range(5)]
    ours.until(lambda: {other.guid for other in others} <= heard.announced.keys())
    heard.close()


def test_nonsense_is_passed_over(ours, own_domain_id):
    heard = ParticipantDiscovery(ours.middleware.context, ours.node.participant, lambda: None)
    other = OtherParticipant(own_domain_id, 16)
    for bad in (b"\xff", b"\xff" * 40, other.guid + b"\1\0\0\0"):
        other.write(b"\0\1\0\0" + bad)
    last = OtherParticipant(own_domain_id, 16)
    ours.until(lambda: last.guid in heard.announced)
    heard.close()


def test_nobody_speaks_for_others(ours, own_domain_id):
    """Attack: a writer says of others that their Gids have 24 bytes."""
    honest = OtherParticipant(own_domain_id, 16)
    ours.settle(honest)
    plain = OtherParticipant(own_domain_id, 16, b"")  # no ROS
    ours.settle(plain)
    for guid in (honest.guid, bytes(range(16)), ours.node.participant.guid):
        plain.write(codec.encode(guid, [NODE], 24))
    plain.write(codec.encode(plain.guid, [], 24))
    peers = ours.middleware._domains[own_domain_id]._peers
    ours.until(lambda: peers.gid_sizes[plain.guid] == 24)
    assert peers.gid_sizes[honest.guid] == 16 and bytes(range(16)) not in peers.gid_sizes
    assert ours.node.participant.gid_size == 16 and ours.notices == []


def test_one_voice_against_one_is_for_sixteen(ours, own_domain_id):
    """Attack: one participant of a ROS of before Iron, in whose time nobody else is there."""
    OtherParticipant(own_domain_id, 24)
    ours.announces(24)
    OtherParticipant(own_domain_id, 16)
    ours.announces(16)


@pytest.mark.parametrize(
    ("distro", "size"),
    [("", None), ("foxy", 24), ("galactic", 24), ("humble", 24), ("iron", 16), ("jazzy", 16),
     ("kilted", 16), ("rolling", 16), ("Humble ", 24), ("zebra", None), ("melodic", None)],
)  # fmt: skip
def test_the_size_of_each_distribution(distro, size):
    """None: not set, and the other participants decide."""
    assert configured_gid_size({"ROS_DISTRO": distro}) == size
    assert configured_gid_size({}) is None
