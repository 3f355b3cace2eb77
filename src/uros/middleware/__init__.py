"""What the agent and host programs join: one small contract, several networks.

``open_middleware(name)`` returns a :class:`~uros.middleware.base.Middleware`;
each lives in a module or package of its own that is imported only when asked for.

============  ==================================================================
``base``      the contract
``graph``     what a middleware can tell of the ROS graph
``memory``    a network inside this process
``ced``       the same, with names that are any text
``dds``       Cyclone DDS, in the ROS 2 network
``ros2``      rclpy, on whatever RMW it uses
``auto``      topics over ``dds``, services over ``ros2``
``late``      ends of services that are asked for before they can be made
``security``  that there is none of ROS 2's
``wake``      waking a selector from another thread
============  ==================================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .base import Middleware

# name → (module, what to say when it cannot be imported)
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
    """A middleware by name, not opened to the network until its first node.

    Raises ValueError for an unknown name, and
    :class:`~uros.middleware.base.MiddlewareError` where it cannot run here, or where the
    environment demands a security that it has not (see :mod:`.security`).
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
