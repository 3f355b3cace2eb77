"""The ros2 middleware and its part of auto, where rclpy is: test_ros2_middleware.py runs this."""

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
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.ros2 import endpoints, rcl, types
from uros.middleware.services.pending_endpoints import PendingEndpoint
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


@pytest.fixture(params=["ros2", "auto"])
def either(request):
    one = open_middleware(request.param)
    yield one
    one.close()


@pytest.fixture
def ros2():
    one = open_middleware("ros2")
    yield one
    one.close()


@pytest.fixture
def auto():
    one = open_middleware("auto")
    yield one
    one.close()


def until(middleware, done, seconds=SECONDS):
    deadline = time.monotonic() + seconds
    while not done():
        left = deadline - time.monotonic()
        assert left > 0, "it does not come"
        due = middleware.next_deadline()
        if due is not None:
            left = min(left, max(0.0, due - time.monotonic()))
        if select.select([middleware.fileno()], [], [], left)[0]:
            middleware.dispatch()
        middleware.tick()


class Taker:
    """An end that takes what comes."""

    def __init__(self, make, *arguments, take=True):
        self.got = []
        self.calls = 0
        self.take = take
        self.end = None
        self.end = make(*arguments, QoSProfile(), self.ready)

    def ready(self):
        self.calls += 1
        if self.take and self.end is not None:
            self.got.extend(self.end.take(100))


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
def test_a_type_that_is_not_there_is_refused_by_name(ros2, own_domain_id, type_name, text):
    node = ros2.create_node(own_domain_id, "/", "node")
    with pytest.raises(MiddlewareError, match=text):
        node.create_writer("rt/chatter", type_name, QoSProfile())
    with pytest.raises(MiddlewareError, match=text):
        node.create_reader("rt/chatter", type_name, QoSProfile(), lambda: None)
    assert not {"antigravity", "wsgiref"} & set(sys.modules)


def test_a_message_is_no_service():
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
    until(ros2, lambda: heard.got)
    assert heard.got == [sample]


@pytest.mark.parametrize("topic", ["chatter", "rt/", "rt/~/x", "rt/{node}/x", "rt//x", "rq/xReply"])
def test_a_topic_that_is_not_ross_is_refused(ros2, own_domain_id, topic):
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
def test_a_profile_beyond_ross_is_refused(ros2, own_domain_id, qos, text):
    node = ros2.create_node(own_domain_id, "/", "node")
    with pytest.raises(MiddlewareError, match=f"ROS 2 has no .*{text}.*-m dds"):
        node.create_writer("rt/chatter", STRING, qos)


def test_a_profile_is_offered_as_it_is(ros2, own_domain_id):
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
    seen = info["qos_profile"]
    assert (seen["reliability"], seen["durability"]) == (2, 1)
    assert seen["liveliness"] == LivelinessPolicy.MANUAL_BY_TOPIC
    assert [
        seen[name].nanoseconds // 1_000_000
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
    ] == [1500, 2000, 3000]


