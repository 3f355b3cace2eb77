"""The host's node: joining the network, taking samples, services, Ctrl-C and leaving."""

import functools
import select
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from support.signals import default_signals

import uros
from uros.client import AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT
from uros.client.node import Node as ClientNode
from uros.client.triggers import trigger_all
from uros.host import interrupt
from uros.host.direct import Direct
from uros.host.network import Network
from uros.host.node import Node, environment_domain
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.middleware import open_middleware
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.memory import Bus, MemoryMiddleware, MemoryWriter
from uros.qos import HistoryPolicy, QoSProfile, services_profile
from uros.ticks import ticks_add
from uros.transport.udp import UdpTransport

Int32 = load("std_msgs/msg/Int32")
String = load("std_msgs/msg/String")
Time = load("builtin_interfaces/msg/Time")
Temperature = load("sensor_msgs/msg/Temperature")
Trigger = load("std_srvs/srv/Trigger")
INT32 = Int32._DDS_TYPE
TRIGGER = Service(
    "rq/goRequest", Trigger.Request._DDS_TYPE, "rr/goReply", Trigger.Response._DDS_TYPE
)


@pytest.fixture
def bus():
    return Bus()


@pytest.fixture
def join(bus):
    """Creates nodes on the bus."""
    nodes = []

    def join(name="node", **options):
        nodes.append(Node(name, Direct(MemoryMiddleware(bus)), **options))
        return nodes[-1]

    yield join
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def node(join):
    return join()


@pytest.fixture
def peer(bus):
    """A peer's node on the bus, without uros.Node."""
    middleware = MemoryMiddleware(bus)
    yield middleware.create_node(0, "/", "other")
    middleware.close()


def int32(value):
    return to_cdr(Int32(data=value))


def work(node):
    """Spin until no callback is ready."""
    while node.spin_once(0):
        pass


# --- joining ------------------------------------------------------------------------------


def test_uros_has_the_hosts_node():
    assert uros.Node is Node
    with pytest.raises(AttributeError, match="Nod"):
        uros.Nod  # noqa: B018
    assert not hasattr(uros, "__wrapped__")


