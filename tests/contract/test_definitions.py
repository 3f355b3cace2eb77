"""A type with different definitions at the two ends: boards count, report once and continue.

The other end is Cyclone DDS with its own type of that name, like a ROS 2 node that was built with
another version of a package.
"""

from dataclasses import dataclass

import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, sequence
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from support.agent import running_agent
from support.nodes import Nodes

import uros
from uros.client import Node
from uros.host.direct import Direct
from uros.interfaces.dynamic import load
from uros.middleware import open_middleware
from uros.transport.udp import UdpTransport

NAME = "differ_msgs::msg::dds_::Reading_"
Reading = load("differ_msgs/msg/Reading", "int32 number\nstring name\nfloat64 value")
WRITER = Qos(
    Policy.Reliability.Reliable(max_blocking_time=10**9),
    Policy.History.KeepLast(10),
    Policy.Durability.TransientLocal,
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
READER = Qos(
    Policy.Reliability.Reliable(max_blocking_time=10**9),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@dataclass
class Same(IdlStruct, typename=NAME):
    number: int32
    name: str
    value: float64


@dataclass
class Added(IdlStruct, typename=NAME):
    number: int32
    name: str
    value: float64
    unit: str


@dataclass
class Removed(IdlStruct, typename=NAME):
    number: int32
    name: str


@dataclass
class OtherOrder(IdlStruct, typename=NAME):
    value: float64
    name: str
    number: int32


@dataclass
class OtherType(IdlStruct, typename=NAME):
    number: int32
    name: sequence[float32]
    value: float64


@dataclass
class OtherWidth(IdlStruct, typename=NAME):
    number: int32
    name: str
    value: float32


ADDED = Added(5, "five", 5.5, "K")
DIFFERENT = {
    "removed": Removed(5, "five"),
    "other order": OtherOrder(5.5, "five", 5),
    "other type": OtherType(5, [1.5, 1.5, 1.5], 5.5),
    "other width": OtherWidth(5, "five", 5.5),
}


@pytest.fixture
def boards(own_domain_id):
    """A function that creates nodes of boards with one agent."""
    with running_agent("udp", "dds", own_domain_id) as agent:
        nodes = Nodes(
            lambda name: Node(name, UdpTransport("127.0.0.1", agent.transport.port), key=0xD1FF)
        )
        yield nodes
        assert agent.error is None
        for node in nodes.made:
            node.destroy_node()


def end_of(domain, cls, end):
    """A DataWriter or DataReader of Cyclone DDS."""
    participant = DomainParticipant(domain)
    qos = WRITER if end is DataWriter else READER
    return end(participant, Topic(participant, "rt/reading", cls, qos=qos), qos=qos)


@pytest.mark.parametrize("message", DIFFERENT.values(), ids=DIFFERENT)
def test_a_message_of_another_definition_is_counted_and_reported_once(
    boards, own_domain_id, message
):
    received, reports = [], []
    node = boards("board")
    node.executor.report = reports.append
    subscription = node.create_subscription(Reading, "/reading", received.append)
    boards.connect()
    wrong = end_of(own_domain_id, type(message), DataWriter)
    for _ in range(3):
        wrong.write(message)
    boards.until(lambda: subscription.malformed == 3)
    (report,) = reports
    assert isinstance(report, ValueError)
    text = str(report)
    assert text.startswith("/reading: what came is no differ_msgs/msg/Reading (")
    assert "give both ends the same definition" in text
    right = end_of(own_domain_id, Same, DataWriter)
    right.write(Same(7, "seven", 7.5))
    boards.until(lambda: received)
    assert received == [Reading(7, "seven", 7.5)]
    assert subscription.malformed == 3 and len(reports) == 1


def test_an_additional_last_field_is_ignored(boards, own_domain_id):
    """The board ignores it, as Fast DDS does; Fast DDS itself sends padding at the end."""
    received = []
    node = boards("board")
    node.executor.report = lambda error: pytest.fail(str(error))
    node.create_subscription(Reading, "/reading", received.append)
    boards.connect()
    wrong = end_of(own_domain_id, Added, DataWriter)
    wrong.write(ADDED)
    boards.until(lambda: received)
    assert received == [Reading(5, "five", 5.5)]


@pytest.mark.parametrize("message", [*DIFFERENT.values(), ADDED], ids=[*DIFFERENT, "added"])
def test_a_boards_message_to_another_definition_does_no_harm(boards, own_domain_id, message):
    node = boards("board")
    node.executor.report = lambda error: pytest.fail(str(error))
    publisher = node.create_publisher(Reading, "/reading")
    boards.connect()
    wrong = end_of(own_domain_id, type(message), DataReader)
    right = end_of(own_domain_id, Same, DataReader)
    taken = []

    def done():
        publisher.publish(Reading(9, "nine", 9.5))
        taken.extend(right.take(10))
        return taken

    boards.until(done)
    assert taken[0] == Same(9, "nine", 9.5)
    wrong.take(10)  # Cyclone may take it or not


class Raw:
    """Octets published as a Reading."""

    _TYPE = Reading._TYPE
    _DDS_TYPE = Reading._DDS_TYPE

    def __init__(self, octets):
        self.octets = octets

    def cdr_size(self, o=0):
        return o + len(self.octets)

    def pack_into(self, buf, offset, start):
        buf[offset : offset + len(self.octets)] = self.octets
        return offset + len(self.octets)


def test_no_octets_harm_a_board(boards, own_domain_id):
    reports, received = [], []
    node = boards("board")
    node.executor.report = reports.append
    subscription = node.create_subscription(Reading, "/reading", received.append)
    boards.connect()
    sender = uros.Node("other", Direct(open_middleware("dds"), own_domain_id))
    boards.made.append(sender)
    publisher = sender.create_publisher(Raw, "/reading")
    good = bytearray(Reading(1, "one", 1.5).cdr_size())
    Reading(1, "one", 1.5).pack_into(good, 0, 0)
    boards.until(lambda: publisher.publish(Raw(good)) and received)
    for end in range(1, len(good)):
        for octets in (good[:end], b"\xff" * end):
            before = subscription.malformed
            publisher.publish(Raw(octets))
            boards.until(lambda before=before: subscription.malformed == before + 1)
    del received[:]
    publisher.publish(Raw(good))
    boards.until(lambda: received)
    assert received == [Reading(1, "one", 1.5)] and len(reports) == 1
