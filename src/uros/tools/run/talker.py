"""The talker of ROS 2's demos: publishes to the topic ``chatter`` once a second.

``uros run talker`` runs it, and so does
``python -m uros.tools.run.talker``.
"""

from typing import Any

import uros
from uros.interfaces import load

String = load("std_msgs/msg/String")


class Talker(uros.Node):
    """The node. ``options`` are those of `uros.Node`, such as ``domain_id``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("talker", **options)
        self.count = 0
        self.publisher = self.create_publisher(String, "chatter", 7)
        self.create_timer(1.0, self.say_hello)

    def say_hello(self) -> None:
        """Publish the next message."""
        self.count += 1
        message = String(data=f"Hello World: {self.count}")
        self.get_logger().info(f"Publishing: '{message.data}'")
        self.publisher.publish(message)


if __name__ == "__main__":
    node = Talker()
    node.spin()
    node.destroy_node()