def test_on_a_board_uros_has_the_boards_node():
    program = (
        "import sys\n"
        "sys.modules['uros.host'] = None\n"  # importing it is an ImportError
        "import uros\n"
        "print(uros.Node)\n"
        "uros.qos\n"  # as MicroPython does for: from uros import qos
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("<class 'uros.client.node.Node'>\n", "")


def test_a_node_and_its_endpoints_are_in_the_graph_until_destroyed(join, bus):
    node = join("weather", namespace="garden")
    node.create_publisher(Int32, "/x")
    node.create_subscription(Int32, "y", print)
    node.create_service(Trigger, "/go", print)
    assert [entry.full_name for entry in bus.nodes] == ["/garden/weather"]
    assert list(bus.writers) == [(0, "rt/x"), (0, "rr/goReply")]
    assert list(bus.readers) == [(0, "rt/garden/y"), (0, "rq/goRequest")]
    node.destroy_node()
    assert not (bus.nodes or bus.writers or bus.readers)


def test_a_destroyed_entity_leaves_the_graph(node, bus):
    entities = [
        node.create_publisher(Int32, "/x"),
        node.create_subscription(Int32, "/y", print),
        node.create_service(Trigger, "/go", print),
        node.create_client(Trigger, "/come"),
    ]
    assert len(bus.writers) == len(bus.readers) == 3
    for entity in entities:
        entity.destroy()
    assert not (bus.writers or bus.readers) and len(bus.nodes) == 1


def test_a_node_is_connected_from_the_start_until_destroyed(node):
    states = []
    node.on_state = states.append
    assert node.state == AGENT_CONNECTED
    node.spin_once(0)
    node.spin_once(0)
    assert states == [AGENT_CONNECTED]
    node.destroy_node()
    assert node.state == AGENT_DISCONNECTED
    with pytest.raises(MiddlewareError, match="destroyed"):
        node.spin_once(0)
    with pytest.raises(MiddlewareError, match="destroyed"):
        node.create_publisher(Int32, "/x")


def test_a_callback_for_the_state_may_start_timers(node, monkeypatch):
    selects = Selects()
    monkeypatch.setattr(interrupt, "select", selects)
    ran = []
    node.on_state = lambda state: node.create_timer(0.001, lambda: ran.append(state))
    assert node.spin_once(20.0)
    assert ran == [AGENT_CONNECTED] and max(selects.times) < 1


def test_a_callback_for_the_state_that_raises_is_printed(node, capsys):
    def fail(state):
        raise ValueError("no good")

    node.on_state = fail
    node.spin_once(0)
    assert "no good" in capsys.readouterr().err


def test_the_clock_is_the_hosts(node):
    stamp = Time()
    before = time.time_ns() - 1000  # the clock has microseconds
    seconds, nanoseconds = node.clock.now()
    node.clock.stamp(stamp)
    after = time.time_ns()
    assert before <= seconds * 10**9 + nanoseconds <= after
    assert before <= stamp.sec * 10**9 + stamp.nanosec <= after
    assert node.clock.synchronized


@pytest.mark.parametrize(
    ("text", "domain"), [(None, 0), ("", 0), ("7", 7), (" 42 ", 42), ("232", 232)]
)
def test_the_domain_of_the_environment(monkeypatch, text, domain):
    monkeypatch.delenv("ROS_DOMAIN_ID")
    if text is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert environment_domain() == domain


@pytest.mark.parametrize("text", ["seven", "-1", "1.5"])
def test_a_domain_that_is_no_number(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(MiddlewareError, match="ROS_DOMAIN_ID"):
        uros.Node("node")
    monkeypatch.setattr("uros.host.node.open_middleware", lambda name: MemoryMiddleware())
    uros.Node("node", domain_id=3).destroy_node()


@pytest.mark.parametrize(("given", "domain"), [(None, 7), (0, 0), (9, 9)])
def test_a_node_joins_by_auto_in_the_domain_given_or_the_environments(monkeypatch, given, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    opened = []

    def open_middleware_stub(name):
        opened.append(MemoryMiddleware())
        opened.append(name)
        return opened[0]

    monkeypatch.setattr("uros.host.node.open_middleware", open_middleware_stub)
    node = uros.Node("node", domain_id=given)
    assert opened[1:] == ["auto"]
    assert [entry.domain for entry in opened[0].bus.nodes] == [node.domain_id] == [domain]
    node.destroy_node()


@pytest.mark.parametrize(
    ("name", "options", "error"),
    [("a/b", {}, ValueError), ("a", {"namespace": "1"}, ValueError),
     ("a", {"domain_id": 233}, MiddlewareError)],
)  # fmt: skip
def test_a_node_that_cannot_be_created_leaves_no_middleware_open(monkeypatch, name, options, error):
    opened = []

    class Closing(MemoryMiddleware):
        def close(self):
            opened.remove(self)
            super().close()

    def open_middleware_stub(name):
        opened.append(Closing())
        return opened[-1]

    monkeypatch.setattr("uros.host.node.open_middleware", open_middleware_stub)
    with pytest.raises(error):
        uros.Node(name, **options)
    assert opened == []


def test_with_a_transport_it_is_a_boards_node():
    line = UdpTransport("127.0.0.1", 8888)
    node = uros.Node("node", line, key=7)
    assert (node.state, node.domain_id) == (WAITING_AGENT, 0)
    assert node.connection.transport is line and node.connection.key == 7
    node.destroy_node()


def test_nodes_share_a_connection(join, bus):
    first = join("first")
    second = Node("second", first.connection)
    messages = []
    first.create_subscription(Int32, "/x", messages.append)
    assert second.create_publisher(Int32, "/x").publish(Int32(data=1))
    work(first)
    assert messages == [Int32(data=1)]
    publisher = first.create_publisher(Int32, "/x")
    first.destroy_node()
    assert publisher.publish(Int32(data=1)) is False
    assert [entry.full_name for entry in bus.nodes] == ["/second"]
    assert second.create_publisher(Int32, "/y").publish(Int32(data=2))
    second.destroy_node()
    assert bus.nodes == []


def test_a_second_node_is_in_the_domain_of_the_first(bus):
    first = Node("first", Direct(MemoryMiddleware(bus), 5))
    second = Node("second", first.connection)
    third = Node("third", first.connection, domain_id=6)
    assert [entry.domain for entry in bus.nodes] == [5, 5, 6]
    for node in (first, second, third):
        node.destroy_node()


def test_a_depth_and_a_profile(node, bus):
    profile = QoSProfile(history=HistoryPolicy.KEEP_ALL, deadline_ms=20)
    node.create_publisher(Int32, "/x", 3)
    node.create_publisher(Int32, "/y", profile)
    assert bus.writers[0, "rt/x"][0].qos == QoSProfile(3)
    assert bus.writers[0, "rt/y"][0].qos is profile


# --- samples --------------------------------------------------------------------------------


def test_a_publisher_without_room_drops_and_counts(node, monkeypatch):
    publisher = node.create_publisher(Int32, "/x")
    monkeypatch.setattr(MemoryWriter, "write", lambda self, cdr: False)
    assert publisher.publish(Int32(data=1)) is False
    assert (publisher.published, publisher.dropped) == (0, 1)
    monkeypatch.undo()
    assert publisher.publish(Int32(data=1)) is True
    assert (publisher.published, publisher.dropped) == (1, 1)


def test_slow_callbacks_leave_samples_to_the_middleware(node, peer):
    """The middleware keeps the last samples up to the depth, beside one that was taken before."""
    messages = []
    subscription = node.create_subscription(Int32, "/x", messages.append, 3)
    writer = peer.create_writer("rt/x", INT32, QoSProfile(100))
    writer.write(int32(0))
    node.connection.pump(0)
    for i in range(1, 100):
        writer.write(int32(i))
        node.connection.pump(0)
    work(node)
    assert [message.data for message in messages] == [0, 97, 98, 99]
    assert subscription.lost == 0
    writer.write(int32(100))
    work(node)
    assert messages[-1].data == 100


def test_keep_all_delivers_every_sample(node, peer):
    messages = []
    node.create_subscription(
        Int32, "/x", messages.append, QoSProfile(history=HistoryPolicy.KEEP_ALL)
    )
    writer = peer.create_writer("rt/x", INT32, QoSProfile(10))
    for i in range(1000):
        writer.write(int32(i))
    work(node)
    assert [message.data for message in messages] == list(range(1000))


@pytest.mark.parametrize("kind", ["rtps", pytest.param("dds", marks=pytest.mark.cyclone)])
def test_a_node_that_publishes_and_never_spins_is_heard(own_domain_id, kind):
    talker = Node("talker", Direct(open_middleware(kind), own_domain_id))
    listener = Node("listener", Direct(open_middleware(kind), own_domain_id))
    publisher = talker.create_publisher(Int32, "/never_spun")
    heard = []
    listener.create_subscription(Int32, "/never_spun", heard.append)
    deadline = time.monotonic() + 20
    while not heard and time.monotonic() < deadline:
        publisher.publish(Int32(data=5))
        listener.spin_once(0.05)
    assert heard[:1] == [Int32(data=5)]
    talker.destroy_node()
    listener.destroy_node()


@pytest.mark.parametrize("kind", ["rtps", pytest.param("dds", marks=pytest.mark.cyclone)])
def test_a_node_that_does_nothing_is_discovered(own_domain_id, kind):
    still = Node("still", Direct(open_middleware(kind), own_domain_id))
    publisher = still.create_publisher(Int32, "/still")
    heard = []
    with Network(own_domain_id, kind) as network:
        network.listen("/still", "std_msgs/msg/Int32", QoSProfile(10), heard.append)
        assert network.spin(lambda: "/still" in network.graph.nodes(), 20)
        assert network.spin(lambda: still.connection.matched(publisher) == 1, 20)
        publisher.publish(Int32(data=5))  # the first one arrives
        assert network.spin(lambda: heard, 20)
    still.destroy_node()


class Turns(MemoryMiddleware):
    """Counts turns that others than the program's thread take."""

    needs_turns = True

    def __init__(self):
        super().__init__()
        self.in_background = threading.Semaphore(0)

    def dispatch(self):
        super().dispatch()
        if threading.current_thread() is not threading.main_thread():
            self.in_background.release()


def test_a_sample_that_a_background_turn_received_is_not_waited_for(monkeypatch):
    middleware = Turns()
    node = Node("node", Direct(middleware))
    heard, waits = [], []
    node.create_subscription(Int32, "/x", heard.append)
    peer = middleware.create_node(0, "/", "peer")
    peer.create_writer("rt/x", INT32, QoSProfile()).write(int32(2))
    for _ in range(2):  # one of them began after the write
        assert middleware.in_background.acquire(timeout=20)
    monkeypatch.setattr(node.connection.interrupt, "wait", lambda _, seconds: waits.append(seconds))
    assert node.spin_once(10)
    assert [message.data for message in heard] == [2] and set(waits) == {0.0}
    node.destroy_node()


def test_a_node_that_spins_takes_all_turns_itself(monkeypatch):
    middleware = Turns()
    node = Node("node", Direct(middleware))
    connection = node.connection
    counts = []

    def wait(fileno, seconds):
        """Take a turn in the middle of a wait, as the other thread may."""
        turn = threading.Thread(target=connection._take_turn)
        while middleware.in_background.acquire(blocking=False):
            pass
        turn.start()
        turn.join()
        counts.append(middleware.in_background.acquire(blocking=False))
        return False

    monkeypatch.setattr(connection.interrupt, "wait", wait)
    node.spin_once(0)
    assert counts == [False]
    assert middleware.in_background.acquire(timeout=20)  # they go on after that
    node.destroy_node()


def test_background_turns_end_with_the_last_node():
    before = set(threading.enumerate())
    node = Node("node", Direct(Turns()))
    (thread,) = set(threading.enumerate()) - before
    assert thread.daemon
    node.destroy_node()
    thread.join(20)
    assert not thread.is_alive()


def test_background_turns_go_on_after_errors_which_are_told_once(monkeypatch, capsys):
    middleware, failures = Turns(), []

    def fail():
        failures.append(1)
        raise OSError("no descriptor is free")

    node = Node("node", Direct(middleware))
    with monkeypatch.context() as patched:
        patched.setattr(middleware, "tick", fail)
        while len(failures) < 3:
            assert middleware.in_background.acquire(timeout=20)
    while middleware.in_background.acquire(blocking=False):
        pass
    assert middleware.in_background.acquire(timeout=20)
    assert capsys.readouterr().err.count("no descriptor is free") == 1
    node.destroy_node()


def test_a_callback_may_destroy_the_node_and_take_long_for_it():
    node = Node("node", Direct(MemoryMiddleware()))

    def end():
        node.destroy_node()
        node._pumped = ticks_add(node.clock.ms(), -1000)

    node.create_timer(0.001, end)
    node.spin()
    assert node.connection.state == AGENT_DISCONNECTED


FORKS = """
import os, sys, threading
from uros.host.direct import Direct
from uros.host.node import Node
from uros.client import AGENT_CONNECTED, AGENT_DISCONNECTED
from uros.middleware import open_middleware

node = Node("node", Direct(open_middleware(sys.argv[1]), int(sys.argv[2])))
connection = node.connection
locked, done = threading.Event(), threading.Event()

def turn():  # as the background thread may be in one
    with connection._lock:
        locked.set()
        done.wait()

threading.Thread(target=turn, daemon=True).start()
locked.wait()
child = os.fork()
if child == 0:
    connection.close()
    sys.exit(0 if connection.state == AGENT_DISCONNECTED else 3)
done.set()
_, status = os.waitpid(child, 0)
sys.exit(os.waitstatus_to_exitcode(status) or connection.state != AGENT_CONNECTED)
"""


@pytest.mark.parametrize("kind", ["memory", "rtps"])
def test_a_forked_process_leaves_the_connection_to_its_parent(own_domain_id, kind):
    command = [sys.executable, "-c", FORKS, kind, str(own_domain_id)]
    assert subprocess.run(command, check=False, timeout=60).returncode == 0


def test_a_depth_of_zero_is_one(own_domain_id):
    node = Node("node", Direct(open_middleware("auto"), own_domain_id))
    messages = []
    node.create_subscription(Int32, "/x", messages.append, 0)
    assert node.create_publisher(Int32, "/x").publish(Int32(data=1))
    work(node)
    assert messages == [Int32(data=1)]
    node.destroy_node()


def test_deep_histories_are_taken_in_portions(node, peer, bus):
    messages = []
    node.create_subscription(Int32, "/x", messages.append, 100)
    writer = peer.create_writer("rt/x", INT32, QoSProfile())
    for i in range(50):
        writer.write(int32(i))
    node.connection.pump(0)
    ((reader,),) = [bus.readers[0, "rt/x"]]
    assert len(reader.take(100)) == 18
    work(node)
    assert [message.data for message in messages] == list(range(32))


@pytest.mark.parametrize(
    "sample",
    [
        b"\0\1\0\0\1\0\0",  # short
        b"\0\7\0\0\1\0\0\0",  # XCDR2
        b"\1\1\0\0\1\0\0\0",
    ],
)
def test_malformed_samples_are_counted_and_dropped(node, peer, sample):
    messages = []
    subscription = node.create_subscription(Int32, "/x", messages.append)
    writer = peer.create_writer("rt/x", INT32, QoSProfile())
    writer.write(sample)
    writer.write(int32(1))
    work(node)
    assert messages == [Int32(data=1)] and subscription.malformed == 1


def test_big_endian_samples(node, peer):
    messages = []
    node.create_subscription(Int32, "/x", messages.append)
    peer.create_writer("rt/x", INT32, QoSProfile()).write(b"\0\0\0\0\0\0\1\2")
    work(node)
    assert messages == [Int32(data=258)]


def test_a_different_type_on_the_topic_is_reported_once(node, peer, capsys):
    node.create_subscription(Int32, "/x", print)
    peer.create_writer("rt/x", String._DDS_TYPE, QoSProfile())
    node.create_publisher(Int32, "/x")
    node.create_publisher(Int32, "/x")
    stderr = capsys.readouterr().err
    assert stderr.count("/x is std_msgs/msg/Int32 here, and std_msgs/msg/String elsewhere") == 1
    assert stderr.count("\n") == 1


# --- waiting --------------------------------------------------------------------------------


class Selects:
    """Replaces the module select: records the timeouts, and sets an event at the first call."""

    def __init__(self):
        self.times = []
        self.waiting = threading.Event()

    def select(self, *arguments):
        self.times.append(arguments[3])
        self.waiting.set()
        return select.select(*arguments)


@pytest.mark.parametrize("kind", ["memory", pytest.param("dds", marks=pytest.mark.cyclone)])
def test_a_sample_wakes_the_node_which_does_not_poll(monkeypatch, own_domain_id, bus, kind):
    def middleware():
        return MemoryMiddleware(bus) if kind == "memory" else open_middleware("dds")

    node = Node("node", Direct(middleware(), own_domain_id))
    peer = Node("peer", Direct(middleware(), own_domain_id))
    messages = []
    node.create_subscription(Int32, "/x", messages.append)
    publisher = peer.create_publisher(Int32, "/x")
    peer.spin_once(0.2)
    node.spin_once(0.2)  # sends all pending announcements
    selects = Selects()
    monkeypatch.setattr(interrupt, "select", selects)

    def publish():
        selects.waiting.wait(10)
        publisher.publish(Int32(data=1))

    thread = threading.Thread(target=publish)
    thread.start()
    start = time.monotonic()
    assert node.spin_once(20.0)
    assert time.monotonic() - start < 10
    thread.join()
    assert messages == [Int32(data=1)] and len(selects.times) <= 3
    node.destroy_node()
    peer.destroy_node()


def test_a_node_works_in_any_thread(bus):
    messages = []

    def run():
        node = Node("node", Direct(MemoryMiddleware(bus)))
        node.create_subscription(Int32, "/x", messages.append)
        node.create_publisher(Int32, "/x").publish(Int32(data=1))
        node.spin_once(10.0)
        node.destroy_node()

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert messages == [Int32(data=1)]


def test_samples_that_no_callback_may_take_yet_do_not_wake_the_node(monkeypatch, node, peer):
    messages = []
    node.create_subscription(Int32, "/x", messages.append, 1)
    node.create_subscription(Int32, "/y", messages.append, 1)
    node.executor.trigger = trigger_all
    writer = peer.create_writer("rt/x", INT32, QoSProfile())
    selects = Selects()
    monkeypatch.setattr(interrupt, "select", selects)
    for i in range(2):
        writer.write(int32(i))
        assert not node.spin_once(0.02)
    assert len(selects.times) <= 6
    peer.create_writer("rt/y", INT32, QoSProfile()).write(int32(5))
    work(node)
    assert [message.data for message in messages] == [0, 5]


def test_a_reply_without_room_is_sent_again_soon(monkeypatch, node, peer):
    def go(request, response):
        asked.append(request)
        response.message = str(len(asked))
        return response

    asked = []
    node.create_service(Trigger, "/go", go)
    requester = peer.create_requester(TRIGGER, services_profile(), lambda: None)
    numbers = [requester.request(to_cdr(Trigger.Request())) for _ in range(3)]
    selects = Selects()
    monkeypatch.setattr(interrupt, "select", selects)
    with monkeypatch.context() as full:
        full.setattr(MemoryWriter, "write", lambda self, cdr: False)
        node.spin_once(0.1)
        assert not node.spin_once(0.03)
        assert len(asked) == 1
        assert selects.times.count(0.005) >= 2
    work(node)
    answers = requester.take(9)
    assert [number for number, _ in answers] == numbers
    assert [from_cdr(Trigger.Response, answer).message for _, answer in answers] == ["1", "2", "3"]


# --- services -------------------------------------------------------------------------------


@pytest.fixture
def asking(node, peer):
    """A client of the node, and the peer's replier."""
    client = node.create_client(Trigger, "/go")
    return client, peer.create_replier(TRIGGER, services_profile(), lambda: None)


def requester_of(client):
    """Return the middleware's requester of a client."""
    return client.node.connection._endpoints[client.number]._requester


def reply(text):
    return to_cdr(Trigger.Response(message=text))


def test_replies_may_arrive_in_any_order(node, asking):
    client, replier = asking
    futures = [client.call_async(Trigger.Request()) for _ in range(3)]
    requests = replier.take(9)
    for guid, sequence, _ in reversed(requests):
        replier.reply(guid, sequence, reply(str(sequence)))
    work(node)
    assert [future.result().message for future in futures] == ["1", "2", "3"]
    assert not node.connection._endpoints[client.number]._sequences


def test_replies_to_no_pending_request_are_dropped(node, asking):
    client, replier = asking
    future = client.call_async(Trigger.Request())
    ((guid, sequence, _),) = replier.take(9)
    for number in (0, sequence + 1, sequence + 0xFFFF, 2**62):
        replier.reply(guid, number, reply("wrong"))
    replier.reply(bytes(16), sequence, reply("another's"))
    replier.reply(guid, sequence, reply("right"))
    replier.reply(guid, sequence, reply("again"))
    work(node)
    assert future.result().message == "right"


def test_a_big_endian_reply(node, asking):
    client, replier = asking
    future = client.call_async(Trigger.Request())
    ((guid, sequence, _),) = replier.take(9)
    replier.reply(guid, sequence, b"\0\0\0\0" + b"\1\0\0\0" + b"\0\0\0\3" + b"ok\0")
    work(node)
    assert future.result() == Trigger.Response(success=True, message="ok")


def test_request_ids_wrap_around(node, asking):
    client, replier = asking
    requester = requester_of(client)
    for sequence in (0xFFFD, 0xFFFE, 0xFFFF, 0x10000, 0x1FFFE, 2**40):
        requester._sequence = sequence - 1
        future = client.call_async(Trigger.Request())
        ((guid, number, _),) = replier.take(9)
        assert number == sequence
        replier.reply(guid, number, reply(str(sequence)))
        work(node)
        assert future.result().message == str(sequence)


def test_a_request_without_room_fails_at_once(node, asking, monkeypatch):
    client, _ = asking
    monkeypatch.setattr(requester_of(client), "request", lambda cdr: None)
    future = client.call_async(Trigger.Request())
    with pytest.raises(OSError, match="/go"):
        future.result()


def test_a_malformed_reply_fails_the_future(node, asking):
    client, replier = asking
    future = client.call_async(Trigger.Request())
    ((guid, sequence, _),) = replier.take(9)
    replier.reply(guid, sequence, b"\0\1\0\0\1")
    work(node)
    with pytest.raises(OSError, match="malformed"):
        future.result()


# --- the end --------------------------------------------------------------------------------

PROGRAM = """
import uros
from uros.interfaces.sensor_msgs.msg import Temperature
node = uros.Node("listener")
node.create_subscription(Temperature, "/sensors/room_temp", print)
node.spin()
"""


def test_a_closed_connection_drops_published_messages(node):
    publisher = node.create_publisher(Int32, "/x")
    client = node.create_client(Trigger, "/go")
    node.connection.close()
    node.connection.close()
    assert publisher.publish(Int32()) is False
    with pytest.raises(OSError):
        client.call_async(Trigger.Request()).result()


@default_signals()
def test_ctrl_c_waits_until_samples_are_taken(node, peer, monkeypatch):
    """An interrupt within Cyclone's binding would become a different error."""
    messages = []
    node.create_subscription(Int32, "/x", messages.append)
    dispatch = node.connection.middleware.dispatch

    def pressed_meanwhile():
        signal.raise_signal(signal.SIGINT)
        dispatch()

    monkeypatch.setattr(node.connection.middleware, "dispatch", pressed_meanwhile)
    writer = peer.create_writer("rt/x", INT32, QoSProfile())
    writer.write(int32(1))
    with pytest.raises(KeyboardInterrupt):
        node.spin_once(0)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    writer.write(int32(2))
    node.spin()
    monkeypatch.undo()
    work(node)
    assert messages == [Int32(data=1), Int32(data=2)]


@default_signals()
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_signals_that_end_a_program_do_so_when_samples_are_taken(
    node, peer, monkeypatch, number
):
    """They end the process by default, which then says no farewell."""
    messages = []
    node.create_subscription(Int32, "/x", messages.append)
    dispatch = node.connection.middleware.dispatch

    def meanwhile():
        signal.raise_signal(number)
        dispatch()

    with monkeypatch.context() as patched:
        patched.setattr(node.connection.middleware, "dispatch", meanwhile)
        writer = peer.create_writer("rt/x", INT32, QoSProfile())
        writer.write(int32(1))
        with pytest.raises(SystemExit) as end:
            node.spin_once(0)
        assert end.value.code == 128 + number
        writer.write(int32(2))
        node.spin()
    assert signal.getsignal(number) == signal.SIG_DFL
    work(node)
    assert messages == [Int32(data=1), Int32(data=2)]
    before = signal.signal(number, signal.SIG_IGN)  # as nohup does
    try:
        node.create_timer(0.001, lambda: signal.raise_signal(number))
        assert node.spin_once()
    finally:
        signal.signal(number, before)


@default_signals()
def test_ctrl_c_just_before_the_wait_ends_it(node, monkeypatch):
    """Without the wakeup fd, Python would handle the signal only after the wait."""

    class Late(Selects):
        def select(self, *arguments):
            signal.raise_signal(signal.SIGINT)
            return super().select(*arguments)

    selects = Late()
    monkeypatch.setattr(interrupt, "select", selects)
    start = time.monotonic()
    node.spin()
    assert time.monotonic() - start < 20 and len(selects.times) == 1


@default_signals()
def test_other_signals_do_not_wake_the_node(node, monkeypatch):
    class Late(Selects):
        def select(self, *arguments):
            if not self.times:
                signal.raise_signal(signal.SIGUSR1)
            return super().select(*arguments)

    selects = Late()
    monkeypatch.setattr(interrupt, "select", selects)
    before = signal.signal(signal.SIGUSR1, lambda number, frame: None)
    try:
        assert not node.spin_once(0.05)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert 2 <= len(selects.times) <= 3


@default_signals()
def test_ctrl_c_ends_a_callback(node):
    node.create_timer(0.001, lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        node.spin_once()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    node.spin()


@default_signals()
def test_a_program_with_its_own_handler_keeps_it(node, peer, monkeypatch):
    pressed = []
    dispatch = node.connection.middleware.dispatch

    def pressed_meanwhile():
        signal.raise_signal(signal.SIGINT)
        assert pressed
        dispatch()

    monkeypatch.setattr(node.connection.middleware, "dispatch", pressed_meanwhile)
    node.create_subscription(Int32, "/x", print)
    peer.create_writer("rt/x", INT32, QoSProfile()).write(int32(1))
    before = signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    try:
        node.spin_once(0)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_three_lines_end_with_a_signal_and_leave_the_network(monkeypatch, own_domain_id, number):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain_id))
    with Network(own_domain_id) as network:
        with default_signals():
            process = subprocess.Popen(
                [sys.executable, "-u", "-c", PROGRAM],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        try:
            assert network.spin(lambda: "/listener" in network.graph.nodes(), 20)
            publisher = Node("talker", domain_id=own_domain_id)
            sending = publisher.create_publisher(Temperature, "/sensors/room_temp")
            timer = publisher.create_timer(
                0.02, lambda: sending.publish(Temperature(temperature=21.5))
            )
            lines = []
            reading = threading.Thread(
                target=lambda: lines.append(process.stdout.readline()), daemon=True
            )
            reading.start()
            deadline = time.monotonic() + 20
            while not lines:
                assert time.monotonic() < deadline, "no message was received"
                publisher.spin_once(0.1)
            timer.cancel()
            publisher.destroy_node()
            assert "temperature=21.5" in lines[0]
            process.send_signal(number)
            _, errors = process.communicate(timeout=20)
            assert errors == "" and process.returncode == 0, errors
            # A participant that is not deleted expires only after ten seconds.
            assert network.spin(lambda: "/listener" not in network.graph.nodes(), 5)
        finally:
            process.kill()
            process.communicate()


def test_a_second_ctrl_c_while_a_node_leaves_shows_no_traceback():
    program = (
        "import uros\n"
        "from uros.transport.udp import UdpTransport\n"
        "class Interrupted(uros.Node):\n"
        "    def destroy_node(self):\n"
        "        print('leaves')\n"
        "        raise KeyboardInterrupt\n"
        "node = Interrupted('n', UdpTransport('127.0.0.1', 9))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "leaves\n", "")


@pytest.mark.parametrize("kind", [str, "std_msgs/msg/String", None, Trigger])
def test_a_publisher_of_what_is_no_message_type_is_refused(node, kind):
    before = len(node._entities)
    for create in (
        lambda: node.create_publisher(kind, "topic", 10),
        lambda: node.create_subscription(kind, "topic", print, 10),
    ):
        with pytest.raises(TypeError, match=r"/topic: .* is not a message type: give a class"):
            create()
    assert len(node._entities) == before


@pytest.mark.parametrize("kind", [str, "std_srvs/srv/Trigger", None, String])
def test_a_service_of_what_is_no_service_type_is_refused(node, kind):
    before = len(node._entities)
    for create in (
        lambda: node.create_service(kind, "go", print),
        lambda: node.create_client(kind, "go"),
    ):
        with pytest.raises(TypeError, match=r"/go: .* is not a service type: give a class"):
            create()
    assert len(node._entities) == before


# --- a board's node on a host -----------------------------------------------------------------


def test_a_node_without_an_agent_says_so_once_and_goes_on(monkeypatch, capsys):
    monkeypatch.setattr("uros.host.no_agent.PATIENCE", 0.05)
    node = Node("counter", UdpTransport("127.0.0.1", 9))
    ticks = []
    node.create_timer(0.001, lambda: ticks.append(1))
    try:
        while not capsys_has(capsys, "no agent has answered the node counter for 0.05 s"):
            node.spin_once(0.01)
        for _ in range(5):
            assert node.spin_once(1.0)
        assert capsys.readouterr().err == ""
        # A wait without limit is ended by the line too, and goes on.
        waiting = Node("waiting", UdpTransport("127.0.0.1", 9))

        def interrupt_soon(text):
            # Of this thread, as by a terminal: one of the timer's would not end the wait.
            waiting_thread = threading.get_ident()
            interrupt = functools.partial(signal.pthread_kill, waiting_thread, signal.SIGINT)
            threading.Timer(0.05, interrupt).start()
            return text

        monkeypatch.setattr("uros.host.no_agent.printable", interrupt_soon)
        with default_signals():
            waiting.spin()
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "'uros agent udp4 --port N', or check the address" in err
        waiting.destroy_node()
    finally:
        node.destroy_node()
    assert ticks


def test_a_wait_that_ends_early_does_not_keep_the_notice_from_being_printed(monkeypatch, capsys):
    node = Node("counter", UdpTransport("127.0.0.1", 9))
    waits = []
    now = 100.0

    def end_early(self, timeout_sec=None):
        nonlocal now
        waits.append(timeout_sec)
        now += 0.0 if timeout_sec is None else min(timeout_sec, 1.0)
        return False

    monkeypatch.setattr(ClientNode, "spin_once", end_early)
    monkeypatch.setattr("uros.host.no_agent.time", SimpleNamespace(monotonic=lambda: now))
    try:
        node.spin_once(None)
        assert waits == [3.0, 2.0, 1.0, None]
        assert capsys_has(capsys, "no agent has answered the node counter")
    finally:
        monkeypatch.undo()
        node.destroy_node()


def test_the_transports_of_the_notice_exist():
    from uros.host.no_agent import _COMMANDS
    from uros.transport.serial import StreamTransport
    from uros.transport.tcp import TcpTransport

    assert {kind.__name__ for kind in (UdpTransport, TcpTransport, StreamTransport)} == {*_COMMANDS}


def capsys_has(capsys, text):
    return text in capsys.readouterr().err


def test_nothing_is_said_once_the_node_was_connected(monkeypatch, capsys):
    monkeypatch.setattr("uros.host.no_agent.PATIENCE", 0.0)
    node = Node("counter", UdpTransport("127.0.0.1", 9))
    node.connection.connections = 1
    node.spin_once(0.0)
    node.connection.connections = 0
    node.spin_once(0.01)
    assert capsys.readouterr().err == ""
    node.destroy_node()
