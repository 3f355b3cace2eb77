"""``uros topic hz``: print the average publishing rate of topics."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import deque
from typing import Final, NamedTuple

from ..common import add_common, add_topic, discover, join, positive_int
from ..waiting import topic_types

_WINDOW: Final = 10000
_PERIOD: Final = 1.0
_DEPTH: Final = 1000  # for all messages of one period


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic hz``."""
    add_topic(parser, "+")
    add_common(parser)
    parser.add_argument(
        "-w",
        "--window",
        metavar="N",
        type=positive_int,
        default=_WINDOW,
        help=f"average over so many messages (default: {_WINDOW})",
    )
    parser.add_argument("--wall-time", action="store_true", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Print the rates once a second until Ctrl-C."""
    from ...qos import QoSProfile, ReliabilityPolicy

    topics = list(dict.fromkeys(args.topic))
    rates = {topic: Rate(args.window) for topic in topics}
    try:
        with join(args) as network:
            discover(network, args)
            for topic in topics:
                rate = rates[topic]
                for type_name in topic_types(network, topic):
                    network.listen(
                        topic,
                        type_name,
                        QoSProfile(_DEPTH, ReliabilityPolicy.BEST_EFFORT),
                        lambda _got, rate=rate: rate.add(time.monotonic_ns()),  # type: ignore[misc]
                    )
            while True:
                network.spin(lambda: False, _PERIOD)
                sys.stdout.write(report(rates))
                sys.stdout.flush()
    except KeyboardInterrupt:
        return 0


class Statistics(NamedTuple):
    """Of the times between messages, in seconds. ``window`` is their number."""

    rate: float
    shortest: float
    longest: float
    deviation: float
    window: int


class Rate:
    """The last ``window`` times between messages of one topic."""

    def __init__(self, window: int) -> None:
        self._gaps: deque[int] = deque(maxlen=window)
        self._last: int | None = None
        self._fresh = False

    def add(self, now_ns: int) -> None:
        """Count a message that came at ``now_ns``."""
        if self._last is not None:
            self._gaps.append(now_ns - self._last)
            self._fresh = True
        self._last = now_ns

    def statistics(self) -> Statistics | None:
        """Return the statistics, or None if no message came since the last call."""
        if not self._fresh:
            return None
        self._fresh = False
        count = len(self._gaps)
        mean = sum(self._gaps) / count
        deviation = math.sqrt(sum((gap - mean) ** 2 for gap in self._gaps) / count)
        return Statistics(
            1e9 / mean if mean else 0.0,
            min(self._gaps) / 1e9,
            max(self._gaps) / 1e9,
            deviation / 1e9,
            count,
        )


def report(rates: dict[str, Rate]) -> str:
    """Return what ros2 prints once a second; nothing if no message came."""
    statistics = {topic: stats for topic, rate in rates.items() if (stats := rate.statistics())}
    if not statistics:
        return ""
    if len(rates) == 1:
        (stats,) = statistics.values()
        return (
            f"average rate: {stats.rate:.3f}\n"
            f"\tmin: {stats.shortest:.3f}s max: {stats.longest:.3f}s"
            f" std dev: {stats.deviation:.5f}s window: {stats.window}\n"
        )
    head = ("topic", "rate", "min_delta", "max_delta", "std_dev", "window")
    rows = [
        (
            topic,
            f"{stats.rate:.3f}",
            f"{stats.shortest:.3f}",
            f"{stats.longest:.3f}",
            f"{stats.deviation:.5f}",
            str(stats.window),
        )
        for topic, stats in statistics.items()
    ]
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = [
        "   ".join(name.center(width) for name, width in zip(head, widths, strict=True)),
        "=" * (sum(widths) + 3 * (len(widths) - 1)),
        *[
            "   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            for row in rows
        ],
    ]
    return "\n".join(lines) + "\n\n"
