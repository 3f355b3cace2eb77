"""Tests of the ros2 middleware; test_ros2_middleware.py runs them, with rclpy's interpreter."""

import resource
import select
import signal
import sys
import time
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.signals import default_signals

from uros.middleware import open_middleware
from uros.middleware import ros_names as names
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.ros2 import endpoints, rcl, types
from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

SECONDS = 10.0
STRING = "std_msgs::msg::dds_::String_"
TRIGGER = Service(
    "rq/triggerRequest", "std_srvs::srv::dds_::Trigger_Request_",
    "rr/triggerReply", "std_srvs::srv::dds_::Trigger_Response_",
)  # fmt: skip
SET = Service(
    "rq/setRequest", "std_srvs::srv::dds_::SetBool_Request_",
    "rr/setReply", "std_srvs::srv::dds_::SetBool_Response_",
)  # fmt: skip
PARAMETERS = Service(
    "rq/parametersRequest", "rcl_interfaces::srv::dds_::SetParameters_Request_",
    "rr/parametersReply", "rcl_interfaces::srv::dds_::SetParameters_Response_",
)  # fmt: skip
REQUEST = b"\0\1\0\0\0"
REPLY = b"\0\1\0\0\1\0\0\0\3\0\0\0ok\0"
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


@pytest.fixture
def ros2():
    middleware = open_middleware("ros2")
    yield middleware
    middleware.close()


def until(middleware, done, seconds=SECONDS):
    deadline = time.monotonic() + seconds
    while not done():
        left = deadline - time.monotonic()
        assert left > 0, "the condition is not reached in time"
        due = middleware.next_deadline()
        if due is not None:
            left = min(left, max(0.0, due - time.monotonic()))
        if select.select([middleware.fileno()], [], [], left)[0]:
            middleware.dispatch()
        middleware.tick()


class Taker:
    """An endpoint whose listener takes all samples, unless ``take`` is False."""

    def __init__(self, make, *arguments, take=True):
        self.taken = []
        self.calls = 0
        self.take = take
        self.end = None
        self.end = make(*arguments, QoSProfile(), self.ready)

    def ready(self):
        self.calls += 1
        if self.take and self.end is not None:
            self.taken.extend(self.end.take(100))


# --- types ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("type_name", "text"),
    [
        ("my_robot::msg::dds_::Arm_", r"my_robot/msg/Arm: .*no package my_robot.*my-robot"),
        ("std_msgs::msg::dds_::Strong_", r"std_msgs/msg/Strong: .*has no such type"),
        ("std_msgs::srv::dds_::String_", r"std_msgs/srv/String: .*cannot be loaded"),
        ("std_srvs::srv::dds_::Trigger_", r"std_srvs/srv/Trigger: .*has no such type"),
        ("plain", r"'plain' is no ROS type"),
        ("antigravity::msg::dds_::Fly_", r"antigravity/msg/Fly: .*no package antigravity"),
        ("wsgiref::msg::dds_::Serve_", r"wsgiref/msg/Serve: .*no package wsgiref"),
    ],
)
def test_a_missing_type_is_refused_by_name(ros2, own_domain_id, type_name, text):
    node = ros2.create_node(own_domain_id, "/", "node")
    with pytest.raises(MiddlewareError, match=text):
        node.create_writer("rt/chatter", type_name, QoSProfile())
    with pytest.raises(MiddlewareError, match=text):
        node.create_reader("rt/chatter", type_name, QoSProfile(), lambda: None)
    assert not {"antigravity", "wsgiref"} & set(sys.modules)


def test_a_message_type_is_refused_as_a_service():
    with pytest.raises(types.UnknownType, match="std_msgs/msg/String"):
        types.find_service(names.TypeName("std_msgs", "msg", "String"))


