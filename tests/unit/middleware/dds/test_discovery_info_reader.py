"""Limits on other participants' ``ros_discovery_info``: size, number, octets parsed a second."""

import itertools
import select
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import running_agent
from support.client import XrceClient

from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds import cyclone
from uros.middleware.dds.discovery_info_reader import DiscoveryInfoReader
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.discovery_info import codec, intake
from uros.middleware.discovery_info.codec import decode
from uros.qos import services_profile
from uros.wire import ids

GID = bytes(range(16))


class OtherParticipant:
    """A participant of another process that may write any sample."""

    def __init__(self, domain):
        self.entity = cyclone.create_participant(domain, b"enclave=/;")
        self.guid = cyclone.guid(self.entity)
        topic = cyclone.create_topic(self.entity, codec.TOPIC, codec.TYPE)
        publisher = cyclone.create_group("publisher", self.entity)
        self._writer = cyclone.create_writer(publisher, topic, codec.qos(), b"")

    def announce(self, *nodes, guid=None):
        self.write(codec.encode(guid or self.guid, nodes, 16))

    def write(self, sample):
        assert cyclone.write(self._writer, sample)


class Ours:
    def __init__(self, domain):
        self.notices = []
        self.news = 0
        self.parsed = [0]  # octets after each turn
        self.middleware = DdsMiddleware()
        self.middleware.on_notice = self.notices.append
        self.node = self.middleware.create_node(domain, "/", "ours")
        self.reader = DiscoveryInfoReader(
            self.middleware.context, self.node.participant, self._changed
        )

    def _changed(self):
        self.news += 1
        self.parsed.append(self.reader.intake.parsed)

    def until(self, done, seconds=20):
        end = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < end, "it does not come"
            due = self.middleware.next_deadline()
            timeout = 0.1 if due is None else min(0.1, max(0.0, due - time.monotonic()))
            if select.select([self.middleware.fileno()], [], [], timeout)[0]:
                self.middleware.dispatch()
            self.middleware.dispatch_local()
            self.middleware.tick()

    def names(self, participant):
        return [item.name for item in self.reader.intake.nodes.get(participant.guid, ())]


@pytest.fixture
def ours(own_domain_id):
    own = Ours(own_domain_id)
    yield own
    own.middleware.close()


@pytest.fixture
def peer(ours, own_domain_id):
    return OtherParticipant(own_domain_id)


def node(name, readers=0, writers=0):
    return codec.NodeEntities("/", name, [GID] * readers, [GID] * writers)


def test_a_participant_announces_its_own_nodes_alone(ours, peer, own_domain_id):
    honest = OtherParticipant(own_domain_id)
    honest.announce(node("honest"))
    ours.until(lambda: ours.names(honest) == ["honest"])
    peer.announce(node("forged"), guid=honest.guid)
    peer.announce(node("own"))
    ours.until(lambda: ours.names(peer) == ["own"])
    assert ours.names(honest) == ["honest"]


@pytest.mark.parametrize(
    "sample",
    [
        lambda guid: codec.encode(guid, [node("n", 1)] * (codec.MAX_NODES + 1), 16),
        lambda guid: codec.encode(guid, [node("n", codec.MAX_ENDPOINTS + 1)], 16),
        lambda guid: codec.encode(guid, [node("n", 0, codec.MAX_ENDPOINTS + 1)], 16),
        lambda guid: codec.encode(guid, [node("n" * codec.MAX_TEXT)], 16),
    ],
    ids=["nodes", "readers", "writers", "name"],
)
def test_a_message_beyond_a_limit_is_ignored(ours, peer, own_domain_id, sample):
    assert decode(sample(peer.guid)) is None
    peer.write(sample(peer.guid))
    honest = OtherParticipant(own_domain_id)
    honest.announce(node("honest"))
    ours.until(lambda: ours.names(honest))
    assert not ours.names(peer)


def test_a_message_within_the_limits_is_kept(ours, peer):
    peer.announce(*[node(f"n{i}", 20, 20) for i in range(100)])
    ours.until(lambda: len(ours.names(peer)) == 100)
    peer.announce(node("n", codec.MAX_ENDPOINTS, codec.MAX_ENDPOINTS))
    ours.until(lambda: ours.names(peer) == ["n"])


