"""Services of a host's node, as of a board's: parameters, log, life cycle, transforms."""

import time

import pytest

import uros
from uros.client.lifecycle import TransitionCallbackReturn
from uros.client.parameter_file import ParameterFile
from uros.client.parameters import (
    IntegerRange,
    Parameter,
    ParameterDescriptor,
    ParameterServer,
    SetParametersResult,
)
from uros.client.tf import StaticTransformBroadcaster, TransformBroadcaster
from uros.host.direct import Direct
from uros.host.lifecycle import LifecycleNode
from uros.interfaces import load
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.qos import DurabilityPolicy, QoSProfile

SECONDS = 10.0
LATCHED = QoSProfile(100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def nodes():
    """Creates nodes on one network; ``nodes.until(done)`` spins all of them."""

    class Nodes:
        bus = Bus()
        created = []

        def __call__(self, name, make=uros.Node, **options):
            self.created.append(make(name, Direct(MemoryMiddleware(self.bus)), **options))
            return self.created[-1]

        def until(self, done):
            deadline = time.monotonic() + SECONDS
            while not done():
                assert time.monotonic() < deadline, "the condition did not become true"
                for node in self.created:
                    node.spin_once(0.005)

        def call(self, node, type_name, service, **fields):
            cls = load(type_name)
            client = node.create_client(cls, service)
            future = client.call_async(cls.Request(**fields))
            self.until(future.done)
            return future.result()

    nodes = Nodes()
    nodes.created = []
    yield nodes
    for node in nodes.created:
        node.destroy_node()


def test_parameters_are_read_set_and_announced(nodes, tmp_path):
    node, other = nodes("arm", namespace="left"), nodes("other")
    events = []
    event = load("rcl_interfaces/msg/ParameterEvent")
    other.create_subscription(event, "/parameter_events", events.append)
    ParameterServer(node, persist=ParameterFile(str(tmp_path / "params.json")))
    descriptor = load("rcl_interfaces/msg/ParameterDescriptor")(
        description="how fast",
        integer_range=[load("rcl_interfaces/msg/IntegerRange")(from_value=0, to_value=9)],
    )
    assert node.declare_parameter("speed", 5, descriptor).value == 5
    result = load("rcl_interfaces/msg/SetParametersResult")
    node.add_on_set_parameters_callback(
        lambda parameters: result(successful=parameters[0].value != 7, reason="not 7")
    )
    value = load("rcl_interfaces/msg/ParameterValue")
    message = load("rcl_interfaces/msg/Parameter")

    def set(number):
        answer = nodes.call(
            other, "rcl_interfaces/srv/SetParameters", "/left/arm/set_parameters",
            parameters=[message(name="speed", value=value(type=2, integer_value=number))],
        )  # fmt: skip
        return answer.results[0].successful, answer.results[0].reason

    assert set(8) == (True, "") and set(7) == (False, "not 7")
    assert not set(10)[0] and "out of range" in set(10)[1]
    values = nodes.call(
        other, "rcl_interfaces/srv/GetParameters", "/left/arm/get_parameters", names=["speed"]
    )
    assert [entry.integer_value for entry in values.values] == [8]
    described = nodes.call(
        other, "rcl_interfaces/srv/DescribeParameters", "/left/arm/describe_parameters",
        names=["speed"],
    ).descriptors[0]  # fmt: skip
    assert described.description == "how fast" and described.integer_range[0].to_value == 9
    nodes.until(lambda: events and events[-1].changed_parameters)
    assert events[-1].node == "/left/arm"
    assert node.get_parameter("speed").get_parameter_value().integer_value == 8
    assert Parameter.from_parameter_msg(events[-1].changed_parameters[0]).value == 8


def test_descriptors_and_results_of_uros_are_accepted_too(nodes):
    node = nodes("arm")
    node.declare_parameter("n", 2, ParameterDescriptor(integer_range=[IntegerRange(0, 4, 2)]))
    node.add_on_set_parameters_callback(lambda parameters: SetParametersResult(False, "no"))
    results = node.set_parameters([Parameter("n", value=4)])
    assert [result.reason for result in results] == ["no"]


def test_late_joiners_receive_the_log(nodes):
    node = nodes("arm", namespace="left")
    lines = []
    node.get_logger()
    node._rosout.console = lines.append
    assert node.get_logger().warning("hot", once=True)
    received = []
    nodes("other").create_subscription(
        load("rcl_interfaces/msg/Log"), "/rosout", received.append, LATCHED
    )
    nodes.until(lambda: received)
    assert (received[0].name, received[0].msg, received[0].level) == ("left.arm", "hot", 30)
    assert abs(received[0].stamp.sec - time.time()) < 60
    assert lines[0].startswith("[WARN] [") and lines[0].endswith("[left.arm]: hot")

    def bad():
        raise RuntimeError("no oil")

    node.create_timer(0.01, bad)
    nodes.until(lambda: len(received) > 1)
    assert received[1].level == 40 and "no oil" in received[1].msg and "in bad" in received[1].msg


def test_a_life_cycle_is_driven_by_service_calls(nodes):
    class Camera(LifecycleNode):
        def on_activate(self, state):
            return TransitionCallbackReturn.FAILURE if self.broken else super().on_activate(state)

    camera, other = nodes("camera", Camera), nodes("other")
    camera.broken = True
    number = load("std_msgs/msg/Int32")
    publisher = camera.create_lifecycle_publisher(number, "n")
    steps = []
    other.create_subscription(
        load("lifecycle_msgs/msg/TransitionEvent"), "/camera/transition_event", steps.append
    )
    transition = load("lifecycle_msgs/msg/Transition")

    def change(id):
        return nodes.call(
            other, "lifecycle_msgs/srv/ChangeState", "/camera/change_state",
            transition=transition(id=id),
        ).success  # fmt: skip

    assert change(1) and not change(3) and not publisher.publish(number())
    camera.broken = False
    assert change(3) and publisher.publish(number())
    state = nodes.call(other, "lifecycle_msgs/srv/GetState", "/camera/get_state").current_state
    assert (state.id, state.label) == (3, "active")
    nodes.until(lambda: len(steps) == 6)
    assert [step.goal_state.label for step in steps] == [
        "configuring", "inactive", "activating", "inactive", "activating", "active",
    ]  # fmt: skip


def test_late_joiners_receive_static_transforms(nodes):
    node = nodes("arm")
    transform = load("geometry_msgs/msg/TransformStamped")()
    transform.header.frame_id, transform.child_frame_id = "base", "camera"
    static, moving = StaticTransformBroadcaster(node), TransformBroadcaster(node)
    assert static.sendTransform(transform)
    received, moved = [], []
    message, other = load("tf2_msgs/msg/TFMessage"), nodes("other")
    other.create_subscription(message, "/tf_static", received.append, LATCHED)
    other.create_subscription(message, "/tf", moved.append)
    nodes.until(lambda: received)
    assert received == [message(transforms=[transform])]
    assert moving.sendTransform([transform, transform])
    nodes.until(lambda: moved)
    assert moved == [message(transforms=[transform, transform])]
