"""Network in a domain of one process: its node, its graph and its samples, on each engine."""

import select
import signal
import time

import pytest
from support.signals import default_signals

from uros.host import interrupt
from uros.host import network as network_module
from uros.host.network import Network
from uros.middleware.base import MiddlewareError
from uros.middleware.rtps.node import RtpsNode
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

STRING = "std_msgs/msg/String"
DDS_STRING = "std_msgs::msg::dds_::String_"
HELLO = b"\0\1\0\0\6\0\0\0hello\0"


@pytest.fixture(params=["auto", "rtps"])
def network(own_domain_id, request):
    with Network(own_domain_id, request.param) as network:
        yield network


def publisher(network, topic, **qos):
    return network.node.create_writer("rt" + topic, DDS_STRING, QoSProfile(**qos))


def test_an_empty_domain_is_alone(network):
    network.settle()
    assert network.alone
    assert network.graph.topics() == {}
    (own,) = network.graph.nodes()
    assert own.startswith("/_uros_")


def test_endpoints_come_with_their_qos_and_go(network):
    writer = publisher(
        network,
        "/x",
        depth=3,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        lifespan_ms=1500,
        deadline_ms=20,
        partitions=("p",),
    )
    assert network.spin(lambda: network.graph.publishers("/x"), 10)
    network.settle()
    (info,) = network.graph.publishers("/x")
    assert info.gid == writer.guid
    assert info.type_hash.startswith("RIHS01_df668c74")
    assert info.node_name.startswith("_uros_")
    qos = info.qos
    assert (qos.lifespan_ms, qos.deadline_ms) == (1500, 20)
    assert (qos.history, qos.depth) == (HistoryPolicy.KEEP_LAST, 3)
    assert qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.partitions == ("p",) and qos.liveliness_lease_ms is None
    writer.close()
    assert network.spin(lambda: not network.graph.publishers("/x"), 10)


def test_listening(network):
    samples = []
    stop = network.listen("/x", STRING, QoSProfile(), samples.append)
    writer = publisher(network, "/x")
    writer.write(HELLO)
    assert network.spin(lambda: samples, 10)
    assert samples[0].cdr[:14] == HELLO
    assert 0 < samples[0].source_ns <= samples[0].received_ns
    assert network.spin(lambda: network.graph.subscriptions("/x"), 10)
    (subscription,) = network.graph.subscriptions("/x")
    assert subscription.type_name == STRING
    stop()
    stop()
    assert network.spin(lambda: not network.graph.subscriptions("/x"), 10)


def test_late_listeners_get_transient_local_samples(network):
    qos = {"durability": DurabilityPolicy.TRANSIENT_LOCAL, "depth": 1}
    publisher(network, "/x", **qos).write(HELLO)
    samples = []
    network.listen("/x", STRING, QoSProfile(**qos), samples.append)
    assert network.spin(lambda: samples, 10)


def test_more_than_one_batch_is_taken_at_once(network):
    samples = []
    deep = {"depth": 500, "reliability": ReliabilityPolicy.RELIABLE}
    network.listen("/x", STRING, QoSProfile(**deep), samples.append)
    writer = publisher(network, "/x", **deep)
    for _ in range(200):
        assert writer.write(HELLO)
    assert network.spin(lambda: len(samples) == 200, 10)


def test_samples_without_room_are_skipped_and_counted(network, monkeypatch):
    monkeypatch.setattr(network_module, "_MOST_WAITING", 5)
    samples = []
    deep = {"depth": 50, "reliability": ReliabilityPolicy.RELIABLE}
    stop = network.listen("/x", STRING, QoSProfile(**deep), samples.append)
    writer = publisher(network, "/x", **deep)
    for _ in range(20):
        assert writer.write(HELLO)
    assert network.spin(lambda: network.lost(), 10)
    assert (len(samples), network.lost()) == (5, 15)
    stop()
    assert network.lost() == 15


