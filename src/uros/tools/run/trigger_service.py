"""A service that a board can call: ``srv_trigger_py``, a std_srvs/Trigger.

Its responses are success and failure by turns, with numbered messages:
``Response[0]``, ``Response[1]`` ... ``uros run trigger_service`` runs it.
"""

from typing import Any

import uros
from uros.interfaces import load

Trigger = load("std_srvs/srv/Trigger")


class TriggerService(uros.Node):
    """The node. ``options`` are those of `uros.Node`, such as ``domain_id``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("trigger_service", **options)
        self.count = 0
        self.create_service(Trigger, "srv_trigger_py", self.triggered)

    def triggered(self, request: Any, response: Any) -> Any:
        """Fill the response, success and failure by turns."""
        self.get_logger().info("incoming request")
        response.success = self.count % 2 == 0
        response.message = f"Response[{self.count}]"
        self.count += 1
        self.get_logger().info(response.message)
        return response


if __name__ == "__main__":
    node = TriggerService()
    node.spin()
    node.destroy_node()
