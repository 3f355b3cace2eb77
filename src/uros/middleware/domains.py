"""Checks before a middleware joins a domain."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from .base import MiddlewareError

# Attack: a node in each of the 233 domains. Each costs sockets, with Cyclone threads too, and is
# open until the agent ends; 1024 descriptors are the usual limit of a process.
MAX_JOINED: Final = 32


def check_number_joined(number: int, joined: Collection[int]) -> None:
    """Check that one more domain may be joined.

    Args:
        number: The domain.
        joined: The domains that are joined.

    Raises:
        MiddlewareError: There are :data:`MAX_JOINED` already.
    """
    if len(joined) >= MAX_JOINED:
        raise MiddlewareError(
            f"domain {number} would be one more than the {MAX_JOINED} that this agent may join: let"
            " it have an agent of its own"
        )


def check_loopback(number: int, stays_on_loopback: bool, besides: str = "") -> None:
    """Check that a participant may be limited to this machine, as a client asks.

    Args:
        number: The domain.
        stays_on_loopback: Whether no packet of the domain leaves this machine.
        besides: What the remedy is besides the discovery range.

    Raises:
        MiddlewareError: The domain is open to the network.
    """
    if not stays_on_loopback:
        raise MiddlewareError(
            f"a client wants a participant that never leaves this machine, and domain {number} is"
            " open to the network: start the agent with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
            f"{besides}"
        )
