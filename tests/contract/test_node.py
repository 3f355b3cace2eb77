"""The contract of nodes: with a middleware of their own, and with a session at an agent."""

import pytest
from support.nodes import KINDS, MESSAGES, Int32, String, nodes_of

from uros.interfaces import load
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

Trigger = load("std_srvs/srv/Trigger")
GetParameterTypes = load("rcl_interfaces/srv/GetParameterTypes")


@pytest.fixture(params=KINDS)
def nodes(request, own_domain_id):
    with nodes_of(request.param, own_domain_id) as made:
        yield made


def numbers(*values):
    return [Int32(data=value) for value in values]


# --- topics ----------------------------------------------------------------------------


@pytest.mark.parametrize("type", MESSAGES, ids=lambda type: type.__name__)
def test_messages_arrive_whole_and_in_order(nodes, type):
    received = []
    nodes("listener").create_subscription(type, "/x", received.append)
    publisher = nodes("talker").create_publisher(type, "/x")
    nodes.connect()
    for message in MESSAGES[type]:
        # Not always at once: a board's queue to the agent has room for two images.
        nodes.until(lambda message=message: publisher.publish(message) is True)
    nodes.until(lambda: len(received) == len(MESSAGES[type]))
    assert received == MESSAGES[type]
    assert publisher.published == len(received)


def test_a_node_receives_its_own_messages(nodes):
    node = nodes("alone")
    received = []
    node.create_subscription(Int32, "/x", received.append, 10)
    publisher = node.create_publisher(Int32, "/x", 10)
    nodes.connect()
    for message in numbers(1, 2, 3):
        assert publisher.publish(message)
    nodes.until(lambda: len(received) == 3)
    assert received == numbers(1, 2, 3)


def test_names_are_resolved_as_in_ros(nodes):
    node = nodes("weather", namespace="/garden")
    assert node.get_fully_qualified_name() == "/garden/weather"
    received = []
    for name in ("/garden/near", "/far", "/garden/weather/own"):
        node.create_subscription(
            String, name, lambda message, name=name: received.append((name, message.data))
        )
    publishers = [node.create_publisher(String, name) for name in ("near", "/far", "~/own")]
    nodes.connect()
    for publisher in publishers:
        assert publisher.publish(String(data=publisher.name))
    nodes.until(lambda: len(received) == 3)
    assert sorted(received) == [(name, name) for name in sorted(entry[0] for entry in received)]


def test_best_effort_on_both_ends(nodes):
    qos = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
    received = []
    nodes("listener").create_subscription(Int32, "/x", received.append, qos)
    publisher = nodes("talker").create_publisher(Int32, "/x", qos)
    nodes.connect()
    assert publisher.publish(Int32(data=5))
    nodes.until(lambda: received)
    assert received == numbers(5)


def test_a_reliable_subscription_does_not_match_a_best_effort_publisher(nodes):
    qos = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
    received = []
    nodes("listener").create_subscription(Int32, "/x", received.append)
    publisher = nodes("talker").create_publisher(Int32, "/x", qos)
    nodes.connect()
    assert publisher.publish(Int32(data=5))
    nodes.settle()
    assert received == []


