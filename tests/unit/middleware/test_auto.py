"""The auto middleware where rclpy cannot be imported: services by dds, and one notice.

Where it can, tests/interop tests it.
"""

import select
import sys
import time

import pytest

from uros.middleware import base, open_middleware
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import QoSProfile

SERVICE = Service(
    "rq/addRequest", "pkg::srv::dds_::Add_Request_", "rr/addReply", "pkg::srv::dds_::Add_Response_"
)


@pytest.fixture
def middleware(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "rclpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    one = open_middleware("auto")
    yield one
    one.close()


def serve_and_call(node, middleware):
    """A request from one end to the other, by dds."""
    asked = []
    replier = node.create_replier(SERVICE, QoSProfile(), lambda: asked.extend(replier.take(9)))
    requester = node.create_requester(SERVICE, QoSProfile(), lambda: None)
    assert requester.request(b"\0\1\0\0\5\0\0\0") == 1
    deadline = time.monotonic() + 10
    while not asked:
        middleware.dispatch_local()
        left = deadline - time.monotonic()
        assert left > 0, "no request comes"
        if not asked and select.select([middleware.fileno()], [], [], min(left, 1))[0]:
            middleware.dispatch()
    return asked[0][2]


def test_services_go_over_dds_and_the_user_hears_of_it_once(middleware, own_domain_id):
    told = []
    middleware.on_notice = told.append
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", "std_msgs::msg::dds_::String_", QoSProfile())
    assert told == []  # who has no services needs no rclpy
    assert serve_and_call(node, middleware) == b"\0\1\0\0\5\0\0\0"
    (notice,) = told
    assert "get no answers" in notice and "rclpy" in notice
    assert "source /opt/ros/<distro>/setup.bash" in notice and "pip install" in notice


def test_rmw_cyclonedds_is_spoken_by_dds_and_that_is_no_news(
    middleware, own_domain_id, monkeypatch
):
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    told = []
    middleware.on_notice = told.append
    node = middleware.create_node(own_domain_id, "/", "node")
    assert serve_and_call(node, middleware) == b"\0\1\0\0\5\0\0\0"
    assert told == []


def test_nobody_need_listen_to_notices(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    assert serve_and_call(node, middleware)


def test_the_same_is_told_once_and_not_without_end(middleware, monkeypatch):
    monkeypatch.setattr(base, "_MAX_NOTICES", 3)
    told = []
    middleware.on_notice = told.append
    for text in "aabcbdea":
        middleware.notice(text)
    assert told == ["a", "b", "c"]


def test_what_is_set_before_the_first_node_is_for_dds_too(middleware, own_domain_id):
    conflicts = []
    middleware.on_type_conflict = lambda *about: conflicts.append(about)
    middleware.batching = True
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", "std_msgs::msg::dds_::String_", QoSProfile())
    other = DdsMiddleware()
    there = other.create_node(own_domain_id, "/", "there")
    there.create_writer("rt/chatter", "std_msgs::msg::dds_::Int32_", QoSProfile())
    deadline = time.monotonic() + 10
    while not conflicts:
        assert time.monotonic() < deadline, "the conflict is not told"
        if select.select([middleware.fileno()], [], [], 0.1)[0]:
            middleware.dispatch()
        middleware.tick()
    assert conflicts[0][0] == "rt/chatter"
    assert middleware.dds.batching
    other.close()


def test_a_failing_dds_does_not_keep_ros2_from_its_turn(middleware, monkeypatch):
    class Ros2:
        turns = 0

        def dispatch(self):
            self.turns += 1

        def close(self):
            pass

    def fail():
        raise MiddlewareError("a client's fault")

    middleware._ros = Ros2()
    monkeypatch.setattr(middleware.dds, "dispatch", fail)
    with pytest.raises(MiddlewareError, match="a client's fault"):
        middleware.dispatch()
    assert middleware._ros.turns == 1


def test_work_of_ros2_sets_the_descriptor_that_dds_clears(middleware):
    """dispatch_local makes the shared descriptor unreadable."""

    class Ros2:
        def has_work(self):
            return True

        def close(self):
            pass

    middleware._ros = Ros2()
    middleware.dispatch_local()
    assert select.select([middleware.fileno()], [], [], 0)[0]
