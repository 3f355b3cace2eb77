"""What a node does, whatever connects it: a middleware of its own, or a session with an agent."""

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
    came = []
    nodes("listener").create_subscription(type, "/x", came.append)
    publisher = nodes("talker").create_publisher(type, "/x")
    nodes.connect()
    for message in MESSAGES[type]:
        # Not always at once: two images are all that waits for an agent.
        nodes.until(lambda message=message: publisher.publish(message) is True)
    nodes.until(lambda: len(came) == len(MESSAGES[type]))
    assert came == MESSAGES[type]
    assert publisher.published == len(came)


def test_a_node_hears_itself(nodes):
    node = nodes("alone")
    came = []
    node.create_subscription(Int32, "/x", came.append, 10)
    publisher = node.create_publisher(Int32, "/x", 10)
    nodes.connect()
    for message in numbers(1, 2, 3):
        assert publisher.publish(message)
    nodes.until(lambda: len(came) == 3)
    assert came == numbers(1, 2, 3)


def test_names_are_resolved_as_in_ros(nodes):
    node = nodes("weather", namespace="/garden")
    assert node.get_fully_qualified_name() == "/garden/weather"
    came = []
    for name in ("/garden/near", "/far", "/garden/weather/own"):
        node.create_subscription(
            String, name, lambda message, name=name: came.append((name, message.data))
        )
    publishers = [node.create_publisher(String, name) for name in ("near", "/far", "~/own")]
    nodes.connect()
    for publisher in publishers:
        assert publisher.publish(String(data=publisher.name))
    nodes.until(lambda: len(came) == 3)
    assert sorted(came) == [(name, name) for name in sorted(it[0] for it in came)]


def test_best_effort_on_both_ends(nodes):
    qos = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
    came = []
    nodes("listener").create_subscription(Int32, "/x", came.append, qos)
    publisher = nodes("talker").create_publisher(Int32, "/x", qos)
    nodes.connect()
    assert publisher.publish(Int32(data=5))
    nodes.until(lambda: came)
    assert came == numbers(5)


def test_a_reliable_subscription_does_not_hear_a_best_effort_publisher(nodes):
    qos = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
    came = []
    nodes("listener").create_subscription(Int32, "/x", came.append)
    publisher = nodes("talker").create_publisher(Int32, "/x", qos)
    nodes.connect()
    assert publisher.publish(Int32(data=5))
    nodes.settle()
    assert came == []


