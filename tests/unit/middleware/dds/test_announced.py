"""What others may write in ``ros_discovery_info``, and what it costs."""

import itertools
import select
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import running_agent
from support.client import XrceClient

from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds import announce, announced, cyclone
from uros.middleware.dds.announced import Announced, decode
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import services_profile
from uros.wire import ids

GID = bytes(range(16))


class Stranger:
    """A participant of somebody else that writes what it likes."""

    def __init__(self, domain):
        self.entity = cyclone.create_participant(domain, b"enclave=/;")
        self.guid = cyclone.guid(self.entity)
        topic = cyclone.create_topic(self.entity, announce.TOPIC, announce.TYPE)
        publisher = cyclone.create_group("publisher", self.entity)
        self._writer = cyclone.create_writer(publisher, topic, announce.qos(), b"")

    def say(self, *nodes, guid=None):
        self.write(announce.encode(guid or self.guid, nodes, 16))

    def write(self, sample):
        assert cyclone.write(self._writer, sample)


class Ours:
    def __init__(self, domain):
        self.said = []
        self.news = 0
        self.parsed = [0]  # octets after each turn
        self.middleware = DdsMiddleware()
        self.middleware.on_notice = self.said.append
        self.node = self.middleware.create_node(domain, "/", "ours")
        self.heard = Announced(self.middleware, self.node.participant, self._changed)

    def _changed(self):
        self.news += 1
        self.parsed.append(self.heard.parsed)

    def until(self, done, seconds=20):
        end = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < end, "it does not come"
            due = self.middleware.next_deadline()
            left = 0.1 if due is None else min(0.1, max(0.0, due - time.monotonic()))
            if select.select([self.middleware.fileno()], [], [], left)[0]:
                self.middleware.dispatch()
            self.middleware.dispatch_local()
            self.middleware.tick()

    def names(self, stranger):
        return [it.name for it in self.heard.nodes.get(stranger.guid, ())]


@pytest.fixture
def ours(own_domain_id):
    one = Ours(own_domain_id)
    yield one
    one.middleware.close()


@pytest.fixture
def stranger(ours, own_domain_id):
    return Stranger(own_domain_id)


def node(name, readers=0, writers=0):
    return announce.NodeEntities("/", name, [GID] * readers, [GID] * writers)


def test_a_participant_speaks_for_itself_alone(ours, stranger, own_domain_id):
    other = Stranger(own_domain_id)
    other.say(node("other"))
    ours.until(lambda: ours.names(other) == ["other"])
    stranger.say(node("forged"), guid=other.guid)
    stranger.say(node("own"))
    ours.until(lambda: ours.names(stranger) == ["own"])
    assert ours.names(other) == ["other"]


@pytest.mark.parametrize(
    "sample",
    [
        lambda guid: announce.encode(guid, [node("n", 1)] * (announced.MAX_NODES + 1), 16),
        lambda guid: announce.encode(guid, [node("n", announced.MAX_ENDPOINTS + 1)], 16),
        lambda guid: announce.encode(guid, [node("n", 0, announced.MAX_ENDPOINTS + 1)], 16),
        lambda guid: announce.encode(guid, [node("n" * announced.MAX_TEXT)], 16),
    ],
    ids=["nodes", "readers", "writers", "name"],
)
def test_what_is_beyond_a_limit_is_no_announcement(ours, stranger, own_domain_id, sample):
    assert decode(sample(stranger.guid)) is None
    stranger.write(sample(stranger.guid))
    honest = Stranger(own_domain_id)
    honest.say(node("honest"))
    ours.until(lambda: ours.names(honest))
    assert not ours.names(stranger)


def test_what_is_within_them_is_taken(ours, stranger):
    stranger.say(*[node(f"n{i}", 20, 20) for i in range(100)])
    ours.until(lambda: len(ours.names(stranger)) == 100)
    stranger.say(node("n", announced.MAX_ENDPOINTS, announced.MAX_ENDPOINTS))
    ours.until(lambda: ours.names(stranger) == ["n"])


