"""A board with parameters, a life cycle, a log and transforms.

config.py in the same folder has NAME, the name of the node.
"""

from config import NAME
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Int32

from uros.client.lifecycle import LifecycleNode, TransitionCallbackReturn
from uros.client.parameters import (
    FloatingPointRange,
    IntegerRange,
    Parameter,
    ParameterDescriptor,
    SetParametersResult,
)
from uros.client.tf import StaticTransformBroadcaster, TransformBroadcaster
from uros.drivers.port import open_port
from uros.transport.serial import StreamTransport

node = None
count = 0


class Camera(LifecycleNode):
    """A node that refuses to be configured while its parameter ``broken`` is set."""

    def on_configure(self, state):
        if self.get_parameter("broken").value:
            self.get_logger().error("the camera is broken")
            return TransitionCallbackReturn.FAILURE
        return LifecycleNode.on_configure(self, state)


def transform(child, x):
    message = TransformStamped()
    message.header.frame_id, message.child_frame_id = "base", child
    message.transform.translation.x = x
    message.transform.rotation.w = 1.0
    return message


def decide(parameters):
    for parameter in parameters:
        if parameter.name == "int" and parameter.value == 13:
            return SetParametersResult(successful=False, reason="13 brings bad luck")
        if parameter.name == "int" and parameter.value == 99:
            raise RuntimeError("99 is a trap")
    return SetParametersResult(successful=True)


def declare():
    node.add_on_set_parameters_callback(decide)
    node.declare_parameter("bool", True)
    node.declare_parameter(
        "int", 4, ParameterDescriptor(
            description="how many", additional_constraints="no 13",
            integer_range=[IntegerRange(-100, 100, 1)],
        ),
    )  # fmt: skip
    node.declare_parameter(
        "float", 0.5,
        ParameterDescriptor(floating_point_range=[FloatingPointRange(0.0, 1.0, 0.25)]),
    )  # fmt: skip
    node.declare_parameter("text", "grün")
    node.declare_parameter("octets", b"\x00\xff")
    node.declare_parameter("arm.bools", [True, False])
    node.declare_parameter("arm.ints", [1, -(2**63)])
    node.declare_parameter("arm.left.floats", [0.25, -1e300])
    node.declare_parameter("arm.left.texts", ["a", ""])
    node.declare_parameter("fixed", 1, ParameterDescriptor(read_only=True))
    node.declare_parameter("any", None, ParameterDescriptor(dynamic_typing=True))
    node.declare_parameter("later", Parameter.Type.INTEGER)
    node.declare_parameter("broken", False)


def start():
    global node
    port = open_port(0x045B, 0x2013, "Renesas", NAME, "000001")
    node = Camera(NAME, StreamTransport(port), namespace=NAME)
    log = node.get_logger()
    log.info("switched on")
    declare()
    numbers = node.create_lifecycle_publisher(Int32, "numbers")
    static = StaticTransformBroadcaster(node)
    static.sendTransform([transform("camera", 0.5), transform("laser", -0.5)])
    moving = TransformBroadcaster(node)
    wheel = transform("wheel", 0.0)

    def tick():
        global count
        count += 1
        numbers.publish(Int32(data=count))
        node.clock.stamp(wheel.header.stamp)
        wheel.transform.translation.x = float(count)
        moving.sendTransform(wheel)
        log.warn("tick %d" % count, throttle_duration_sec=1.0)

    node.create_timer(0.1, tick)


def step():
    node.spin_once(0.1)


def main():
    start()
    while True:
        step()


if __name__ == "__main__":
    main()
