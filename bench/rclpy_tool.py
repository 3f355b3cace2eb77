"""A subscriber of rclpy that does what ``ros2 topic hz`` or ``echo`` does for each message.

    python bench/rclpy_tool.py hz|echo TOPIC

``hz`` takes the serialized message and the time, ``echo`` prints the message as YAML with PyYAML.
Ends on SIGINT, and ``hz`` then prints how many messages came.
"""

import sys
from collections import OrderedDict

import rclpy
import yaml
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

# Deeper than that of ros2, so that rclpy loses nothing by it that uros keeps.
QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def main() -> None:
    verb, topic = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("bench_tool")
    clock = node.get_clock()
    times: list[int] = []
    last = 0

    def measure(_: bytes) -> None:
        nonlocal last
        now = clock.now().nanoseconds
        times.append(now - last)
        last = now

    def echo(message: String) -> None:
        fields = OrderedDict(
            (name, getattr(message, name)) for name in message.get_fields_and_field_types()
        )
        print(yaml.dump(dict(fields), allow_unicode=True, width=sys.maxsize), end="---\n")

    if verb == "hz":
        node.create_subscription(String, topic, measure, QOS, raw=True)
    else:
        node.create_subscription(String, topic, echo, QOS)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    if verb == "hz":
        print(f"window: {len(times) - 1}")


if __name__ == "__main__":
    main()
