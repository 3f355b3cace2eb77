"""ROS 2's security variables (SROS 2): they have no effect here, and the user is warned.

Neither boards nor this agent have DDS Security. A user who enables it for ROS 2 must not find out
later that everything was sent in the clear.
"""

from __future__ import annotations

import os

from .base import MiddlewareError

_REMEDY = (
    "uros has no DDS Security (SROS 2), so everything it sends to ROS 2 goes in the clear; keep the"
    " agent in a network of its own (docs/security.md)"
)


def check(middleware: str) -> None:
    """Check that a middleware may be used if the environment enables security.

    Warns if ROS_SECURITY_ENABLE is true. ``memory`` and ``ced`` send nothing out of the process.

    Raises:
        MiddlewareError: ROS_SECURITY_STRATEGY is Enforce as well.
    """
    # ROS 2 accepts "true" and "Enforce" to the letter; a user who wrote TRUE meant the same.
    enabled = os.environ.get("ROS_SECURITY_ENABLE", "").strip().lower()
    if enabled not in ("true", "1", "yes", "on") or middleware in ("memory", "ced"):
        return
    if os.environ.get("ROS_SECURITY_STRATEGY", "").strip().lower() == "enforce":
        raise MiddlewareError(
            f"ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, but {_REMEDY}, and"
            " unset ROS_SECURITY_ENABLE for it"
        )
    import logging  # rarely needed

    logging.getLogger("uros").warning("uros: ROS_SECURITY_ENABLE is true, but %s", _REMEDY)
