"""The networks that the agent and host programs join, all by one contract.

``open_middleware(name)`` returns a :class:`~uros.middleware.base.Middleware`;
each lives in a module or package of its own that is imported only when asked for.

====================  ==========================================================================
``base``              The contract of a middleware: nodes, endpoints, services, QoS and errors.
``qos_matching``      Finds the QoS policies that keep a writer and a reader from matching.
``partitions``        Finds out which partitions of a writer and a reader meet.
``domains``           Checks before a domain is joined.
``graph``             What a middleware knows of the ROS graph, by DDS names.
``memory``            A network inside this process, for tests and examples.
``ced``               The same, with any text as a name, as the CED middleware of the C++ agent.
``dds``               Nodes in the ROS 2 network by Cyclone DDS, without an installed ROS.
``rtps``              Nodes in the ROS 2 network by DDSI-RTPS in Python, without a DDS library.
``ros2``              Nodes in the ROS 2 network by rclpy, on any RMW.
``auto``              The default: topics on ``dds``, services on ``rtps``; or all on ``rtps``.
``cyclone_package``   Whether Cyclone can be used here, and what to do where it cannot.
``services``          What the middlewares share for services.
``discovery_info``    The ``ros_discovery_info`` topic: its format, its limits and its Gid size.
``sample_queue``      Samples that wait in a reader.
``paced_call``        A call after changes, at most once a second.
``type_conflicts``    Finds topics whose endpoints have different types.
``environment``       ROS 2's environment variables for the domain and the discovery range.
``cyclonedds_uri``    Cyclone's configuration in CYCLONEDDS_URI, and what rtps reads of it.
``ros_names``         Converts DDS names to ROS names and types.
``user_data``         Reads keys in the USER_DATA QoS.
``guid``              The parts of a GUID (RTPS 9.3.1).
``ref_counted``       Values with several users, destroyed after the last one.
``security``          Refuses or warns of ROS 2's security variables, which have no effect here.
``foreign_settings``  Warns of settings of Fast DDS, which have no effect here.
``wakeup_fd``         A file descriptor that wakes a selector from another thread.
====================  ==========================================================================
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
    "dds": ("uros.middleware.dds", ""),
    "rtps": ("uros.middleware.rtps", ""),
    "ros2": (
        "uros.middleware.ros2",
        "source /opt/ros/<distro>/setup.bash and start with the Python of that distribution, or,"
        " on Python 3.11: python -m pip install ros-kilted-rclpy ros-kilted-rmw-fastrtps-cpp",
    ),
    "auto": ("uros.middleware.auto", ""),
}


def open_middleware(name: str) -> Middleware:
    """Return a middleware by name; it joins the network with its first node.

    Raises:
        ValueError: There is no such middleware.
        MiddlewareError: It cannot run here, or the environment demands security, which no
            middleware has (see :mod:`.security`).
    """
    from . import cyclone_package, foreign_settings, security
    from .base import MiddlewareError

    if name not in NAMES:
        raise ValueError(f"no middleware {name!r}; there are: {', '.join(sorted(NAMES))}")
    security.check(name)
    foreign_settings.warn(name)
    module, remedy = NAMES[name]
    try:
        opened: Middleware = import_module(module).create()
    except ImportError as error:
        missing = error.name or f"what it cannot load ({error})"
        if name == "dds":
            remedy = cyclone_package.remedy()
        raise MiddlewareError(f"the {name} middleware needs {missing}: {remedy}") from error
    return opened