def test_what_newer_samples_replace_before_it_is_taken(network):
    """RTPS of uros counts it; Cyclone does not, but a full history is noticed."""
    samples = []
    network.listen("/x", STRING, QoSProfile(depth=3), samples.append)
    writer = publisher(network, "/x")
    for _ in range(10):
        assert writer.write(HELLO)
    assert network.spin(lambda: samples, 10)
    assert len(samples) == 3
    counted = isinstance(network.node, RtpsNode)
    assert (network.lost(), network.overflowed) == ((7, False) if counted else (0, True))


def test_a_flood_is_delivered_in_slices(network, monkeypatch):
    """What ends the spin is asked in between, however many samples wait."""
    monkeypatch.setattr(network_module, "_SLICE", 0.0)
    samples = []
    deep = {"depth": 50, "reliability": ReliabilityPolicy.RELIABLE}
    network.listen("/x", STRING, QoSProfile(**deep), samples.append)
    writer = publisher(network, "/x", **deep)
    for _ in range(20):
        assert writer.write(HELLO)
    assert network.spin(lambda: samples, 10)
    assert len(samples) == 1
    assert network.spin(lambda: len(samples) == 20, 10)


def test_time_limits_of_a_spin(network):
    assert network.spin(lambda: True)
    assert not network.spin(lambda: False, 0.01)


def test_an_ended_subscription_delivers_no_more_samples(network):
    """Samples that were taken before the end of the subscription are dropped too."""
    samples = []

    def once(sample):
        samples.append(sample)
        stop()

    stop = network.listen("/x", STRING, QoSProfile(), once)
    further = []
    network.listen("/x", STRING, QoSProfile(), further.append)
    writer = publisher(network, "/x")
    for _ in range(3):
        writer.write(HELLO)
    assert network.spin(lambda: len(further) == 3, 10)
    assert len(samples) == 1


# --- Ctrl-C ---------------------------------------------------------------------------------


@default_signals()
def test_ctrl_c_waits_until_samples_are_taken(network, monkeypatch):
    """An interrupt within Cyclone's binding would become a different error."""
    samples = []
    network.settle()
    network.listen("/x", STRING, QoSProfile(), samples.append)
    publisher(network, "/x").write(HELLO)
    dispatch = network._middleware.dispatch
    dispatched = []

    def pressed_meanwhile():
        signal.raise_signal(signal.SIGINT)
        dispatch()
        dispatched.append(len(samples))

    with monkeypatch.context() as pressed:
        pressed.setattr(network._middleware, "dispatch", pressed_meanwhile)
        with pytest.raises(KeyboardInterrupt):
            network.spin(lambda: False, 10)
    assert dispatched == [0]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert network.spin(lambda: samples, 10)


@default_signals()
def test_ctrl_c_just_before_the_wait_ends_it(network, monkeypatch):
    """Without the wakeup fd, Python would handle the signal only after the wait."""

    class Late:
        times = []

        def select(self, *arguments):
            signal.raise_signal(signal.SIGINT)
            self.times.append(arguments[3])
            return select.select(*arguments)

    network.settle()
    monkeypatch.setattr(network._middleware, "next_deadline", lambda: None)
    monkeypatch.setattr(interrupt, "select", Late())
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        network.spin(lambda: False, 20)
    assert time.monotonic() - start < 15
    assert len(Late.times) == 1 and Late.times[0] > 15


@default_signals()
def test_ctrl_c_ends_a_listeners_callback(network):
    """A listener that blocks on a terminal or a pipe is interrupted."""
    after = []

    def pressed_meanwhile(sample):
        signal.raise_signal(signal.SIGINT)
        after.append(sample)

    network.listen("/x", STRING, QoSProfile(), pressed_meanwhile)
    publisher(network, "/x").write(HELLO)
    with pytest.raises(KeyboardInterrupt):
        network.spin(lambda: False, 10)
    assert after == []


def test_a_domain_that_does_not_exist():
    with pytest.raises(MiddlewareError, match="233"):
        Network(233)
