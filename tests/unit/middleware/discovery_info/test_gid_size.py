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
    """A ROS participant of another process that announces a node with Gids of ``size`` bytes."""

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
        # Reads the announcements, as another participant would.
        self._participant = cyclone.create_participant(domain, b"")
        topic = cyclone.create_topic(self._participant, codec.TOPIC, codec.TYPE)
        subscriber = cyclone.create_group("subscriber", self._participant)
        self._reader = cyclone.create_reader(subscriber, topic, qos)
        self.announced = None  # the size in the last announcement

    def turn(self, seconds):
        """Serve the middleware once, for at most so many seconds."""
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

    def settle(self, participant):
        """Wait until the other's message has been read."""
        peers = self.middleware._domains[self.node.participant.domain]._peers
        self.until(
            lambda: participant.guid in peers.gid_sizes and participant.guid in peers.participants
        )


@pytest.fixture
def ours(own_domain_id):
    own = Ours(own_domain_id)
    yield own
    own.middleware.close()


@pytest.fixture
def distro(monkeypatch):
    return lambda name: monkeypatch.setenv("ROS_DISTRO", name)


def test_gids_have_sixteen_bytes_by_default(ours, own_domain_id):
    ours.announces(16)
    ours.settle(OtherParticipant(own_domain_id, 16))
    assert ours.announced == 16 and ours.notices == []


def test_gids_of_twenty_four_bytes_follow_the_peers_with_one_notice(ours, own_domain_id):
    ours.announces(16)
    participants = [OtherParticipant(own_domain_id, 24) for _ in range(2)]
    ours.announces(24)
    for participant in participants:
        ours.settle(participant)
    (line,) = ours.notices
    assert line.startswith(f"domain {own_domain_id}: ") and "24-byte" in line
    assert "ROS_DISTRO" in line
    # A participant that is created later starts with this size.
    for number in range(50):
        ours.middleware.create_node(own_domain_id, "/", f"node{number}")
    shared = ours.middleware._domains[own_domain_id].participants
    assert [shared_participant.gid_size for shared_participant in shared] == [24, 24]


def test_the_size_returns_to_sixteen_after_old_peers_left_and_new_ones_joined(ours, own_domain_id):
    old = OtherParticipant(own_domain_id, 24)
    ours.announces(24)
    old.leave()
    stay = OtherParticipant(own_domain_id, 16)
    ours.settle(stay)
    ours.announces(16)
    assert len(ours.notices) == 2 and "16-byte" in ours.notices[1]


def test_in_a_mixed_domain_the_majority_decides_with_a_notice(ours, own_domain_id):
    many = [OtherParticipant(own_domain_id, 16) for _ in range(2)]
    for participant in many:
        ours.settle(participant)
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
def test_participants_without_a_proof_of_their_size_change_nothing(ours, own_domain_id, user_data):
    participant = OtherParticipant(own_domain_id, 24, user_data)
    ours.settle(participant)
    ours.announces(16)
    assert ours.notices == []


def test_two_agents_follow_other_participants_and_not_each_other(ours, own_domain_id):
    """Otherwise two agents would make each other keep a size that no other participant uses."""
    second = Ours(own_domain_id)
    try:
        old = OtherParticipant(own_domain_id, 24)
        agents = ours, second
        for agent in agents:
            agent.announces(24)
        old.leave()
        OtherParticipant(own_domain_id, 16)
        for agent in agents:
            agent.announces(16)
    finally:
        second.middleware.close()


@pytest.mark.parametrize(("name", "size", "other_size"), [("humble", 24, 16), ("jazzy", 16, 24)])
def test_ros_distro_decides(distro, own_domain_id, name, size, other_size):
    distro(name)
    ours = Ours(own_domain_id)
    try:
        ours.announces(size)
        for _ in range(2):
            ours.settle(OtherParticipant(own_domain_id, other_size))
        assert ours.announced == size
        (line,) = ours.notices
        assert f"{other_size}: they do not see" in line and "set ROS_DISTRO" in line
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
    discovery = ParticipantDiscovery(ours.middleware.context, ours.node.participant, lambda: None)
    participants = [OtherParticipant(own_domain_id, 16) for _ in range(5)]
    ours.until(
        lambda: {participant.guid for participant in participants} <= discovery.announced.keys()
    )
    discovery.close()


def test_invalid_samples_are_ignored(ours, own_domain_id):
    discovery = ParticipantDiscovery(ours.middleware.context, ours.node.participant, lambda: None)
    participant = OtherParticipant(own_domain_id, 16)
    for bad in (b"\xff", b"\xff" * 40, participant.guid + b"\1\0\0\0"):
        participant.write(b"\0\1\0\0" + bad)
    last = OtherParticipant(own_domain_id, 16)
    ours.until(lambda: last.guid in discovery.announced)
    discovery.close()


def test_a_participant_cannot_announce_for_others(ours, own_domain_id):
    """Attack: a writer announces Gids of 24 bytes for other participants."""
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


def test_a_tie_is_decided_for_sixteen(ours, own_domain_id):
    """Attack: one participant of a ROS before Iron that meets no other participant."""
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
