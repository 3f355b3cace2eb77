"""The auto middleware: topics on dds, services on rtps, and one node in the graph.

tests/interop tests it with real nodes, tests/contract its contract.
"""

import select
import time

import pytest

from uros.middleware import base, open_middleware
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import QoSProfile

STRING = "std_msgs::msg::dds_::String_"
SERVICE = Service(
    "rq/addRequest", "pkg::srv::dds_::Add_Request_", "rr/addReply", "pkg::srv::dds_::Add_Response_"
)
REQUEST = b"\0\1\0\0\5\0\0\0"
SECONDS = 10


@pytest.fixture
def middleware():
    auto_middleware = open_middleware("auto")
    yield auto_middleware
    auto_middleware.close()


def serve(done, *middlewares):
    """Run the middlewares' data planes until ``done()``."""
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, "the condition is not reached in time"
        for item in middlewares:
            item.dispatch_local()
        ready = select.select([item.fileno() for item in middlewares], [], [], 0.02)[0]
        for item in middlewares:
            if item.fileno() in ready:
                item.dispatch()
            item.tick()


def serve_and_call(node, middleware):
    """Send a request from one endpoint to the other, and return it as it arrived."""
    requests = []
    replier = node.create_replier(SERVICE, QoSProfile(), lambda: requests.extend(replier.take(9)))
    requester = node.create_requester(SERVICE, QoSProfile(), lambda: None)
    assert requester.request(REQUEST) == 1
    serve(lambda: requests, middleware)
    return requests[0][2]


def test_rtps_is_opened_for_the_first_service(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", STRING, QoSProfile())
    assert middleware.engines == [middleware.dds]
    assert serve_and_call(node, middleware) == REQUEST
    assert isinstance(middleware._rtps, RtpsMiddleware)
    assert middleware.engines == [middleware.dds, middleware._rtps]


def test_the_nodes_entry_lists_its_services_until_they_go(middleware, own_domain_id):
    """Another participant sees one node, with the endpoints of topics and of services."""
    watching = DdsMiddleware()
    graph = watching.graph(own_domain_id, lambda: None)

    def topics(gids):
        endpoints = [graph.endpoints.get(gid) for gid in gids]
        return sorted("unknown" if end is None else end.topic for end in endpoints)

    def listed():
        return {
            (node.namespace, node.name): (topics(node.readers), topics(node.writers))
            for nodes in graph.announced.values()
            for node in nodes
        }

    def wait(readers, writers):
        wanted = {("/garden", "gate"): (readers, writers)}
        serve(lambda: listed() == wanted, middleware, watching)

    node = middleware.create_node(own_domain_id, "/garden", "gate")
    node.create_writer("rt/state", STRING, QoSProfile())
    replier = node.create_replier(SERVICE, QoSProfile(), lambda: None)
    wait(["rq/addRequest"], ["rr/addReply", "rt/state"])
    requester = node.create_requester(SERVICE, QoSProfile(), lambda: None)
    wait(["rq/addRequest", "rr/addReply"], ["rq/addRequest", "rr/addReply", "rt/state"])
    replier.close()
    wait(["rr/addReply"], ["rq/addRequest", "rt/state"])
    requester.close()
    wait([], ["rt/state"])
    node.create_replier(SERVICE, QoSProfile(), lambda: None)
    wait(["rq/addRequest"], ["rr/addReply", "rt/state"])
    node.close()
    serve(lambda: listed() == {}, middleware, watching)
    watching.close()


def test_the_services_participant_announces_no_node(middleware, own_domain_id):
    """Not even an empty list: it has no endpoint on ros_discovery_info."""
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_replier(SERVICE, QoSProfile(), lambda: None)
    domain = middleware._rtps._domains[own_domain_id]
    assert domain.info is None
    assert {data.topic for data in domain.endpoints().values()} == {"rq/addRequest", "rr/addReply"}


def test_services_of_nodes_in_two_domains_do_not_meet(middleware, own_domain_id):
    from conftest import leased_domain

    with leased_domain() as other:
        requests = []
        here = middleware.create_node(own_domain_id, "/", "here")
        there = middleware.create_node(other, "/", "there")
        for node in (here, there):
            node.create_replier(SERVICE, QoSProfile(), lambda node=node: requests.append(node))
        there.create_requester(SERVICE, QoSProfile(), lambda: None).request(REQUEST)
        serve(lambda: requests, middleware)
        assert requests == [there]
        middleware.close()  # before the domain is leased to others


def test_equal_notices_are_sent_once_and_their_number_is_limited(middleware, monkeypatch):
    monkeypatch.setattr(base, "_MAX_NOTICES", 3)
    notices = []
    middleware.on_notice = notices.append
    for text in "aabcbdea":
        middleware.notice(text)
    assert notices == ["a", "b", "c"]


def test_settings_made_before_the_first_node_apply_to_both(middleware, own_domain_id):
    conflicts = []
    middleware.on_type_conflict = lambda *about: conflicts.append(about)
    middleware.batching = True
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", STRING, QoSProfile())
    node.create_replier(SERVICE, QoSProfile(), lambda: None)
    other_middleware = DdsMiddleware()
    other_node = other_middleware.create_node(own_domain_id, "/", "there")
    other_node.create_writer("rt/chatter", "std_msgs::msg::dds_::Int32_", QoSProfile())
    other_node.create_writer("rq/addRequest", "pkg::srv::dds_::Sub_Request_", QoSProfile())
    topics = {"rt/chatter", "rq/addRequest"}
    serve(lambda: {topic for topic, _, _ in conflicts} == topics, middleware, other_middleware)
    assert middleware.dds.batching and middleware._rtps.batching
    other_middleware.close()


def test_rtps_is_served_although_dds_fails(middleware, own_domain_id, monkeypatch):
    node = middleware.create_node(own_domain_id, "/", "node")
    calls = []
    node.create_replier(SERVICE, QoSProfile(), lambda: calls.append(1))
    node.create_requester(SERVICE, QoSProfile(), lambda: None).request(REQUEST)

    def fail():
        raise MiddlewareError("a client's fault")

    monkeypatch.setattr(middleware.dds, "dispatch", fail)
    monkeypatch.setattr(middleware.dds, "dispatch_local", fail)
    for dispatch in (middleware.dispatch, middleware.dispatch_local):
        with pytest.raises(MiddlewareError, match="a client's fault"):
            dispatch()
    assert calls