def test_a_node_has_what_the_board_has_and_nothing_else(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/garden", "gate")
    node.create_writer("rt/state", STRING, QoSProfile())
    implementation = rcl.load()
    for what, expected in (
        ("publisher", [("/state", ["std_msgs/msg/String"])]),
        ("subscriber", []),
    ):
        ask = getattr(implementation, f"rclpy_get_{what}_names_and_types_by_node")
        assert ask(node.handle, False, "gate", "/garden") == expected
    for what in ("service", "client"):
        ask = getattr(implementation, f"rclpy_get_{what}_names_and_types_by_node")
        assert ask(node.handle, "gate", "/garden") == []


@pytest.mark.parametrize(("variable", "value"), [("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")])
def test_a_client_that_must_stay_here_is_refused_where_the_network_is_open(
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
    until(ros2, lambda: heard.got and server.got)
    assert heard.got == [big]
    assert server.got[0][2] == b"\0\1\0\0" + bytes(4)
    assert server.end.reply(*server.got[0][:2], b"\0\0\0\0\0\0\0\1\1\0\0\0\0\0\0\3ok\0")
    until(ros2, lambda: caller.got)
    assert caller.got[0][1][:19] == b"\0\1\0\0\1\0\0\0\1\0\0\0\3\0\0\0ok\0"


@pytest.fixture(scope="module")
def parameter_ends():
    from conftest import leased_domain

    with leased_domain() as domain:
        one = open_middleware("ros2")
        node = one.create_node(domain, "/", "node")
        server = Taker(node.create_replier, PARAMETERS)
        caller = Taker(node.create_requester, PARAMETERS)
        yield one, server, caller
        one.close()


@settings(max_examples=300, deadline=None)
@given(body=st.binary(max_size=80), head=st.sampled_from([b"\0\0\0\0", b"\0\1\0\0", b"\0\7\0\0"]))
def test_any_bytes_are_a_request_or_refused(parameter_ends, body, head):
    one, server, caller = parameter_ends
    before = len(server.got)
    try:
        sent = caller.end.request(head + body)
        server.end.reply(bytes(16), 1, head + body)
    except MiddlewareError as error:
        assert "does not read as its type" in str(error)
        return
    assert sent
    until(one, lambda: len(server.got) > before)


def test_a_sample_that_does_not_fit_its_type_is_refused(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    writer = node.create_writer("rt/number", "std_msgs::msg::dds_::Int32_", KEEP_ALL)
    with pytest.raises(MiddlewareError, match="topic /number"):
        writer.write(b"\0\1\0\0" + bytes(1000))
    assert writer.write(b"\0\1\0\0" + bytes(4))


def test_a_writer_that_is_full_says_so_soon(ros2, own_domain_id):
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


def test_requests_that_nobody_answers_are_forgotten_from_the_oldest_on(
    ros2, own_domain_id, monkeypatch
):
    monkeypatch.setattr(endpoints, "MAX_UNANSWERED", 3)
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    caller = Taker(node.create_requester, TRIGGER)
    for number in range(5):
        assert caller.end.request(REQUEST) == number + 1
        until(ros2, lambda number=number: len(server.got) > number)
    for guid, sequence, _ in server.got:
        assert server.end.reply(guid, sequence, REPLY)
        assert server.end.reply(guid, sequence, REPLY)  # an answer too many is dropped
    until(ros2, lambda: len(caller.got) == 3)
    assert [number for number, _ in caller.got] == [3, 4, 5]


def test_requests_that_nobody_takes_cost_nothing(ros2, own_domain_id):
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
    until(ros2, lambda: len(server.got) == 2)


def test_many_clients_of_a_service_get_their_own_replies(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, SET)
    callers = [Taker(node.create_requester, SET) for _ in range(8)]
    for index, caller in enumerate(callers):
        caller.end.request(b"\0\1\0\0" + bytes((index & 1,)))
    until(ros2, lambda: len(server.got) == len(callers))
    for guid, sequence, request in server.got:
        server.end.reply(guid, sequence, b"\0\1\0\0" + request[4:5] + bytes(3) + b"\1\0\0\0\0")
    until(ros2, lambda: all(caller.got for caller in callers))
    for index, caller in enumerate(callers):
        ((number, reply),) = caller.got
        assert (number, reply[4]) == (1, index & 1)


def test_replies_to_others_are_passed_over(ros2, own_domain_id):
    """All clients of a service get all replies, and rcl says of those to others that there is
    none."""
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    first, second = (Taker(node.create_requester, TRIGGER, take=False) for _ in range(2))
    for _ in range(4):
        second.end.request(REQUEST)
    until(ros2, lambda: len(server.got) == 4)
    first.end.request(REQUEST)
    until(ros2, lambda: len(server.got) == 5)
    for guid, sequence, _ in server.got:
        server.end.reply(guid, sequence, REPLY)
    assert [number for number, _ in first.end.take(100)] == [1]
    assert [number for number, _ in second.end.take(2)] == [1, 2]
    assert [number for number, _ in second.end.take(100)] == [3, 4]


def test_ends_that_are_closed_while_a_thread_waits_for_them(either, own_domain_id):
    """Each is taken out of the wait set first: what rcl waits for must not be freed."""
    for round_ in range(100):
        node = either.create_node(own_domain_id, "/", f"node{round_ % 3}")
        server = Taker(node.create_replier, TRIGGER)
        caller = Taker(node.create_requester, TRIGGER)
        caller.end.request(REQUEST)
        if round_ % 2:
            until(either, lambda server=server: server.got)
            server.end.reply(*server.got[0][:2], REPLY)
        (server if round_ % 3 else caller).end.close()
        node.close()


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_boards_whose_nodes_have_the_same_name(either, own_domain_id, order):
    """Fast DDS's graph finds nodes by their names: the first of that name."""
    nodes = [either.create_node(own_domain_id, "/", "same") for _ in range(3)]
    servers = [Taker(node.create_replier, TRIGGER) for node in nodes]
    caller = Taker(either.create_node(own_domain_id, "/", "caller").create_requester, TRIGGER)
    caller.end.request(REQUEST)
    until(either, lambda: all(server.got for server in servers))
    assert len({guid for server in servers for guid in server.end.readers}) == 3
    for closed, index in enumerate(order, 1):
        nodes[index].close()
        caller.end.request(REQUEST)
        left = [servers[other] for other in order[closed:]]
        until(either, lambda closed=closed, left=left: all(len(it.got) > closed for it in left))


# --- the process ------------------------------------------------------------------


def test_signals_stay_ours(either, own_domain_id):
    with default_signals():
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        node = either.create_node(own_domain_id, "/", "node")
        node.create_replier(TRIGGER, QoSProfile(), lambda: None)
        for number, handler in handlers.items():
            assert signal.getsignal(number) is handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_context_that_somebody_shuts_down_is_told(ros2, own_domain_id):
    node = ros2.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    node.domain.context.shutdown()
    node.domain.resume(server.end._listener)  # whatever makes the thread look again
    with pytest.raises(MiddlewareError, match="delivers nothing more .*start the agent again"):
        until(ros2, lambda: False, 2)


def test_nothing_is_warned_of_at_the_end(own_domain_id):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        one = open_middleware("auto")
        node = one.create_node(own_domain_id, "/", "node")
        node.create_writer("rt/chatter", STRING, QoSProfile())
        node.create_replier(TRIGGER, QoSProfile(), lambda: None)
        node.create_requester(TRIGGER, QoSProfile(), lambda: None)
        one.close()
        one.close()
    assert [str(it.message) for it in said if issubclass(it.category, RuntimeWarning)] == []


# --- auto -------------------------------------------------------------------------


def test_the_boards_node_announces_the_services_and_no_more_when_they_go(auto, own_domain_id):
    watching = DdsMiddleware()
    seen = watching.graph(own_domain_id, lambda: None)

    def listed():
        def topics(gids):
            known = [seen.endpoints.get(gid) for gid in gids]
            return sorted("unknown" if end is None else end.topic for end in known)

        return {
            f"{node.namespace.rstrip('/')}/{node.name}": (
                topics(node.readers),
                topics(node.writers),
            )
            for nodes in seen.announced.values()
            for node in nodes
        }

    def wait(done):
        deadline = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < deadline, listed()
            auto.tick()
            watching.tick()
            if select.select([watching.fileno()], [], [], 0.02)[0]:
                watching.dispatch()

    node = auto.create_node(own_domain_id, "/garden", "gate")
    ends = [
        node.create_replier(TRIGGER, QoSProfile(), lambda: None),
        node.create_requester(SET, QoSProfile(), lambda: None),
    ]
    wait(
        lambda: (
            listed().get("/garden/gate")
            == (["rq/triggerRequest", "rr/setReply"], ["rq/setRequest", "rr/triggerReply"])
        )
    )
    ends[0].close()
    wait(lambda: listed().get("/garden/gate") == (["rr/setReply"], ["rq/setRequest"]))
    ends[1].close()
    wait(lambda: listed().get("/garden/gate") == ([], []))
    node.close()
    wait(lambda: "/garden/gate" not in listed() and "/garden/_gate" not in listed())
    watching.close()


def test_both_ends_of_a_node_are_told_apart(auto, own_domain_id):
    """Two servers of one name in one node: each announces its own endpoints."""
    node = auto.create_node(own_domain_id, "/", "twice")
    first, second = (node.create_replier(TRIGGER, QoSProfile(), lambda: None) for _ in range(2))
    assert len(first.readers) == len(second.readers) == len(first.writers) == 1
    assert first.readers != second.readers and first.writers != second.writers


# --- auto where it serves boards: rclpy is imported meanwhile ---------------------------


@pytest.fixture
def serving():
    one = open_middleware("auto")
    one.batching = True
    yield one
    one.close()


def test_ends_that_come_late_carry_requests_and_replies(serving, own_domain_id):
    node = serving.create_node(own_domain_id, "/", "node")
    server = Taker(node.create_replier, TRIGGER)
    caller = Taker(node.create_requester, TRIGGER)
    assert isinstance(server.end, PendingEndpoint) and caller.end.request(REQUEST) is None
    until(serving, lambda: caller.end.request(REQUEST))
    until(serving, lambda: server.got)
    for guid, sequence, _ in server.got:
        assert server.end.reply(guid, sequence, REPLY)
    until(serving, lambda: caller.got)
    ((number, answer),) = caller.got
    assert (number, answer[4], answer[8:]) == (1, 1, REPLY[8:])  # between them is padding
    other = Taker(node.create_replier, SET)  # another type: it is looked for anew
    assert isinstance(other.end, PendingEndpoint)
    assert not isinstance(Taker(node.create_replier, TRIGGER).end, PendingEndpoint)


def test_late_ends_are_announced_when_they_are_there(serving, own_domain_id):
    watching = DdsMiddleware()
    seen = watching.graph(own_domain_id, lambda: None)
    node = serving.create_node(own_domain_id, "/garden", "gate")
    end = node.create_replier(TRIGGER, QoSProfile(), lambda: None)

    def topics():
        nodes = [it for nodes in seen.announced.values() for it in nodes if it.name == "gate"]
        ours = [seen.endpoints.get(gid) for it in nodes for gid in (*it.readers, *it.writers)]
        return {it.topic for it in ours if it is not None}

    def wait(wanted):
        deadline = time.monotonic() + SECONDS
        while topics() != wanted:
            assert time.monotonic() < deadline, topics()
            for one in (serving, watching):
                if select.select([one.fileno()], [], [], 0.02)[0]:
                    one.dispatch()
                one.tick()

    wait({TRIGGER.request_topic, TRIGGER.reply_topic})
    end.close()
    wait(set())
    watching.close()


@pytest.mark.parametrize("turns", [0, 1, 2, 5])
def test_nodes_and_middlewares_that_go_while_ends_are_on_their_way(own_domain_id, turns):
    for round_ in range(10):
        one = open_middleware("auto")
        one.batching = True
        nodes = [one.create_node(own_domain_id, "/", f"node{i}") for i in range(3)]
        services = (TRIGGER, SET, PARAMETERS)
        ends = [
            Taker(make, service).end
            for node, service in zip(nodes, services, strict=True)
            for make in (node.create_replier, node.create_requester)
        ]
        for _ in range(turns):
            if select.select([one.fileno()], [], [], 0.1)[0]:
                one.dispatch()
        if round_ % 2:
            nodes[round_ % 3].close()
            ends[round_ % 6].close()
        if round_ % 3:
            one.close()
        for end in ends:
            end.close()
        one.close()


def test_a_type_that_the_package_lacks_comes_over_dds(serving, own_domain_id):
    told = []
    serving.on_notice = told.append
    node = serving.create_node(own_domain_id, "/", "node")
    jump = Service(
        "rq/jumpRequest", "std_srvs::srv::dds_::Jump_Request_",
        "rr/jumpReply", "std_srvs::srv::dds_::Jump_Response_",
    )  # fmt: skip
    caller = node.create_requester(jump, QoSProfile(), lambda: None)
    until(serving, lambda: caller.request(REQUEST))
    assert len(told) == 1 and "std_srvs/srv/Jump: package std_srvs has no such type" in told[0]
    assert len(node._dds._endpoints) == 2
