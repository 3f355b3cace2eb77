"""``uros topic bw``: print the bandwidth that topics use."""

from __future__ import annotations

import argparse
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

from .measure import Count, add_topics, check_topics, measure, table
from .measure import add_arguments as add_measuring

if TYPE_CHECKING:
    from ...host.network import Received

_WINDOW: Final = 100
_LEAST: Final = 2  # messages that a bandwidth needs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic bw``."""
    add_topics(parser)
    add_measuring(parser, _WINDOW)


def run(args: argparse.Namespace) -> int:
    """Print the bandwidths once a second until Ctrl-C.

    Raises:
        UsageError: There is no topic.
    """
    check_topics(args)
    return measure(
        args,
        None if args.all else args.topic,
        lambda: Bandwidth(args.window),
        _counting,
        lambda meters, now: report(meters, now, len(meters) == 1 and not args.all),
        True,
    )


def _counting(meter: Bandwidth, _type_name: str) -> Count:
    return meter.add


class Usage(NamedTuple):
    """Octets a second, the number of messages, and the sizes of these in octets."""

    rate: float
    window: int
    mean: float
    smallest: int
    largest: int


class Bandwidth:
    """The times and sizes of the last ``window`` messages of one topic."""

    def __init__(self, window: int) -> None:
        self._messages: deque[tuple[int, int]] = deque(maxlen=window)

    def add(self, received: Received, now_ns: int) -> None:
        """Count a message that came at ``now_ns``."""
        self._messages.append((now_ns, len(received.cdr)))

    def reset(self) -> None:
        """Forget all messages."""
        self._messages.clear()

    def usage(self, now_ns: int) -> Usage | None:
        """Return the usage from the first of the messages until now; None for too few of them."""
        if len(self._messages) < _LEAST:
            return None
        nanoseconds = now_ns - self._messages[0][0]
        if nanoseconds <= 0:
            return None
        sizes = [size for _, size in self._messages]
        total, count = sum(sizes), len(sizes)
        return Usage(total * 1e9 / nanoseconds, count, total / count, min(sizes), max(sizes))


def report(meters: dict[str, Bandwidth], now_ns: int, single: bool) -> str:
    """Return what ros2 prints once a second; nothing before the second message.

    Args:
        meters: The bandwidths by topic.
        now_ns: The time.
        single: Whether to print the form for one topic instead of a table.
    """
    usages = {topic: use for topic, meter in meters.items() if (use := meter.usage(now_ns))}
    if single:
        return "".join(
            f"{_octets(use.rate, use.rate)}/s from {use.window} messages\n"
            f"\tMessage size mean: {_octets(use.mean, use.rate)}"
            f" min: {_octets(use.smallest, use.rate)} max: {_octets(use.largest, use.rate)}\n"
            for use in usages.values()
        )
    rows = [
        (
            topic,
            f"{_octets(use.rate, use.rate)}/s",
            str(use.window),
            *(_octets(size, use.rate) for size in (use.mean, use.smallest, use.largest)),
        )
        for topic, use in usages.items()
    ]
    return table(("topic", "bandwidth", "window", "mean", "min", "max"), rows)


def _octets(count: float, rate: float) -> str:
    """Return a number of octets, in the unit that suits the rate, as ros2 does."""
    if rate < 1e3:
        return f"{count:.0f} B"
    return f"{count / 1e3:.2f} KB" if rate < 1e6 else f"{count / 1e6:.2f} MB"
