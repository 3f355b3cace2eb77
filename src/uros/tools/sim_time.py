"""Simulation time: ``-s/--use-sim-time``, and the time that the topic ``/clock`` tells."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from .values.message_reader import MessageReader

if TYPE_CHECKING:
    from ..host.network import Network, Received

TOPIC: Final = "/clock"
_TYPE: Final = "rosgraph_msgs/msg/Clock"


def add_use_sim_time(parser: argparse.ArgumentParser, used: bool = True) -> None:
    """Declare ``-s/--use-sim-time``.

    Args:
        parser: Where to declare it.
        used: Whether the verb reads a clock; the others accept the option, as in ros2.
    """
    parser.add_argument(
        "-s",
        "--use-sim-time",
        action="store_true",
        help=f"use the time of {TOPIC} instead of the system's" if used else argparse.SUPPRESS,
    )


def clock(network: Network, args: argparse.Namespace) -> Callable[[], int]:
    """Return the function that tells the time in ns: of the system, or with ``-s`` of /clock."""
    return SimTime(network).now if args.use_sim_time else time.time_ns


class SimTime:
    """The latest time that a simulator or a player has published on ``/clock``.

    Args:
        network: The domain. Its event loop receives the time.
    """

    def __init__(self, network: Network) -> None:
        from ..interfaces import load
        from ..qos import QoSProfile, ReliabilityPolicy

        self._reader = MessageReader(load(_TYPE))
        self._now = 0
        network.listen(TOPIC, _TYPE, QoSProfile(1, ReliabilityPolicy.BEST_EFFORT), self._on_clock)

    def now(self) -> int:
        """Return the time in ns; 0 until the first message."""
        return self._now

    def _on_clock(self, received: Received) -> None:
        message = self._reader.read(received.cdr)
        if message is not None:
            self._now = message.clock.sec * 1_000_000_000 + message.clock.nanosec
