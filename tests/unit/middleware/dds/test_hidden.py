"""Nodes of a foreign participant of this process, whose endpoints a node of ours has."""

import select
import time

import pytest

from uros.middleware.dds import announce, cyclone, hidden
from uros.middleware.dds.announced import decode, participant_of
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import HistoryPolicy

OTHER = b"\x01\x0f" + bytes(range(10)) + b"\0\0\1\xc1"
ENDPOINT = OTHER[:12] + b"\0\0\4\4"


class Peer:
    """What a node of ROS knows of participants: the last word about each, from whomever."""

    def __init__(self, domain):
        participant = cyclone.create_participant(domain, b"enclave=/;")
        topic = cyclone.create_topic(participant, announce.TOPIC, announce.TYPE)
        qos = announce.qos()
        qos.history = HistoryPolicy.KEEP_ALL
        group = cyclone.create_group("subscriber", participant)
        self._reader = cyclone.create_reader(group, topic, qos)
        self.nodes = {}
        self.said = 0

    def look(self):
        for sample, _ in cyclone.take(self._reader, 100):
            guid, nodes, _ = decode(sample)
            self.said += guid == OTHER
            self.nodes[guid] = [it.name for it in nodes]


@pytest.fixture
def middleware(own_domain_id):
    one = DdsMiddleware()
    yield one
    one.close()


def serve(middleware, done, seconds=20):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it does not come"
        due = middleware.next_deadline()
        left = 0.1 if due is None else min(0.1, max(0.0, due - time.monotonic()))
        if select.select([middleware.fileno()], [], [], left)[0]:
            middleware.dispatch()
        middleware.dispatch_local()
        middleware.tick()


def test_it_is_said_to_have_none_again_and_again_then_no_more(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "board")
    peer = Peer(own_domain_id)
    node.adopt([ENDPOINT], [])

    def quiet():
        peer.look()
        return peer.said >= len(hidden._TIMES) and middleware.next_deadline() is None

    serve(middleware, quiet)
    assert peer.nodes[OTHER] == []
    assert peer.nodes[node.participant.guid] == ["board"]
    # Its nodes have changed: it has said so itself, so we must have the last word.
    said = peer.said
    node.disown([ENDPOINT], [])
    serve(middleware, lambda: peer.look() or peer.said > said)
    # And who comes later hears it after the other.
    serve(middleware, quiet)
    later = Peer(own_domain_id)
    serve(middleware, lambda: later.look() or later.said >= len(hidden._TIMES))
    assert later.nodes[OTHER] == []


def test_a_node_that_adopts_nothing_says_nothing_of_others(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "board")
    node.adopt([], [])  # an RMW that is none on DDS
    assert not middleware._hidden


def test_the_participant_of_an_endpoint():
    assert participant_of(ENDPOINT) == OTHER
