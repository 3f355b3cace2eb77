"""The ros2 middleware: real ROS 2 nodes inside the agent, by rclpy, on any RMW.

It needs rclpy and the packages of the types it carries, and speaks what this machine's RMW speaks.
That is what ``dds`` cannot do for services: rmw_fastrtps puts the identity of requests and replies
into RTPS inline QoS, which Cyclone cannot write.

==============  ============================================================================
``types``       Finds the Python classes of ROS types by name.
``profiles``    Converts QoS profiles to rclpy's.
``rcl``         Calls rclpy below its Node class, and raises its errors as MiddlewareErrors.
``domain``      One rclpy context, and the thread that waits in its wait set.
``endpoints``   Publishers, subscriptions, service clients and servers of one node.
``middleware``  Implements the contract of :mod:`uros.middleware.base`.
==============  ============================================================================

rclpy's own ``Node`` would add a publisher of parameter events and parameters to each board; the
nodes here have what the board has and nothing else.
"""

from __future__ import annotations

from ..base import Middleware


def create() -> Middleware:
    """Return a middleware on rclpy, configured by this process's environment.

    Raises:
        MiddlewareError: rclpy does not work here.
    """
    from .middleware import Ros2Middleware

    return Ros2Middleware()