def test_a_sample_of_several_megabytes_is_not_parsed_and_causes_one_notice(
    ours, peer, own_domain_id
):
    honest = OtherParticipant(own_domain_id)
    honest.announce(node("honest"))
    ours.until(lambda: ours.names(honest))
    before = ours.reader.intake.parsed
    for number in range(3):
        peer.announce(node("n", 7_000_000 // 16 + number))
        ours.until(lambda: ours.notices)
        ours.until(lambda: ours.reader.due is None)
    assert ours.reader.intake.parsed - before < intake.MAX_SAMPLE
    assert ours.names(honest) == ["honest"] and not ours.names(peer)
    (notice,) = ours.notices
    assert "a participant writes more to ros_discovery_info than is kept" in notice


@pytest.fixture
def low_rate(monkeypatch):
    """A rate that a flood exceeds on a busy machine too."""
    monkeypatch.setattr(intake, "RATE", intake.RATE // 8)


@pytest.mark.slow
def test_a_flood_empties_the_token_bucket_and_others_are_still_read(
    low_rate, ours, peer, own_domain_id
):
    """The limit counts octets, not seconds: a burst at first, then no more than the rate allows."""
    honest = OtherParticipant(own_domain_id)
    started = time.monotonic()
    number = 0

    def write():
        nonlocal number
        number += 1
        peer.announce(*[node(f"{number}_{i}") for i in range(900)])

    def paused():
        write()
        return ours.reader.due is not None

    ours.until(paused, 60)
    honest.announce(node("honest"))

    def honest_names():
        write()
        return ours.names(honest)

    ours.until(honest_names, 60)
    most = intake.BURST + (time.monotonic() - started) * intake.RATE
    assert ours.reader.intake.parsed < most + 2 * intake.TURN + intake.MAX_SAMPLE


def test_one_turn_parses_a_limited_number_of_octets(ours, own_domain_id):
    for number in range(40):
        OtherParticipant(own_domain_id).announce(*[node(f"{number}_{i}") for i in range(100)])
    ours.until(lambda: len(ours.reader.intake.nodes) >= 40)
    turns = [after - before for before, after in itertools.pairwise(ours.parsed)]
    assert 0 < max(turns) <= intake.TURN + 4000  # the last sample of a turn may be long


def test_the_stored_nodes_of_all_participants_are_limited(ours, own_domain_id, monkeypatch):
    monkeypatch.setattr(intake, "MAX_KEPT", 3000)
    participants = [OtherParticipant(own_domain_id) for _ in range(6)]
    for participant in participants:
        participant.announce(*[node(f"n{i}") for i in range(30)])
    ours.until(lambda: ours.notices)
    assert ours.reader.intake._size <= 3000
    assert 1 <= sum(bool(ours.names(participant)) for participant in participants) < 6
    for participant in participants:
        ours.reader.intake.forget(participant.guid)
    assert ours.reader.intake._size == 0 and not ours.reader.intake.nodes


def test_an_unchanged_sample_is_not_parsed_again(ours, peer):
    peer.announce(*[node(f"n{i}") for i in range(500)])
    own = ours.node.participant.guid
    ours.until(lambda: ours.names(peer) and own in ours.reader.intake.nodes)
    parsed, news = ours.reader.intake.parsed, ours.news
    ours.reader.recreate()
    ours.until(lambda: ours.news > news)
    assert ours.reader.intake.parsed == parsed and len(ours.names(peer)) == 500


BUILTIN = ["DCPSParticipant", "DCPSTopic", "DCPSPublication", "DCPSSubscription"]


@pytest.mark.parametrize("topic", [codec.TOPIC, *BUILTIN])
def test_nodes_cannot_write_to_topics_of_the_middleware(ours, topic):
    """Attack: a board's datawriter, or a requester or replier of such a topic."""
    qos = services_profile()
    with pytest.raises(MiddlewareError, match=topic):
        ours.node.create_writer(topic, codec.TYPE, qos)
    with pytest.raises(MiddlewareError, match=topic):
        ours.node.create_requester(Service(topic, "A", "rr/aReply", "B"), qos, print)
    with pytest.raises(MiddlewareError, match=topic):
        ours.node.create_replier(Service("rq/aRequest", "A", topic, "B"), qos, print)
    ours.node.create_writer("rt/rosout", "rcl_interfaces::msg::dds_::Log_", qos).close()


def test_a_boards_datawriter_there_is_refused(own_domain_id):
    with running_agent("udp", "dds", own_domain_id) as agent:
        board = XrceClient(agent.line(0), key=0x63000001)
        assert board.open() == ids.STATUS_OK
        with pytest.raises(AssertionError, match="ERR_DDS_ERROR"):
            board.writer("board", codec.TOPIC, codec.TYPE)
        assert "belongs to the middleware" in agent.said.getvalue()
        board.close()


@given(st.binary(max_size=400), st.sampled_from([b"\0\1\0\0", b"\0\0\0\0"]))
def test_any_octets_are_a_message_or_none(body, header):
    decoded = decode(header + body)
    if decoded is not None:
        _, nodes, size = decoded
        assert size in (16, 24) and len(nodes) <= codec.MAX_NODES
