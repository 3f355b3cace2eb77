"""The ros2 middleware: real ROS 2 nodes inside the agent, by rclpy, on any RMW.

It needs rclpy and the packages of the types that go over it, and speaks whatever the RMW of this
machine speaks. That is what ``dds`` cannot do for services: rmw_fastrtps marks requests and
replies in RTPS headers that Cyclone has no way to write.

===============  ===============================================================
``names``        DDS names as ROS names
``types``        the Python classes of types, by their names
``profiles``     QoS profiles as rclpy's
``rcl``          rclpy without its Node class, and its errors as ours
``later``        getting ``rcl`` and ``types`` ready while boards are served
``domain``       one rclpy context, and the thread that waits in its wait set
``endpoints``    publishers, subscriptions and both ends of services
``middleware``   the contract
===============  ===============================================================

rclpy's own ``Node`` would add a publisher of parameter events and parameters to each board; the
nodes here have what the board has and nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .middleware import Ros2Middleware


def create() -> Ros2Middleware:
    """A middleware on rclpy, configured by this process's environment.

    Raises MiddlewareError where rclpy cannot be used.
    """
    from .middleware import Ros2Middleware

    return Ros2Middleware()
