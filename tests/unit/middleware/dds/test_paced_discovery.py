"""The graph of a domain: everything in it, with at most one change a second."""

import select
import time

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.graph import living_nodes
from uros.middleware.memory import MemoryMiddleware
from uros.qos import QoSProfile

TYPE = "std_msgs::msg::dds_::String_"


@pytest.fixture
def middleware():
    dds = DdsMiddleware()
    yield dds
    dds.close()


def serve(middleware, done, wait=10.0):
    """Serve until ``done()``, which is called again after ``wait`` seconds without an event."""
    end = time.monotonic() + 10
    while not done():
        now = time.monotonic()
        assert now < end
        due = middleware.next_deadline()
        seconds = wait if due is None else max(0.0, min(wait, due - now))
        if select.select([middleware.fileno()], [], [], seconds)[0]:
            middleware.dispatch()
        middleware.tick()


def test_nodes_appear_and_leave(middleware, own_domain_id):
    changes = []
    graph = middleware.graph(own_domain_id, lambda: changes.append(1))
    assert changes == [] and living_nodes(graph) == []
    other_middleware = DdsMiddleware()
    try:
        node = other_middleware.create_node(own_domain_id, "/garden", "weather")
        writer = node.create_writer("rt/x", TYPE, QoSProfile())

        def node_is_listed():
            other_middleware.tick()
            return changes and [
                (node.namespace, node.name, node.writers) for node in living_nodes(graph)
            ] == [("/garden", "weather", [writer.guid])]

        serve(middleware, node_is_listed, wait=0.02)
        serve(middleware, lambda: writer.guid in graph.endpoints)
        assert graph.endpoints[writer.guid].topic == "rt/x"
        changes.clear()
        node.close()
    finally:
        other_middleware.close()
    serve(middleware, lambda: changes and not living_nodes(graph))
    graph.close()
    graph.close()
    assert graph._paced not in middleware.context.schedule


def test_two_graphs_of_one_domain_and_one_of_another_are_independent(
    middleware, own_domain_id, domain_id
):
    calls = []
    graphs = [
        middleware.graph(domain, lambda domain=domain: calls.append(domain))
        for domain in (own_domain_id, own_domain_id, domain_id)
    ]
    middleware.create_node(own_domain_id, "/", "n")
    serve(middleware, lambda: calls.count(own_domain_id) >= 2)
    graphs[0].close()
    calls.clear()
    middleware.create_node(own_domain_id, "/", "m")
    serve(middleware, lambda: own_domain_id in calls)
    assert [living_node.name for living_node in living_nodes(graphs[1])] == ["n", "m"]


def test_a_domain_that_does_not_exist(middleware):
    with pytest.raises(MiddlewareError, match="domain 233"):
        middleware.graph(233, lambda: None)


def test_other_middlewares_have_no_graph():
    middleware = MemoryMiddleware()
    assert middleware.graph(0, lambda: None) is None
    middleware.close()
