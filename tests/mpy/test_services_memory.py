"""Tests of the heap that parameters, log, life cycle and transforms take on a board, from .mpy."""

import pytest
from mpy.harness import MicroPython
from mpy.measures import heap_of_program

BASE = """
from uros.client import Node
from uros.transport.serial import StreamTransport

def run(port):
    node = Node("node", StreamTransport(port))
    publisher = node.create_publisher(None, "topic", 10)
    node.create_service(None, "service", print)
    node.create_timer(1.0, lambda: publisher.publish(None))
    node.spin()
"""
PARAMETERS = (
    BASE
    + """
    node.declare_parameter("rate", 1)
    print(node.get_parameter("rate").value)
"""
)
PERSISTED = (
    """
from uros.client.parameter_file import ParameterFile
from uros.client.parameters import IntegerRange, Parameter, ParameterDescriptor, ParameterServer
"""
    + BASE
    + """
    ParameterServer(node, persist=ParameterFile("params.json"))
    rules = ParameterDescriptor(integer_range=[IntegerRange(0, 5)])
    print(node.declare_parameter("rate", 1, rules).value)
    node.add_on_set_parameters_callback(print)
    node.set_parameters([Parameter("rate", value=2)])
"""
)
LOG = (
    BASE
    + """
    node.get_logger().info("started")
"""
)
LIFECYCLE = BASE.replace(
    "from uros.client import Node",
    """
from uros.client.lifecycle import LifecycleNode as Node
""".strip(),
).replace("create_publisher", "create_lifecycle_publisher")
TF = (
    "from uros.client.tf import TransformBroadcaster\n"
    + BASE
    + """
    TransformBroadcaster(node).sendTransform(None)
"""
)
STATIC = TF.replace("TransformBroadcaster", "StaticTransformBroadcaster")

# Bytes more than the node alone: today's cost and a tenth. They include the QoS profiles of the log
# and the static transforms.
LIMITS = {
    "parameters": (PARAMETERS, 15_500),
    "parameters kept in a file": (PERSISTED, 19_500),
    "log": (LOG, 7_800),
    "life cycle": (LIFECYCLE, 9_000),
    "transforms": (TF, 1_800),
    "static transforms": (STATIC, 4_000),
}


@pytest.fixture(scope="module")
def base() -> int:
    with MicroPython() as board:
        return heap_of_program(board, BASE)


@pytest.mark.slow
@pytest.mark.parametrize("service", LIMITS)
def test_heap_of_a_service(micropython: MicroPython, base: int, service: str) -> None:
    program, limit = LIMITS[service]
    cost = heap_of_program(micropython, program) - base
    print(f"\n{service}: {cost} bytes")
    assert cost <= limit
