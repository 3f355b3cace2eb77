"""A domain of one process: our node, its graph, and what it hears, through real DDS."""

import pytest

from uros.host.network import Network
from uros.middleware.base import MiddlewareError
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

STRING = "std_msgs/msg/String"
DDS_STRING = "std_msgs::msg::dds_::String_"
HELLO = b"\0\1\0\0\6\0\0\0hello\0"


@pytest.fixture
def network(own_domain_id):
    with Network(own_domain_id) as joined:
        yield joined


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
    assert (qos.depth, qos.lifespan_ms, qos.deadline_ms) == (3, 1500, 20)
    assert qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.partitions == ("p",) and qos.liveliness_lease_ms is None
    writer.close()
    assert network.spin(lambda: not network.graph.publishers("/x"), 10)


def test_listening(network):
    heard = []
    end = network.listen("/x", STRING, QoSProfile(), heard.append)
    writer = publisher(network, "/x")
    writer.write(HELLO)
    assert network.spin(lambda: heard, 10)
    assert heard[0].cdr[:14] == HELLO
    assert 0 < heard[0].source_ns <= heard[0].received_ns
    assert network.spin(lambda: network.graph.subscriptions("/x"), 10)
    (subscription,) = network.graph.subscriptions("/x")
    assert subscription.type_name == STRING
    end()
    end()
    assert network.spin(lambda: not network.graph.subscriptions("/x"), 10)


def test_late_listeners_get_what_is_kept(network):
    kept = {"durability": DurabilityPolicy.TRANSIENT_LOCAL, "depth": 1}
    publisher(network, "/x", **kept).write(HELLO)
    heard = []
    network.listen("/x", STRING, QoSProfile(**kept), heard.append)
    assert network.spin(lambda: heard, 10)


def test_more_than_one_batch_is_taken_at_once(network):
    heard = []
    deep = {"depth": 500, "reliability": ReliabilityPolicy.RELIABLE}
    network.listen("/x", STRING, QoSProfile(**deep), heard.append)
    writer = publisher(network, "/x", **deep)
    for _ in range(200):
        assert writer.write(HELLO)
    assert network.spin(lambda: len(heard) == 200, 10)


def test_time_limits_of_a_spin(network):
    assert network.spin(lambda: True)
    assert not network.spin(lambda: False, 0.01)


def test_a_domain_that_does_not_exist():
    with pytest.raises(MiddlewareError, match="233"):
        Network(233)