def test_the_services_and_topics_of_an_action(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "actor")
    base = "test_msgs::action::dds_::Fibonacci_"
    for part in ("SendGoal", "GetResult"):
        topic = f"fibonacci/_action/{part}"
        node.create_replier(
            Service(
                f"rq/{topic}Request", f"{base}{part}_Request_",
                f"rr/{topic}Reply", f"{base}{part}_Response_",
            ),
            QoSProfile(), lambda: None,
        )  # fmt: skip
    feedback = "rt/fibonacci/_action/feedback", base + "FeedbackMessage_"
    heard = Taker(node.create_reader, *feedback)
    sample = b"\0\1\0\0" + bytes(range(16)) + b"\1\0\0\0\7\0\0\0"
    node.create_writer(*feedback, QoSProfile()).write(sample)
    until(ros2, lambda: heard.taken)
    assert heard.taken == [sample]


@pytest.mark.parametrize("topic", ["chatter", "rt/", "rt/~/x", "rt/{node}/x", "rt//x", "rq/xReply"])
def test_a_topic_without_a_ros_name_is_refused(ros2, own_domain_id, topic):
    node = ros2.create_node(own_domain_id, "/", "node")
    with pytest.raises(MiddlewareError, match="is no ROS topic .*-m dds"):
        node.create_writer(topic, STRING, QoSProfile())


# --- QoS --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (QoSProfile(partitions=("a",)), "partitions"),
        (QoSProfile(ownership_exclusive=True), "ownership"),
        (QoSProfile(ownership_strength=3), "ownership"),
        (QoSProfile(separation_ms=5), "least time"),
        (QoSProfile(durability=DurabilityPolicy.PERSISTENT), "durability"),
    ],
)
def test_a_profile_that_ros_lacks_is_refused(ros2, own_domain_id, qos, text):
    node = ros2.create_node(own_domain_id, "/", "node")
    with pytest.raises(MiddlewareError, match=f"ROS 2 has no .*{text}.*-m dds"):
        node.create_writer("rt/chatter", STRING, qos)


