"""What ROS 2's environment variables say about domains and discovery."""

from __future__ import annotations

import os
from collections.abc import Mapping

from .base import MAX_DOMAIN, MiddlewareError

RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")


class VariableError(MiddlewareError):
    """An environment variable has a value that does not exist."""


def environment_domain() -> int:
    """Return the domain in ROS_DOMAIN_ID, or 0 if it is not set.

    Raises:
        VariableError: The value is no domain.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if text and not (text.isdecimal() and int(text) <= MAX_DOMAIN):
        raise VariableError(f"ROS_DOMAIN_ID: {text!r} is not a domain; give 0 to {MAX_DOMAIN}")
    return int(text or 0)


def discovery_range(environment: Mapping[str, str]) -> str:
    """Return how far discovery reaches: one of :data:`RANGES`.

    ``ROS_LOCALHOST_ONLY=1`` counts if ``ROS_AUTOMATIC_DISCOVERY_RANGE`` is not set.

    Raises:
        VariableError: The value does not exist.
    """
    value = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if not value:
        return "LOCALHOST" if environment.get("ROS_LOCALHOST_ONLY") == "1" else "SUBNET"
    if value not in RANGES:
        raise VariableError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={value!r} does not exist;"
            f" set it to one of {', '.join(RANGES)}"
        )
    return value
