"""Limits of a domain: the time of a turn, datagrams that wait, replies that wait."""

import pytest

from uros.middleware.base import Service
from uros.middleware.rtps import domain as domain_module
from uros.middleware.rtps import ids, services, submessages
from uros.middleware.rtps.local import why_unmatched
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.middleware.rtps.parameters import EndpointData
from uros.qos import QoSProfile

TYPE = "std_msgs::msg::dds_::String_"
SERVICE = Service(
    "rq/echoRequest", "std_srvs::srv::dds_::Trigger_Request_",
    "rr/echoReply", "std_srvs::srv::dds_::Trigger_Response_",
)  # fmt: skip


@pytest.fixture
def middleware(own_domain_id):
    made = RtpsMiddleware()
    made.node = made.create_node(own_domain_id, "/", "limits")
    made.domain = made._domains[own_domain_id]
    yield made
    made.close()


class Clock:
    """A clock on which each look takes a millisecond."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        self.now += 0.001
        return self.now


def test_a_flood_of_datagrams_ends_a_turn_after_two_milliseconds(middleware, monkeypatch):
    taken = []

    def flood(fileno):
        while True:
            taken.append(1)
            yield memoryview(submessages.header(ids.NO_PREFIX)), "127.0.0.1"

    monkeypatch.setattr(middleware.domain._sockets, "receive", flood)
    monkeypatch.setattr(domain_module, "time", Clock())
    middleware.domain.receive(0)
    assert 1 <= len(taken) <= 3


def test_samples_wait_once_for_discovery_that_was_not_handled_wholly(middleware, monkeypatch):
    """What announces the writer of a sample may be in the rest; a flood must not hold them up."""
    sockets = middleware.domain._sockets
    samples = next(filter(sockets.is_for_samples, sockets.filenos()))
    discovery = next(iter(sockets._receiving))
    assert sockets.is_for_samples(samples) and not sockets.is_for_samples(discovery)
    waiting, taken = {}, []

    def receive(fileno):
        while waiting.get(fileno):
            waiting[fileno] -= 1
            taken.append(fileno)
            yield memoryview(submessages.header(ids.NO_PREFIX)), "127.0.0.1"

    def turn():
        taken.clear()
        for fileno in (discovery, samples):
            middleware.domain.receive(fileno)
        return set(taken)

    monkeypatch.setattr(sockets, "receive", receive)
    monkeypatch.setattr(domain_module, "time", Clock())  # two datagrams take a turn's time
    waiting.update({discovery: 1, samples: 1})
    assert turn() == {discovery, samples}
    waiting.update({discovery: 4, samples: 1})
    assert turn() == {discovery}
    assert turn() == {discovery, samples}
    waiting.update({discovery: 1000, samples: 1000})
    assert [samples in turn() for _ in range(6)] == [False, True] * 3


def test_a_notice_of_a_mismatch_is_short_whatever_the_network_sends(middleware):
    """Attack: 1000 notices with 32 kB of partitions each, which are remembered."""
    notices = []
    middleware.on_notice = notices.append
    ours = middleware.node.create_writer("rt/a", TYPE, QoSProfile()).local.data
    patterns = tuple("\u0378" * 300 + f"{number}" for number in range(64))
    theirs = EndpointData(
        bytes(16), False, "rt/a", TYPE, QoSProfile(partitions=patterns),
        representations=tuple(range(1, 17)),
    )  # fmt: skip
    middleware.domain.participant.on_mismatch(ours, theirs, why_unmatched(ours, theirs))
    (notice,) = notices
    assert "partition (none offered, '\\u0378" in notice and len(notice) < 500


def test_datagrams_that_wait_are_limited_for_all_places_together(middleware, monkeypatch):
    """Many participants that ask for more than can be sent."""
    domain = middleware.domain
    domain._backlog_octets.limit = 1_000_000
    monkeypatch.setattr(domain._sockets, "send", lambda datagram, place: False)
    places = [Locator(UDPV4, 7410, f"127.0.1.{number}") for number in range(10)]
    for place in places:
        datagrams = [(bytes(1000), place)] * 1000
        monkeypatch.setattr(
            domain.participant, "take_datagrams", lambda datagrams=datagrams: datagrams
        )
        domain.flush()
    waiting = {place: len(domain._backlog[place]) for place in places}
    assert sum(waiting.values()) * 1000 == domain._backlog_octets.used <= 1_000_000
    assert waiting[places[0]] == 500 and waiting[places[2]] >= 100
    monkeypatch.undo()
    domain._backlog.clear()


@pytest.mark.parametrize("event", ["nodes", "interfaces", "a full buffer", "a tick"])
def test_the_deadline_that_is_remembered_is_the_one_that_a_search_finds(
    middleware, monkeypatch, event
):
    domain = middleware.domain
    while domain.info.next_deadline() is not None:
        domain.tick()
    domain.participant._announcer.due = 1e12
    domain._is_deadline_known = False
    assert domain.next_deadline() == domain._find_deadline()
    if event == "nodes":
        domain.info.changed()
    elif event == "interfaces":
        monkeypatch.setattr(domain._sockets, "_take_changes", lambda: None)
        domain._sockets.scan_at = 0.0
        domain.receive(-1)
    elif event == "a full buffer":
        monkeypatch.setattr(domain._sockets, "send", lambda datagram, place: False)
        place = Locator(UDPV4, 7410, "127.0.1.1")
        monkeypatch.setattr(domain.participant, "take_datagrams", lambda: [(b"x", place)])
        domain.flush()
    else:
        monkeypatch.setattr(domain_module.time, "monotonic", lambda: 1e9)
        domain.tick()
    assert not domain._touched
    assert domain.next_deadline() == domain._find_deadline()
    monkeypatch.undo()
    domain._backlog.clear()


def test_replies_whose_readers_do_not_match_are_limited_in_octets(middleware, monkeypatch):
    """Requests in the name of readers that never come, for large replies."""
    monkeypatch.setattr(services, "_MAX_WAITING_OCTETS", 1_000_000)
    replier = middleware.node.create_replier(SERVICE, QoSProfile(), lambda: None)
    for number in range(30):
        reader = bytes(12) + bytes([0, 0, number, ids.KIND_READER_NO_KEY])
        assert replier.reply(b"\1" + reader[1:], number, b"\0\1\0\0" + bytes(100_000))
    assert len(replier._waiting) == 9
