"""Topics that exist with another type, on real DDS, whichever endpoint came first."""

import select
import time
from contextlib import contextmanager

import pytest

from uros.middleware.base import Service
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import QoSProfile

SECONDS = 20.0
INT32, STRING = "std_msgs::msg::dds_::Int32_", "std_msgs::msg::dds_::String_"


class Network:
    """A middleware whose turns the test runs."""

    def __init__(self, watch=False):
        self.middleware = DdsMiddleware()
        self.conflicts = []
        if watch:
            self.middleware.on_type_conflict = lambda *words: self.conflicts.append(words)

    def turn(self, seconds=0.05):
        if select.select([self.middleware.fileno()], [], [], seconds)[0]:
            self.middleware.dispatch()
        self.middleware.tick()


@contextmanager
def networks():
    ours, peer = Network(watch=True), Network()
    try:
        yield ours, peer
    finally:
        peer.middleware.close()
        ours.middleware.close()


def until(ours, done):
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, ours.conflicts
        ours.turn()


def write_to(network, domain, topic, type_name):
    node = network.middleware.create_node(domain, "/", "writer")
    return node.create_writer(topic, type_name, QoSProfile())


@pytest.mark.parametrize("ours_first", [True, False])
def test_a_type_that_differs_is_reported_in_either_order_of_creation(own_domain_id, ours_first):
    with networks() as (ours, peer):
        first, second = (ours, peer) if ours_first else (peer, ours)
        write_to(first, own_domain_id, "rt/a", INT32 if ours_first else STRING)
        write_to(second, own_domain_id, "rt/a", STRING if ours_first else INT32)
        until(ours, lambda: ours.conflicts)
        assert ours.conflicts == [("rt/a", INT32, STRING)]


def test_two_of_our_own_that_differ(own_domain_id):
    with networks() as (ours, _):
        write_to(ours, own_domain_id, "rt/a", INT32)
        write_to(ours, own_domain_id, "rt/a", STRING)
        until(ours, lambda: ours.conflicts)
        assert sorted(ours.conflicts[0][1:]) == sorted([INT32, STRING])


def test_equal_types_foreign_topics_and_closed_endpoints_are_not_reported(own_domain_id):
    with networks() as (ours, peer):
        write_to(ours, own_domain_id, "rt/same", INT32)
        write_to(peer, own_domain_id, "rt/same", INT32)
        write_to(peer, own_domain_id, "rt/theirs", INT32)
        write_to(peer, own_domain_id, "rt/theirs", STRING)
        closed_writer = write_to(ours, own_domain_id, "rt/gone", INT32)
        write_to(ours, own_domain_id, "rt/mark", INT32)
        for _ in range(5):
            ours.turn(0.01)
        closed_writer.close()
        for _ in range(5):
            ours.turn(0.01)
        write_to(peer, own_domain_id, "rt/gone", STRING)
        write_to(peer, own_domain_id, "rt/mark", STRING)
        until(ours, lambda: ours.conflicts)
        assert ours.conflicts == [("rt/mark", INT32, STRING)]


def test_services_are_compared_too(own_domain_id):
    with networks() as (ours, peer):
        ours.middleware.create_node(own_domain_id, "/", "n").create_requester(
            Service("rq/a", "A", "rr/a", "B"), QoSProfile(), print
        )
        peer.middleware.create_node(own_domain_id, "/", "n").create_replier(
            Service("rq/a", "A", "rr/a", "C"), QoSProfile(), print
        )
        until(ours, lambda: ours.conflicts)
        assert ours.conflicts == [("rr/a", "B", "C")]
