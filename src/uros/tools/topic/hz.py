"""``uros topic hz``: print the average publishing rate of topics."""

from __future__ import annotations

import argparse
import math
from collections import deque
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ..values.expression import Expression
from ..values.message_reader import MessageReader
from ..values.typed_values import load_message
from .measure import Count, add_topics, check_topics, measure, table
from .measure import add_arguments as add_measuring

if TYPE_CHECKING:
    from ...host.network import Received

_WINDOW: Final = 10000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic hz``."""
    add_topics(parser)
    add_measuring(parser, _WINDOW)
    parser.add_argument(
        "--filter",
        metavar="EXPR",
        help="count only messages m for which this expression is true, such as 'm.data > 3'",
    )
    parser.add_argument(
        "--wall-time", action="store_true", help="use the system's time, even with --use-sim-time"
    )


def run(args: argparse.Namespace) -> int:
    """Print the rates once a second until Ctrl-C.

    Raises:
        UsageError: The filter is not an expression, or there is no topic.
        ToolError: The filter does not fit the messages.
    """
    check_topics(args)
    expression = None if args.filter is None else Expression(args.filter)
    args.use_sim_time = args.use_sim_time and not args.wall_time

    def counting(rate: Rate, type_name: str) -> Count:
        if expression is None:
            return lambda _received, now_ns: rate.add(now_ns)
        return _Filtered(rate, expression, load_message(type_name)).count

    return measure(
        args,
        None if args.all else args.topic,
        lambda: Rate(args.window),
        counting,
        lambda rates, _now: report(rates, len(rates) == 1 and not args.all),
        args.all or len(args.topic) > 1,
    )


class _Filtered:
    """Counts the messages that an expression accepts."""

    def __init__(self, rate: Rate, expression: Expression, message_class: Any) -> None:
        self._rate = rate
        self._wanted = expression.check(message_class)
        self._reader = MessageReader(message_class)

    def count(self, received: Received, now_ns: int) -> None:
        """Count a message."""
        message = self._reader.read(received.cdr)
        if message is not None and self._wanted(message):
            self._rate.add(now_ns)


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

    def reset(self) -> None:
        """Forget all messages."""
        self._gaps.clear()
        self._last = None
        self._fresh = False

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


def report(rates: dict[str, Rate], single: bool) -> str:
    """Return what ros2 prints once a second; nothing if no message came.

    Args:
        rates: The rates by topic.
        single: Whether to print the form for one topic instead of a table.
    """
    statistics = {topic: stats for topic, rate in rates.items() if (stats := rate.statistics())}
    if single:
        return "".join(
            f"average rate: {stats.rate:.3f}\n"
            f"\tmin: {stats.shortest:.3f}s max: {stats.longest:.3f}s"
            f" std dev: {stats.deviation:.5f}s window: {stats.window}\n"
            for stats in statistics.values()
        )
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
    return table(("topic", "rate", "min_delta", "max_delta", "std_dev", "window"), rows)