def test_a_late_transient_local_subscription_gets_the_last_messages(nodes):
    latched = QoSProfile(2, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    talker, listener = nodes("talker"), nodes("listener")
    publisher = talker.create_publisher(Int32, "/x", latched)
    nodes.connect()
    for message in numbers(1, 2, 3):
        assert publisher.publish(message)
    nodes.settle()
    received = []
    listener.create_subscription(Int32, "/x", received.append, latched)
    nodes.until(lambda: len(received) == 2)
    assert received == numbers(2, 3)


def test_a_message_of_another_type_is_refused(nodes):
    publisher = nodes("talker").create_publisher(Int32, "/x")
    nodes.connect()
    with pytest.raises(TypeError, match="std_msgs/msg/String"):
        publisher.publish(String())


def test_an_invalid_value_is_refused_and_not_published(nodes):
    received = []
    node = nodes("alone")
    node.create_subscription(Int32, "/x", received.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    with pytest.raises((ValueError, TypeError), match="data"):
        publisher.publish(Int32(data="one"))
    assert publisher.publish(Int32(data=1))
    nodes.until(lambda: received)
    assert received == numbers(1)


# --- services -----------------------------------------------------------------------------


def request_of(*names):
    return GetParameterTypes.Request(names=list(names))


def lengths(request, response):
    """A service with arrays in request and response; it fails without a name."""
    assert request.names, "nothing asked"
    response.types = bytes(len(name) for name in request.names)
    return response


def test_a_service_answers(nodes):
    nodes("server").create_service(GetParameterTypes, "/lengths", lengths)
    client = nodes("asker").create_client(GetParameterTypes, "/lengths")
    nodes.connect()
    called = []
    future = client.call_async(request_of("", "two", "three"))
    future.add_done_callback(lambda done: called.append(bytes(done.result().types)))
    assert future.result() is None
    nodes.until(future.done)
    assert called == [bytes(future.result().types)] == [b"\0\3\5"]


def test_each_client_gets_the_responses_to_its_requests(nodes):
    nodes("server").create_service(GetParameterTypes, "/lengths", lengths)
    clients = [nodes(f"asker{i}").create_client(GetParameterTypes, "/lengths") for i in range(2)]
    nodes.connect()
    futures = {
        (i, n): clients[i].call_async(request_of("x" * i, "x" * n))
        for n in range(5)
        for i in range(2)
    }
    nodes.until(lambda: all(future.done() for future in futures.values()))
    assert {key: tuple(future.result().types) for key, future in futures.items()} == {
        key: key for key in futures
    }


def test_an_empty_request_and_a_node_that_calls_its_own_service(nodes):
    node = nodes("both")

    def pull(request, response):
        response.success, response.message = True, "done"
        return response

    node.create_service(Trigger, "pull", pull)
    client = node.create_client(Trigger, "/pull")
    nodes.connect()
    future = client.call_async(Trigger.Request())
    assert node.spin_until_future_complete(future)
    assert (future.result().success, future.result().message) == (True, "done")


def test_a_service_that_fails_answers_the_next_request(nodes, capsys):
    server = nodes("server")
    server.create_service(GetParameterTypes, "/lengths", lengths)
    client = nodes("asker").create_client(GetParameterTypes, "/lengths")
    nodes.connect()
    failing = client.call_async(request_of())
    nodes.until(lambda: server.executor.failed == 1)
    assert "AssertionError: nothing asked" in capsys.readouterr().err
    future = client.call_async(request_of("one"))
    nodes.until(future.done)
    assert list(future.result().types) == [3]
    assert not failing.done()
    client.remove_pending_request(failing)


def test_a_call_without_a_service_times_out(nodes):
    node = nodes("asker")
    client = node.create_client(Trigger, "/nobody")
    nodes.connect()
    future = client.call_async(Trigger.Request())
    assert not node.spin_until_future_complete(future, 0.02)


# --- callbacks ------------------------------------------------------------------------------


def test_timers_run_in_time_and_in_order_of_creation(nodes):
    node = nodes("clock")
    nodes.connect()
    ran = []
    start = node.clock.ms()
    for name, period in (("a", 0.02), ("b", 0.01), ("c", 0.02)):
        node.create_timer(period, lambda name=name: ran.append((name, node.clock.ms())))
    nodes.until(lambda: [name for name, _ in ran].count("c") == 3)
    names = "".join(name for name, _ in ran)
    assert names.replace("b", "") == "acacac"
    for name, period in (("a", 20), ("b", 10)):
        times = [at - start for timer, at in ran if timer == name]
        assert all(at >= (i + 1) * period for i, at in enumerate(times)), times


def test_a_timer_publishes_until_it_is_canceled(nodes):
    node = nodes("clock")
    received = []
    node.create_subscription(Int32, "/x", received.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()

    def tick():
        publisher.publish(Int32(data=publisher.published))
        if publisher.published == 3:
            timer.cancel()

    timer = node.create_timer(0.01, tick)
    nodes.until(lambda: len(received) == 3)
    assert received == numbers(0, 1, 2)
    assert timer.is_canceled()
    nodes.settle()
    assert len(received) == 3


def test_an_error_in_a_callback_is_printed_and_the_node_continues(nodes, capsys):
    node = nodes("node")
    received = []

    def fail(message):
        received.append(message.data)
        raise ValueError("no good")

    node.create_subscription(Int32, "/x", fail)
    others_received = []
    node.create_subscription(Int32, "/x", others_received.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    for message in numbers(1, 2):
        assert publisher.publish(message)
    nodes.until(lambda: len(received) == len(others_received) == 2)
    assert received == [1, 2] and others_received == numbers(1, 2)
    assert node.executor.failed == 2
    assert capsys.readouterr().err.count("ValueError: no good") == 2


def test_on_state_reports_the_connection_once(nodes):
    node = nodes("node")
    states = []
    node.on_state = states.append
    nodes.connect()
    nodes.until(lambda: states and states[-1] == node.state)
    nodes.settle()
    assert states.count(node.state) == 1


# --- the end ----------------------------------------------------------------------------------


def test_a_destroyed_subscription_receives_nothing(nodes):
    node = nodes("node")
    received, others_received = [], []
    subscription = node.create_subscription(Int32, "/x", received.append)
    node.create_subscription(Int32, "/x", others_received.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    assert publisher.publish(Int32(data=1))
    nodes.until(lambda: received and others_received)
    subscription.destroy()
    assert publisher.publish(Int32(data=2))
    nodes.until(lambda: len(others_received) == 2)
    assert received == numbers(1)


def test_a_destroyed_publisher_sends_nothing(nodes):
    node = nodes("node")
    received = []
    node.create_subscription(Int32, "/x", received.append)
    first, second = [node.create_publisher(Int32, "/x") for _ in range(2)]
    nodes.connect()
    assert first.publish(Int32(data=1))
    first.destroy()
    assert first.publish(Int32(data=2)) is False and first.dropped == 1
    assert second.publish(Int32(data=3))
    nodes.until(lambda: len(received) == 2)
    assert received == numbers(1, 3)


def test_a_subscription_may_be_destroyed_by_its_callback(nodes):
    node = nodes("node")
    received = []

    def once(message):
        received.append(message)
        subscription.destroy()

    subscription = node.create_subscription(Int32, "/x", once)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    for message in numbers(1, 2):
        assert publisher.publish(message)
    nodes.settle()
    assert received == numbers(1)


def test_a_destroyed_node_is_silent_and_other_nodes_continue(nodes):
    first, second, listener = nodes("first"), nodes("second"), nodes("listener")
    received = []
    listener.create_subscription(Int32, "/x", received.append)
    publishers = [node.create_publisher(Int32, "/x") for node in (first, second)]
    nodes.connect()
    assert all(publisher.publish(Int32(data=1)) for publisher in publishers)
    nodes.until(lambda: len(received) == 2)
    nodes.made.remove(first)
    first.destroy_node()
    first.destroy_node()
    assert publishers[0].publish(Int32(data=2)) is False
    assert publishers[0].dropped == 1
    assert publishers[1].publish(Int32(data=3))
    nodes.until(lambda: len(received) == 3)
    assert received[2] == Int32(data=3)


def test_spin_ends_when_a_callback_destroys_the_node(nodes):
    node = nodes("node")
    nodes.connect()
    nodes.made.remove(node)
    node.create_timer(0.001, node.destroy_node)
    node.spin()
