"""A graph of rclpy nodes with everything that the cases of `test_ros2_cases.py` ask for.

Runs in an environment of its own without uros. Prints READY when all nodes exist; ends at the end
of its input.
"""

import sys
import threading

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_system_default
from rclpy.service_introspection import ServiceIntrospectionState
from std_msgs.msg import String
from test_msgs.action import Fibonacci
from test_msgs.msg import Arrays, BoundedSequences, Defaults, Strings, UnboundedSequences
from test_msgs.srv import BasicTypes

PERIOD = 0.25
PARAMETERS = {
    "flag": True,
    "flags": [False, True],
    "number": 42,
    "numbers": [1, 2, 3],
    "ratio": 1.25,
    "ratios": [0.5, 6.25],
    "text": "Hello World",
    "texts": ["a", "b c"],
    "arm.length": 0.75,
    "arm.hand.name": "left",
}


def topics():
    talker = rclpy.create_node("talker")
    talker.chatter = talker.create_publisher(String, "/chatter", 10)
    talker.whisper = talker.create_publisher(String, "/_whisper", 10)
    talker.count = 0
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    talker.ears = talker.create_subscription(String, "/ears", lambda message: None, latched)
    repeater = rclpy.create_node("repeater")
    repeater.outputs = [
        repeater.create_publisher(kind, topic, qos_profile_system_default)
        for kind, topic in (
            (Arrays, "/arrays"),
            (BoundedSequences, "/bounded_sequences"),
            (Defaults, "/defaults"),
            (UnboundedSequences, "/unbounded_sequences"),
        )
    ]
    repeater.ears = repeater.create_subscription(String, "/ears", lambda message: None, latched)
    repeater.velocity = repeater.create_publisher(TwistStamped, "/cmd_vel", 10)

    def publish():
        talker.count += 1
        talker.chatter.publish(String(data=f"Hello World: {talker.count}"))
        talker.whisper.publish(String(data="psst"))
        for output in repeater.outputs:
            output.publish(output.msg_type())
        stamped = TwistStamped()
        stamped.header.stamp = repeater.get_clock().now().to_msg()
        stamped.twist.linear.x = 1.0
        repeater.velocity.publish(stamped)

    talker.create_timer(PERIOD, publish)
    return [talker, repeater]


def complex_node(name):
    """A node with one endpoint of each kind; all its names are below its own one."""

    def execute(goal):
        sequence = [0, 1]
        while len(sequence) <= goal.request.order:
            sequence.append(sequence[-1] + sequence[-2])
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
        goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    node = rclpy.create_node(name)
    node.arrays = node.create_publisher(Arrays, "~/arrays", 10)
    node.strings = node.create_subscription(Strings, "~/strings", lambda message: None, 10)
    node.basic = node.create_service(BasicTypes, "~/basic", echo)
    node.fibonacci = ActionServer(node, Fibonacci, f"/{name}/fibonacci", execute)
    return node


def echo(request, response):
    for field in request.get_fields_and_field_types():
        setattr(response, field, getattr(request, field))
    return response


def parameters():
    node = rclpy.create_node("configured", namespace="/robot")
    for name, value in PARAMETERS.items():
        node.declare_parameter(name, value)
    return node


def introspected():
    """A service and its client that publish what they send and receive."""
    node = rclpy.create_node("introspected")
    contents = ServiceIntrospectionState.CONTENTS
    node.asked = node.create_service(BasicTypes, "~/echo", echo)
    node.asked.configure_introspection(node.get_clock(), qos_profile_system_default, contents)
    node.asking = node.create_client(BasicTypes, "~/echo")
    node.asking.configure_introspection(node.get_clock(), qos_profile_system_default, contents)
    request = BasicTypes.Request(bool_value=True, int32_value=42, string_value="asked")
    node.create_timer(PERIOD, lambda: node.asking.call_async(request))
    return node


def main():
    rclpy.init()
    nodes = [
        *topics(), complex_node("complex"), complex_node("_complex"), parameters(), introspected(),
        rclpy.create_node("twin"), rclpy.create_node("twin"),
        LifecycleNode("managed"), LifecycleNode("_managed"),
    ]  # fmt: skip
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("READY", flush=True)
    try:
        executor.spin()
    except ExternalShutdownException:
        pass


if __name__ == "__main__":
    main()