def test_a_profile_is_offered_unchanged(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    qos = QoSProfile(
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        deadline_ms=1500,
        lifespan_ms=2000,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_ms=3000,
    )
    node.create_writer("rt/chatter", STRING, qos)
    ask = rcl.load().rclpy_get_publishers_info_by_topic
    (info,) = ask(node.handle, "/chatter", False)
    profile = info["qos_profile"]
    assert (profile["reliability"], profile["durability"]) == (2, 1)
    assert profile["liveliness"] == LivelinessPolicy.MANUAL_BY_TOPIC
    assert [
        profile[name].nanoseconds // 1_000_000
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
    ] == [1500, 2000, 3000]


def test_a_node_has_the_boards_endpoints_and_nothing_else(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/garden", "gate")
    node.create_writer("rt/state", STRING, QoSProfile())
    implementation = rcl.load()
    for kind, expected in (
        ("publisher", [("/state", ["std_msgs/msg/String"])]),
        ("subscriber", []),
    ):
        ask = getattr(implementation, f"rclpy_get_{kind}_names_and_types_by_node")
        assert ask(node.handle, False, "gate", "/garden") == expected
    for kind in ("service", "client"):
        ask = getattr(implementation, f"rclpy_get_{kind}_names_and_types_by_node")
        assert ask(node.handle, "gate", "/garden") == []


@pytest.mark.parametrize(("variable", "value"), [("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")])
def test_a_client_limited_to_loopback_is_refused_where_the_network_is_open(
    ros2, own_domain_id, monkeypatch, variable, value
):
    assert ros2.create_node(own_domain_id, "/", "here", True) is not None
    monkeypatch.setenv(variable, value)
    with pytest.raises(MiddlewareError, match="ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"):
        ros2.create_node(own_domain_id, "/", "there", True)


# --- samples ----------------------------------------------------------------------


def test_big_endian_samples_and_requests_pass(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    heard = Taker(node.create_reader, "rt/chatter", STRING)
    big = b"\0\0\0\0\0\0\0\3hi\0\0"
    node.create_writer("rt/chatter", STRING, QoSProfile()).write(big)
    server, caller = (
        Taker(make, PARAMETERS) for make in (node.create_replier, node.create_requester)
    )
    caller.end.request(b"\0\0\0\0" + bytes(4))
    until(ros2, lambda: heard.taken and server.taken)
    assert heard.taken == [big]
    assert server.taken[0][2] == b"\0\1\0\0" + bytes(4)
    assert server.end.reply(*server.taken[0][:2], b"\0\0\0\0\0\0\0\1\1\0\0\0\0\0\0\3ok\0")
    until(ros2, lambda: caller.taken)
    assert caller.taken[0][1][:19] == b"\0\1\0\0\1\0\0\0\1\0\0\0\3\0\0\0ok\0"


@pytest.fixture(scope="module")
def parameter_ends():
    from conftest import leased_domain

    with leased_domain() as domain:
        middleware = open_middleware("ros2")
        node = middleware.create_node(domain, "/", "node")
        server = Taker(node.create_replier, PARAMETERS)
        caller = Taker(node.create_requester, PARAMETERS)
        yield middleware, server, caller
        middleware.close()


@settings(max_examples=300, deadline=None)
@given(body=st.binary(max_size=80), head=st.sampled_from([b"\0\0\0\0", b"\0\1\0\0", b"\0\7\0\0"]))
def test_any_bytes_are_a_request_or_refused(parameter_ends, body, head):
    middleware, server, caller = parameter_ends
    before = len(server.taken)
    try:
        sent = caller.end.request(head + body)
        server.end.reply(bytes(16), 1, head + body)
    except MiddlewareError as error:
        assert "does not read as its type" in str(error)
        return
    assert sent
    until(middleware, lambda: len(server.taken) > before)


def test_a_sample_that_does_not_fit_its_type_is_refused(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    writer = node.create_writer("rt/number", "std_msgs::msg::dds_::Int32_", KEEP_ALL)
    with pytest.raises(MiddlewareError, match="topic /number"):
        writer.write(b"\0\1\0\0" + bytes(1000))
    assert writer.write(b"\0\1\0\0" + bytes(4))


def test_a_full_writer_refuses_without_waiting(ros2, own_domain_id):
    """Fast DDS keeps 5000 samples at each end."""
    node = ros2.create_node(own_domain_id, "/", "node")
    reader = node.create_reader("rt/chatter", STRING, KEEP_ALL, lambda: None)
    writer = node.create_writer("rt/chatter", STRING, KEEP_ALL)
    sample = b"\0\1\0\0\3\0\0\0hi\0\0"
    for _ in range(50_000):
        started = time.monotonic()
        if not writer.write(sample):
            break
    else:
        raise AssertionError("there is always room")
    assert time.monotonic() - started < 1
    assert len(reader.take(100_000)) == 5000


# --- services ---------------------------------------------------------------------


def test_the_oldest_unanswered_requests_are_dropped(ros2, own_domain_id, monkeypatch):
    monkeypatch.setattr(endpoints, "MAX_UNANSWERED", 3)
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    caller = Taker(node.create_requester, TRIGGER)
    for number in range(5):
        assert caller.end.request(REQUEST) == number + 1
        until(ros2, lambda number=number: len(server.taken) > number)
    for guid, sequence, _ in server.taken:
        assert server.end.reply(guid, sequence, REPLY)
        assert server.end.reply(guid, sequence, REPLY)  # a second reply is dropped
    until(ros2, lambda: len(caller.taken) == 3)
    assert [number for number, _ in caller.taken] == [3, 4, 5]


def test_requests_that_are_not_taken_use_no_cpu_time(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER, take=False)
    caller = Taker(node.create_requester, TRIGGER)
    caller.end.request(REQUEST)
    until(ros2, lambda: server.calls)
    used = resource.getrusage(resource.RUSAGE_SELF)
    assert not select.select([ros2.fileno()], [], [], 0.5)[0]
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime < 0.1
    assert server.calls == 1
    server.take = True
    server.ready()
    caller.end.request(REQUEST)
    until(ros2, lambda: len(server.taken) == 2)


def test_many_clients_of_a_service_get_their_own_replies(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, SET)
    callers = [Taker(node.create_requester, SET) for _ in range(8)]
    for index, caller in enumerate(callers):
        caller.end.request(b"\0\1\0\0" + bytes((index & 1,)))
    until(ros2, lambda: len(server.taken) == len(callers))
    for guid, sequence, request in server.taken:
        server.end.reply(guid, sequence, b"\0\1\0\0" + request[4:5] + bytes(3) + b"\1\0\0\0\0")
    until(ros2, lambda: all(caller.taken for caller in callers))
    for index, caller in enumerate(callers):
        ((number, reply),) = caller.taken
        assert (number, reply[4]) == (1, index & 1)


def test_replies_to_other_clients_are_skipped(ros2, own_domain_id):
    """All clients of a service receive all replies; for a reply to another client, rcl's take
    returns nothing, and the next reply is taken."""
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    first, second = (Taker(node.create_requester, TRIGGER, take=False) for _ in range(2))
    for _ in range(4):
        second.end.request(REQUEST)
    until(ros2, lambda: len(server.taken) == 4)
    first.end.request(REQUEST)
    until(ros2, lambda: len(server.taken) == 5)
    for guid, sequence, _ in server.taken:
        server.end.reply(guid, sequence, REPLY)
    assert [number for number, _ in first.end.take(100)] == [1]
    assert [number for number, _ in second.end.take(2)] == [1, 2]
    assert [number for number, _ in second.end.take(100)] == [3, 4]


def test_endpoints_that_are_closed_while_a_thread_waits_for_them(ros2, own_domain_id):
    """An endpoint is removed from the wait set first: rcl must not wait for freed memory."""
    for round_ in range(100):
        node = ros2.create_node(own_domain_id, "/", f"node{round_ % 3}")
        server = Taker(node.create_replier, TRIGGER)
        caller = Taker(node.create_requester, TRIGGER)
        caller.end.request(REQUEST)
        if round_ % 2:
            until(ros2, lambda server=server: server.taken)
            server.end.reply(*server.taken[0][:2], REPLY)
        (server if round_ % 3 else caller).end.close()
        node.close()


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_boards_whose_nodes_have_the_same_name(ros2, own_domain_id, order):
    """Services of nodes with one name still work when any of the nodes is closed.

    Fast DDS's graph looks a node up by its name, and finds the first of that name.
    """
    nodes = [ros2.create_node(own_domain_id, "/", "same") for _ in range(3)]
    servers = [Taker(node.create_replier, TRIGGER) for node in nodes]
    caller = Taker(ros2.create_node(own_domain_id, "/", "caller").create_requester, TRIGGER)
    caller.end.request(REQUEST)
    until(ros2, lambda: all(server.taken for server in servers))
    for closed, index in enumerate(order, 1):
        nodes[index].close()
        caller.end.request(REQUEST)
        left = [servers[index] for index in order[closed:]]
        until(ros2, lambda closed=closed, left=left: all(len(s.taken) > closed for s in left))


# --- the process ------------------------------------------------------------------


def test_rclpy_leaves_signal_handlers_unchanged(ros2, own_domain_id):
    with default_signals():
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        node = ros2.create_node(own_domain_id, "/", "node")
        node.create_replier(TRIGGER, QoSProfile(), lambda: None)
        for number, handler in handlers.items():
            assert signal.getsignal(number) is handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_context_that_is_shut_down_is_an_error_with_the_remedy(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    node.domain.context.shutdown()
    node.domain.resume(server.end._listener)  # makes the thread wait again
    with pytest.raises(MiddlewareError, match="delivers nothing more .*start the agent again"):
        until(ros2, lambda: False, 2)


def test_closing_causes_no_runtime_warning(own_domain_id):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        middleware = open_middleware("ros2")
        node = middleware.create_node(own_domain_id, "/", "node")
        node.create_writer("rt/chatter", STRING, QoSProfile())
        node.create_replier(TRIGGER, QoSProfile(), lambda: None)
        node.create_requester(TRIGGER, QoSProfile(), lambda: None)
        middleware.close()
        middleware.close()
    assert [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)] == []