def test_a_late_subscription_gets_what_is_kept_for_it(nodes):
    kept = QoSProfile(2, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    talker, listener = nodes("talker"), nodes("listener")
    publisher = talker.create_publisher(Int32, "/x", kept)
    nodes.connect()
    for message in numbers(1, 2, 3):
        assert publisher.publish(message)
    nodes.settle()
    came = []
    listener.create_subscription(Int32, "/x", came.append, kept)
    nodes.until(lambda: len(came) == 2)
    assert came == numbers(2, 3)


def test_a_message_of_another_type_is_refused(nodes):
    publisher = nodes("talker").create_publisher(Int32, "/x")
    nodes.connect()
    with pytest.raises(TypeError, match="std_msgs/msg/String"):
        publisher.publish(String())


def test_a_value_that_does_not_fit_is_refused_and_nothing_sent(nodes):
    came = []
    node = nodes("alone")
    node.create_subscription(Int32, "/x", came.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    with pytest.raises((ValueError, TypeError), match="data"):
        publisher.publish(Int32(data="one"))
    assert publisher.publish(Int32(data=1))
    nodes.until(lambda: came)
    assert came == numbers(1)


# --- services -----------------------------------------------------------------------------


def ask(*names):
    return GetParameterTypes.Request(names=list(names))


def lengths(request, response):
    """A service with an array either way; it fails where there is no name."""
    assert request.names, "nothing asked"
    response.types = bytes(len(name) for name in request.names)
    return response


def test_a_service_answers(nodes):
    nodes("server").create_service(GetParameterTypes, "/lengths", lengths)
    client = nodes("asker").create_client(GetParameterTypes, "/lengths")
    nodes.connect()
    called = []
    future = client.call_async(ask("", "two", "three"))
    future.add_done_callback(lambda done: called.append(bytes(done.result().types)))
    assert future.result() is None
    nodes.until(future.done)
    assert called == [bytes(future.result().types)] == [b"\0\3\5"]


def test_everyone_gets_the_answers_to_what_he_asked(nodes):
    nodes("server").create_service(GetParameterTypes, "/lengths", lengths)
    clients = [nodes(f"asker{i}").create_client(GetParameterTypes, "/lengths") for i in range(2)]
    nodes.connect()
    futures = {
        (i, n): clients[i].call_async(ask("x" * i, "x" * n)) for n in range(5) for i in range(2)
    }
    nodes.until(lambda: all(future.done() for future in futures.values()))
    assert {key: tuple(future.result().types) for key, future in futures.items()} == {
        key: key for key in futures
    }


def test_an_empty_request_and_a_node_that_asks_itself(nodes):
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
    failing = client.call_async(ask())
    nodes.until(lambda: server.executor.failed == 1)
    assert "AssertionError: nothing asked" in capsys.readouterr().err
    future = client.call_async(ask("one"))
    nodes.until(future.done)
    assert list(future.result().types) == [3]
    assert not failing.done()
    client.remove_pending_request(failing)


def test_nobody_answers_where_there_is_no_service(nodes):
    node = nodes("asker")
    client = node.create_client(Trigger, "/nobody")
    nodes.connect()
    future = client.call_async(Trigger.Request())
    assert not node.spin_until_future_complete(future, 0.02)


# --- callbacks ------------------------------------------------------------------------------


def test_timers_run_in_time_and_in_the_order_made(nodes):
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
        times = [at - start for one, at in ran if one == name]
        assert all(at >= (i + 1) * period for i, at in enumerate(times)), times


def test_a_timer_publishes_until_it_is_canceled(nodes):
    node = nodes("clock")
    came = []
    node.create_subscription(Int32, "/x", came.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()

    def tick():
        publisher.publish(Int32(data=publisher.published))
        if publisher.published == 3:
            timer.cancel()

    timer = node.create_timer(0.01, tick)
    nodes.until(lambda: len(came) == 3)
    assert came == numbers(0, 1, 2)
    assert timer.is_canceled()
    nodes.settle()
    assert len(came) == 3


def test_what_a_callback_raises_is_printed_and_the_rest_goes_on(nodes, capsys):
    node = nodes("node")
    came = []

    def fail(message):
        came.append(message.data)
        raise ValueError("no good")

    node.create_subscription(Int32, "/x", fail)
    others = []
    node.create_subscription(Int32, "/x", others.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    for message in numbers(1, 2):
        assert publisher.publish(message)
    nodes.until(lambda: len(came) == len(others) == 2)
    assert came == [1, 2] and others == numbers(1, 2)
    assert node.executor.failed == 2
    assert capsys.readouterr().err.count("ValueError: no good") == 2


def test_a_callback_is_told_once_that_the_node_is_connected(nodes):
    node = nodes("node")
    states = []
    node.on_state = states.append
    nodes.connect()
    nodes.until(lambda: states and states[-1] == node.state)
    nodes.settle()
    assert states.count(node.state) == 1


# --- the end ----------------------------------------------------------------------------------


def test_a_destroyed_subscription_hears_no_more(nodes):
    node = nodes("node")
    came, others = [], []
    subscription = node.create_subscription(Int32, "/x", came.append)
    node.create_subscription(Int32, "/x", others.append)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    assert publisher.publish(Int32(data=1))
    nodes.until(lambda: came and others)
    subscription.destroy()
    assert publisher.publish(Int32(data=2))
    nodes.until(lambda: len(others) == 2)
    assert came == numbers(1)


def test_a_destroyed_publisher_sends_no_more(nodes):
    node = nodes("node")
    came = []
    node.create_subscription(Int32, "/x", came.append)
    first, second = [node.create_publisher(Int32, "/x") for _ in range(2)]
    nodes.connect()
    assert first.publish(Int32(data=1))
    first.destroy()
    assert first.publish(Int32(data=2)) is False and first.dropped == 1
    assert second.publish(Int32(data=3))
    nodes.until(lambda: len(came) == 2)
    assert came == numbers(1, 3)


def test_a_subscription_may_be_destroyed_by_its_callback(nodes):
    node = nodes("node")
    came = []

    def once(message):
        came.append(message)
        subscription.destroy()

    subscription = node.create_subscription(Int32, "/x", once)
    publisher = node.create_publisher(Int32, "/x")
    nodes.connect()
    for message in numbers(1, 2):
        assert publisher.publish(message)
    nodes.settle()
    assert came == numbers(1)


def test_a_destroyed_node_is_silent_and_others_go_on(nodes):
    first, second, listener = nodes("first"), nodes("second"), nodes("listener")
    came = []
    listener.create_subscription(Int32, "/x", came.append)
    publishers = [node.create_publisher(Int32, "/x") for node in (first, second)]
    nodes.connect()
    assert all(publisher.publish(Int32(data=1)) for publisher in publishers)
    nodes.until(lambda: len(came) == 2)
    nodes.made.remove(first)
    first.destroy_node()
    first.destroy_node()
    assert publishers[0].publish(Int32(data=2)) is False
    assert publishers[0].dropped == 1
    assert publishers[1].publish(Int32(data=3))
    nodes.until(lambda: len(came) == 3)
    assert came[2] == Int32(data=3)


def test_spin_ends_when_a_callback_destroys_the_node(nodes):
    node = nodes("node")
    nodes.connect()
    nodes.made.remove(node)
    node.create_timer(0.001, node.destroy_node)
    node.spin()
