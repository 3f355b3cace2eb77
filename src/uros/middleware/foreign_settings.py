"""Settings of Fast DDS in the environment: they have no effect here, and the user is warned.

With a discovery server, or with peers and interfaces in a profile, a user would otherwise look for
the reason why nodes do not find each other.
"""

from __future__ import annotations

import os
from typing import Final

_PROFILES: Final = (
    "uros reads no profiles of Fast DDS: set peers by ROS_STATIC_PEERS, interfaces by"
    " CYCLONEDDS_URI, and boards' profiles by uros agent --refs"
)
_SETTINGS: Final = {
    "ROS_DISCOVERY_SERVER": (
        "uros has no discovery server: nodes that use it are not found; start them without it, and"
        " list their hosts in ROS_STATIC_PEERS where multicast does not reach them"
    ),
    "FASTRTPS_DEFAULT_PROFILES_FILE": _PROFILES,
    "FASTDDS_DEFAULT_PROFILES_FILE": _PROFILES,
}


def warn(middleware: str) -> None:
    """Warn of settings that a middleware does not know; ``ros2`` is on rclpy, which may."""
    if middleware not in ("auto", "dds", "rtps"):
        return
    for name, text in _SETTINGS.items():
        if os.environ.get(name, "").strip():
            import logging  # rarely needed

            logging.getLogger("uros").warning("uros: %s has no effect: %s", name, text)
