"""What ROS 2's environment variables say about domains and discovery."""

from __future__ import annotations

import os
from collections.abc import Mapping

from .base import MAX_DOMAIN, MiddlewareError

RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")


def environment_domain() -> int:
    """Return the domain in ROS_DOMAIN_ID, or 0 if it is not set.

    Raises:
        MiddlewareError: The value is no domain.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if text and not (text.isdecimal() and int(text) <= MAX_DOMAIN):
        raise MiddlewareError(f"ROS_DOMAIN_ID: {text!r} is no domain; give 0 to {MAX_DOMAIN}")
    return int(text or 0)


def discovery_range(environment: Mapping[str, str]) -> str:
    """Return how far discovery reaches: one of :data:`RANGES`.

    ``ROS_LOCALHOST_ONLY=1`` counts if ``ROS_AUTOMATIC_DISCOVERY_RANGE`` is not set.

    Raises:
        MiddlewareError: The value does not exist.
    """
    value = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if not value:
        return "LOCALHOST" if environment.get("ROS_LOCALHOST_ONLY") == "1" else "SUBNET"
    if value not in RANGES:
        raise MiddlewareError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={value!r} does not exist;"
            f" set it to one of {', '.join(RANGES)}"
        )
    return value
