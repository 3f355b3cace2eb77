"""Nodes of another participant of this process, whose endpoints a node of ours lists."""

import select
import time

import pytest

from uros.middleware.dds import cyclone, suppressed_nodes
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.discovery_info import codec
from uros.middleware.discovery_info.codec import decode
from uros.middleware.guid import participant_of
from uros.qos import HistoryPolicy

OTHER = b"\x01\x0f" + bytes(range(10)) + b"\0\0\1\xc1"
ENDPOINT = OTHER[:12] + b"\0\0\4\4"


class Peer:
    """What a ROS node knows of participants: the last message about each, by any writer."""

    def __init__(self, domain):
        participant = cyclone.create_participant(domain, b"enclave=/;")
        topic = cyclone.create_topic(participant, codec.TOPIC, codec.TYPE)
        qos = codec.qos()
        qos.history = HistoryPolicy.KEEP_ALL
        group = cyclone.create_group("subscriber", participant)
        self._reader = cyclone.create_reader(group, topic, qos)
        self.nodes = {}
        self.count = 0

    def look(self):
        for sample, _ in cyclone.take(self._reader, 100):
            guid, nodes, _ = decode(sample)
            self.count += guid == OTHER
            self.nodes[guid] = [node.name for node in nodes]


@pytest.fixture
def middleware(own_domain_id):
    dds = DdsMiddleware()
    yield dds
    dds.close()


def serve(middleware, done, seconds=20):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it does not come"
        due = middleware.next_deadline()
        timeout = 0.1 if due is None else min(0.1, max(0.0, due - time.monotonic()))
        if select.select([middleware.fileno()], [], [], timeout)[0]:
            middleware.dispatch()
        middleware.dispatch_local()
        middleware.tick()


def test_empty_discovery_info_is_repeated_and_then_stops(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "board")
    peer = Peer(own_domain_id)
    node.adopt([ENDPOINT], [])

    def quiet():
        peer.look()
        return peer.count >= len(suppressed_nodes._DELAYS) and middleware.next_deadline() is None

    serve(middleware, quiet)
    assert peer.nodes[OTHER] == []
    assert peer.nodes[node.participant.guid] == ["board"]
    # The participant has announced its changed nodes itself, so ours must be the last message.
    count = peer.count
    node.disown([ENDPOINT], [])
    serve(middleware, lambda: peer.look() or peer.count > count)
    # A late reader gets it after the participant's own message.
    serve(middleware, quiet)
    late_peer = Peer(own_domain_id)
    serve(middleware, lambda: late_peer.look() or late_peer.count >= len(suppressed_nodes._DELAYS))
    assert late_peer.nodes[OTHER] == []


def test_a_node_that_adopts_nothing_writes_no_discovery_info_of_others(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "board")
    node.adopt([], [])  # an RMW that is not on DDS
    assert middleware._domains[own_domain_id]._suppressed is None


def test_the_participant_of_an_endpoint():
    assert participant_of(ENDPOINT) == OTHER
