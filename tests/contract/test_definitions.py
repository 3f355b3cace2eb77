"""A type that both sides define, and not alike: boards count, say it once and go on.

The other side is Cyclone DDS with a type of that name of its own, as a ROS 2 node has it that was
built with another version of a package.
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
    """Makes nodes of boards behind one agent; ``reports`` is what they say."""
    with running_agent("udp", "dds", own_domain_id) as agent:
        nodes = Nodes(
            lambda name: Node(name, UdpTransport("127.0.0.1", agent.transport.port), key=0xD1FF)
        )
        yield nodes
        assert agent.error is None
        for node in nodes.made:
            node.destroy_node()


def end_of(domain, cls, end):
    """A writer or reader of Cyclone's own."""
    participant = DomainParticipant(domain)
    qos = WRITER if end is DataWriter else READER
    return end(participant, Topic(participant, "rt/reading", cls, qos=qos), qos=qos)


@pytest.mark.parametrize("message", DIFFERENT.values(), ids=DIFFERENT)
def test_what_another_definition_sends_is_counted_and_told_once(boards, own_domain_id, message):
    heard, reports = [], []
    node = boards("board")
    node.executor.report = reports.append
    subscription = node.create_subscription(Reading, "/reading", heard.append)
    boards.connect()
    wrong = end_of(own_domain_id, type(message), DataWriter)
    for _ in range(3):
        wrong.write(message)
    boards.until(lambda: subscription.malformed == 3)
    (report,) = reports
    assert isinstance(report, ValueError)
    said = str(report)
    assert said.startswith("/reading: what came is no differ_msgs/msg/Reading (")
    assert "give both ends the same definition" in said
    right = end_of(own_domain_id, Same, DataWriter)
    right.write(Same(7, "seven", 7.5))
    boards.until(lambda: heard)
    assert heard == [Reading(7, "seven", 7.5)]
    assert subscription.malformed == 3 and len(reports) == 1


def test_a_field_more_at_the_end_is_left_out(boards, own_domain_id):
    """As Fast DDS does; and Fast DDS itself sends octets behind that mean nothing."""
    heard = []
    node = boards("board")
    node.executor.report = lambda error: pytest.fail(str(error))
    node.create_subscription(Reading, "/reading", heard.append)
    boards.connect()
    wrong = end_of(own_domain_id, Added, DataWriter)
    wrong.write(ADDED)
    boards.until(lambda: heard)
    assert heard == [Reading(5, "five", 5.5)]


@pytest.mark.parametrize("message", [*DIFFERENT.values(), ADDED], ids=[*DIFFERENT, "added"])
def test_what_a_board_sends_to_another_definition_harms_nobody(boards, own_domain_id, message):
    node = boards("board")
    node.executor.report = lambda error: pytest.fail(str(error))
    publisher = node.create_publisher(Reading, "/reading")
    boards.connect()
    wrong = end_of(own_domain_id, type(message), DataReader)
    right = end_of(own_domain_id, Same, DataReader)
    came = []

    def done():
        publisher.publish(Reading(9, "nine", 9.5))
        came.extend(right.take(10))
        return came

    boards.until(done)
    assert came[0] == Same(9, "nine", 9.5)
    wrong.take(10)  # whatever Cyclone makes of it


class Raw:
    """Octets that say they are a reading."""

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
    reports, heard = [], []
    node = boards("board")
    node.executor.report = reports.append
    subscription = node.create_subscription(Reading, "/reading", heard.append)
    boards.connect()
    other = uros.Node("other", Direct(open_middleware("dds"), own_domain_id))
    boards.made.append(other)
    publisher = other.create_publisher(Raw, "/reading")
    good = bytearray(Reading(1, "one", 1.5).cdr_size())
    Reading(1, "one", 1.5).pack_into(good, 0, 0)
    boards.until(lambda: publisher.publish(Raw(good)) and heard)
    for end in range(1, len(good)):
        for octets in (good[:end], b"\xff" * end):
            before = subscription.malformed
            publisher.publish(Raw(octets))
            boards.until(lambda before=before: subscription.malformed == before + 1)
    del heard[:]
    publisher.publish(Raw(good))
    boards.until(lambda: heard)
    assert heard == [Reading(1, "one", 1.5)] and len(reports) == 1