def test_a_sample_of_megabytes_is_not_parsed_and_is_told_once(ours, stranger, own_domain_id):
    honest = Stranger(own_domain_id)
    honest.say(node("honest"))
    ours.until(lambda: ours.names(honest))
    before = ours.heard.parsed
    for number in range(3):
        stranger.say(node("n", 7_000_000 // 16 + number))
        ours.until(lambda: ours.said)
        ours.until(lambda: ours.heard.due is None)
    assert ours.heard.parsed - before < announced.MAX_SAMPLE
    assert ours.names(honest) == ["honest"] and not ours.names(stranger)
    (told,) = ours.said
    assert "somebody says more in ros_discovery_info than is kept" in told


def test_a_flood_is_paid_for_and_the_others_are_heard(ours, stranger, own_domain_id):
    """Octets parsed and not seconds: so many at first, and no more than the time allows."""
    honest = Stranger(own_domain_id)
    started = time.monotonic()
    number = 0

    def write():
        nonlocal number
        number += 1
        stranger.say(*[node(f"{number}_{i}") for i in range(900)])

    def paused():
        write()
        return ours.heard.due is not None

    ours.until(paused, 60)  # the debt
    honest.say(node("honest"))

    def heard():
        write()
        return ours.names(honest)

    ours.until(heard, 60)
    most = announced.BURST + (time.monotonic() - started) * announced.RATE
    assert ours.heard.parsed < most + 2 * announced.TURN + announced.MAX_SAMPLE


def test_one_turn_parses_so_much_and_no_more(ours, own_domain_id):
    for number in range(40):
        Stranger(own_domain_id).say(*[node(f"{number}_{i}") for i in range(100)])
    ours.until(lambda: len(ours.heard.nodes) >= 40)
    turns = [after - before for before, after in itertools.pairwise(ours.parsed)]
    assert 0 < max(turns) <= announced.TURN + 4000  # the last one may be as long as it is


def test_what_is_kept_of_all_is_limited(ours, own_domain_id, monkeypatch):
    monkeypatch.setattr(announced, "MAX_KEPT", 3000)
    strangers = [Stranger(own_domain_id) for _ in range(6)]
    for one in strangers:
        one.say(*[node(f"n{i}") for i in range(30)])
    ours.until(lambda: ours.said)
    assert ours.heard._size <= 3000
    assert 1 <= sum(bool(ours.names(one)) for one in strangers) < 6
    for one in strangers:
        ours.heard.forget(one.guid)
    assert ours.heard._size == 0 and not ours.heard.nodes


def test_the_same_again_costs_next_to_nothing(ours, stranger):
    stranger.say(*[node(f"n{i}") for i in range(500)])
    own = ours.node.participant.guid
    ours.until(lambda: ours.names(stranger) and own in ours.heard.nodes)
    parsed, news = ours.heard.parsed, ours.news
    ours.heard.ask_again()
    ours.until(lambda: ours.news > news)
    assert ours.heard.parsed == parsed and len(ours.names(stranger)) == 500


BUILTIN = ["DCPSParticipant", "DCPSTopic", "DCPSPublication", "DCPSSubscription"]


@pytest.mark.parametrize("topic", [announce.TOPIC, *BUILTIN])
def test_nodes_do_not_write_what_middlewares_write(ours, topic):
    """Attack: a board's datawriter, or a requester or replier of such a topic."""
    qos = services_profile()
    with pytest.raises(MiddlewareError, match=topic):
        ours.node.create_writer(topic, announce.TYPE, qos)
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
            board.writer("board", announce.TOPIC, announce.TYPE)
        assert "belongs to the middleware" in agent.said.getvalue()
        board.close()


@given(st.binary(max_size=400), st.sampled_from([b"\0\1\0\0", b"\0\0\0\0"]))
def test_any_octets_are_a_message_or_none(body, header):
    got = decode(header + body)
    if got is not None:
        _, nodes, size = got
        assert size in (16, 24) and len(nodes) <= announced.MAX_NODES
