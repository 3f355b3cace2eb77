"""What the variables of ROS 2's security (SROS 2) do here: nothing, and that is said aloud.

Neither boards nor this agent have DDS Security. Who asks ROS 2 for it must not find out later that
everything went in the clear.
"""

from __future__ import annotations

import os

from .base import MiddlewareError

_REMEDY = (
    "uros has no DDS Security (SROS 2), so everything it sends to ROS 2 goes in the clear; keep the"
    " agent in a network of its own (docs/security.md)"
)


def check(middleware: str) -> None:
    """Whether a middleware may be joined as the environment wants security.

    Raises MiddlewareError where ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce;
    warns where only the first is. ``memory`` and ``ced`` send nothing to
    anybody.
    """
    # ROS 2 wants "true" and "Enforce" to the letter; who has written TRUE meant no less.
    enabled = os.environ.get("ROS_SECURITY_ENABLE", "").strip().lower()
    if enabled not in ("true", "1", "yes", "on") or middleware in ("memory", "ced"):
        return
    if os.environ.get("ROS_SECURITY_STRATEGY", "").strip().lower() == "enforce":
        raise MiddlewareError(
            f"ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, but {_REMEDY}, and"
            " unset ROS_SECURITY_ENABLE for it"
        )
    import logging  # seldom needed

    logging.getLogger("uros").warning("uros: ROS_SECURITY_ENABLE is true, but %s", _REMEDY)
