"""The listener of ROS 2's demos: prints the messages of the topic ``chatter``.

``uros run listener`` runs it, and so does ``python -m uros.tools.run.listener``.
"""

from typing import Any

import uros
from uros.interfaces import load
from uros.printable import printable

String = load("std_msgs/msg/String")


class Listener(uros.Node):
    """The node. ``options`` are those of `uros.Node`, such as ``domain_id``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("listener", **options)
        self.create_subscription(String, "chatter", self.heard, 10)

    def heard(self, message: Any) -> None:
        """Log a message."""
        self.get_logger().info(f"I heard: [{printable(message.data)}]")


if __name__ == "__main__":
    node = Listener()
    node.spin()
    node.destroy_node()
