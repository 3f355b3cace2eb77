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
    """A middleware whose turns we take."""

    def __init__(self, watch=False):
        self.middleware = DdsMiddleware()
        self.seen = []
        if watch:
            self.middleware.on_type_conflict = lambda *words: self.seen.append(words)

    def turn(self, seconds=0.05):
        if select.select([self.middleware.fileno()], [], [], seconds)[0]:
            self.middleware.dispatch()
        self.middleware.tick()


@contextmanager
def networks():
    ours, theirs = Network(watch=True), Network()
    try:
        yield ours, theirs
    finally:
        theirs.middleware.close()
        ours.middleware.close()


def until(ours, done):
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, ours.seen
        ours.turn()


def write_to(network, domain, topic, type_name):
    node = network.middleware.create_node(domain, "/", "writer")
    return node.create_writer(topic, type_name, QoSProfile())


@pytest.mark.parametrize("ours_first", [True, False])
def test_a_type_that_differs_is_reported_whoever_comes_first(own_domain_id, ours_first):
    with networks() as (ours, theirs):
        one, two = (ours, theirs) if ours_first else (theirs, ours)
        write_to(one, own_domain_id, "rt/a", INT32 if ours_first else STRING)
        write_to(two, own_domain_id, "rt/a", STRING if ours_first else INT32)
        until(ours, lambda: ours.seen)
        assert ours.seen == [("rt/a", INT32, STRING)]


def test_two_of_our_own_that_differ(own_domain_id):
    with networks() as (ours, _):
        write_to(ours, own_domain_id, "rt/a", INT32)
        write_to(ours, own_domain_id, "rt/a", STRING)
        until(ours, lambda: ours.seen)
        assert sorted(ours.seen[0][1:]) == sorted([INT32, STRING])


def test_what_is_right_or_none_of_ours_or_gone_is_not_reported(own_domain_id):
    with networks() as (ours, theirs):
        write_to(ours, own_domain_id, "rt/same", INT32)
        write_to(theirs, own_domain_id, "rt/same", INT32)
        write_to(theirs, own_domain_id, "rt/theirs", INT32)
        write_to(theirs, own_domain_id, "rt/theirs", STRING)
        gone = write_to(ours, own_domain_id, "rt/gone", INT32)
        write_to(ours, own_domain_id, "rt/mark", INT32)
        for _ in range(5):
            ours.turn(0.01)
        gone.close()
        for _ in range(5):
            ours.turn(0.01)
        write_to(theirs, own_domain_id, "rt/gone", STRING)
        write_to(theirs, own_domain_id, "rt/mark", STRING)
        until(ours, lambda: ours.seen)
        assert ours.seen == [("rt/mark", INT32, STRING)]


def test_services_are_compared_too(own_domain_id):
    with networks() as (ours, theirs):
        ours.middleware.create_node(own_domain_id, "/", "n").create_requester(
            Service("rq/a", "A", "rr/a", "B"), QoSProfile(), print
        )
        theirs.middleware.create_node(own_domain_id, "/", "n").create_replier(
            Service("rq/a", "A", "rr/a", "C"), QoSProfile(), print
        )
        until(ours, lambda: ours.seen)
        assert ours.seen == [("rr/a", "B", "C")]
