"""The auto middleware where rclpy cannot be imported: services by dds, and one notice.

With rclpy, tests/interop tests it.
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
    auto_middleware = open_middleware("auto")
    yield auto_middleware
    auto_middleware.close()


def serve_and_call(node, middleware):
    """Send a request from one endpoint to the other over DDS."""
    requests = []
    replier = node.create_replier(SERVICE, QoSProfile(), lambda: requests.extend(replier.take(9)))
    requester = node.create_requester(SERVICE, QoSProfile(), lambda: None)
    assert requester.request(b"\0\1\0\0\5\0\0\0") == 1
    deadline = time.monotonic() + 10
    while not requests:
        middleware.dispatch_local()
        seconds_left = deadline - time.monotonic()
        assert seconds_left > 0, "no request comes"
        if not requests and select.select([middleware.fileno()], [], [], min(seconds_left, 1))[0]:
            middleware.dispatch()
    return requests[0][2]


def test_services_go_over_dds_with_one_notice(middleware, own_domain_id):
    notices = []
    middleware.on_notice = notices.append
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", "std_msgs::msg::dds_::String_", QoSProfile())
    assert notices == []  # a node without services needs no rclpy
    assert serve_and_call(node, middleware) == b"\0\1\0\0\5\0\0\0"
    (notice,) = notices
    assert "get no answers" in notice and "rclpy" in notice
    assert "source /opt/ros/<distro>/setup.bash" in notice and "pip install" in notice


def test_rmw_cyclonedds_is_served_by_dds_without_a_notice(middleware, own_domain_id, monkeypatch):
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    notices = []
    middleware.on_notice = notices.append
    node = middleware.create_node(own_domain_id, "/", "node")
    assert serve_and_call(node, middleware) == b"\0\1\0\0\5\0\0\0"
    assert notices == []


def test_notices_need_no_listener(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    assert serve_and_call(node, middleware)


def test_equal_notices_are_sent_once_and_their_number_is_limited(middleware, monkeypatch):
    monkeypatch.setattr(base, "_MAX_NOTICES", 3)
    notices = []
    middleware.on_notice = notices.append
    for text in "aabcbdea":
        middleware.notice(text)
    assert notices == ["a", "b", "c"]


def test_settings_made_before_the_first_node_apply_to_dds(middleware, own_domain_id):
    conflicts = []
    middleware.on_type_conflict = lambda *about: conflicts.append(about)
    middleware.batching = True
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_writer("rt/chatter", "std_msgs::msg::dds_::String_", QoSProfile())
    other_middleware = DdsMiddleware()
    other_node = other_middleware.create_node(own_domain_id, "/", "there")
    other_node.create_writer("rt/chatter", "std_msgs::msg::dds_::Int32_", QoSProfile())
    deadline = time.monotonic() + 10
    while not conflicts:
        assert time.monotonic() < deadline, "the conflict is not told"
        if select.select([middleware.fileno()], [], [], 0.1)[0]:
            middleware.dispatch()
        middleware.tick()
    assert conflicts[0][0] == "rt/chatter"
    assert middleware.dds.batching
    other_middleware.close()


def test_ros2_is_served_although_dds_fails(middleware, monkeypatch):
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
