"""What the agent and host programs join: one small contract, several networks.

``open_middleware(name)`` returns a :class:`~uros.middleware.base.Middleware`;
each lives in a module or package of its own that is imported only when asked for.

==================  ============================================================
``base``            the contract
``graph``           what a middleware knows of the ROS graph
``memory``          a network inside this process
``ced``             the same, with any text as a name
``dds``             Cyclone DDS, in the ROS 2 network
``ros2``            rclpy, on whatever RMW it uses
``auto``            topics over ``dds``, services over ``ros2``
``services``        what they share for services: names, request identity, pending endpoints
``discovery_info``  the ``ros_discovery_info`` topic: format, limits, Gid size
``type_conflicts``  topics that have several types
``environment``     ROS 2's variables for domain and discovery range
``ros_names``       DDS names as ROS names and types
``user_data``       keys in the USER_DATA QoS
``guid``            the parts of a GUID
``ref_counted``     values shared by several users
``security``        ROS 2's security variables, which are refused or warned of
``wakeup_fd``       a descriptor that wakes a selector from another thread
==================  ============================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .base import Middleware

# name → (module, the remedy when it cannot be imported)
NAMES = {
    "memory": ("uros.middleware.memory", ""),
    "ced": ("uros.middleware.ced", ""),
    "dds": ("uros.middleware.dds", "python -m pip install cyclonedds"),
    "ros2": (
        "uros.middleware.ros2",
        "source /opt/ros/<distro>/setup.bash and start with the Python of that distribution, or,"
        " on Python 3.11: python -m pip install ros-kilted-rclpy ros-kilted-rmw-fastrtps-cpp",
    ),
    "auto": ("uros.middleware.auto", "python -m pip install cyclonedds"),
}


def open_middleware(name: str) -> Middleware:
    """Return a middleware by name; it joins the network with its first node.

    Raises:
        ValueError: There is no such middleware.
        MiddlewareError: It cannot run here, or the environment demands security, which no
            middleware has (see :mod:`.security`).
    """
    from . import security
    from .base import MiddlewareError

    if name not in NAMES:
        raise ValueError(f"no middleware {name!r}; there are: {', '.join(sorted(NAMES))}")
    security.check(name)
    module, remedy = NAMES[name]
    try:
        opened: Middleware = import_module(module).create()
    except ImportError as error:
        missing = error.name or f"what it cannot load ({error})"
        raise MiddlewareError(f"the {name} middleware needs {missing}: {remedy}") from error
    return opened
