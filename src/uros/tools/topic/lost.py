"""Tells how many messages a command has not received, or had no time for."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from ..waiting import warn

if TYPE_CHECKING:
    from ...host.network import Network

_PERIOD: Final = 1.0  # seconds between two warnings


class LostReport:
    """Warns about lost messages, once a second at most.

    Args:
        network: The domain, whose subscriptions are counted.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._told = 0
        self._next = 0.0

    def tell(self, skipped: int = 0, last: bool = False) -> None:
        """Warn if messages were lost since the last warning.

        Args:
            skipped: How many messages the command itself has skipped until now.
            last: Whether the command ends, and does not wait for the next second.
        """
        now = time.monotonic()
        if now < self._next and not last:
            return
        lost = self._network.lost() + skipped
        full, self._network.overflowed = self._network.overflowed, False
        if lost > self._told or full:
            self._next = now + _PERIOD
            more = "; some more, as the queue of --qos-depth messages was full" if full else ""
            warn(f"{lost - self._told} messages were lost or skipped, {lost} in all{more}")
            self._told = lost
