"""``uros topic delay``: print how old messages are, by the stamp of their header."""

from __future__ import annotations

import argparse
import math
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from ..common import add_topic
from ..errors import ToolError
from ..values.message_reader import MessageReader
from ..values.typed_values import load_message
from .measure import Count, measure
from .measure import add_arguments as add_measuring

if TYPE_CHECKING:
    from ...host.network import Received

_WINDOW: Final = 10000
_HEADER: Final = "std_msgs/Header"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic delay``."""
    add_topic(parser)
    add_measuring(parser, _WINDOW)


def run(args: argparse.Namespace) -> int:
    """Print the delay once a second until Ctrl-C.

    Raises:
        ToolError: The topic's messages have no header.
    """
    return measure(
        args,
        [args.topic],
        lambda: Delays(args.window),
        _counting,
        lambda meters, _now: "".join(report(meter) for meter in meters.values()),
        False,
    )


def _counting(delays: Delays, type_name: str) -> Count:
    message_class = load_message(type_name)
    fields = message_class._FIELDS
    if ("header", _HEADER) not in fields:
        names = ", ".join(name for name, _ in fields) or "none"
        raise ToolError(
            f"{message_class._TYPE} has no header, whose stamp tells when a message was made;"
            f" its fields: {names}"
        )
    first = fields[0] == ("header", _HEADER)
    # A header that comes first is read alone: the rest may be a whole picture.
    return _Stamps(delays, load_message(_HEADER) if first else message_class).count


class _Stamps:
    """Counts messages by the stamp of their header.

    Args:
        delays: Where to count.
        message_class: The class of the messages, or that of the header with which they begin.
    """

    def __init__(self, delays: Delays, message_class: Any) -> None:
        self._delays = delays
        self._reader = MessageReader(message_class)

    def count(self, received: Received, now_ns: int) -> None:
        """Count a message that came at ``now_ns``."""
        message = self._reader.read(received.cdr)
        if message is not None:
            stamp = getattr(message, "header", message).stamp
            self._delays.add(now_ns - stamp.sec * 1_000_000_000 - stamp.nanosec)


class Delays:
    """The last ``window`` delays of one topic, in ns."""

    def __init__(self, window: int) -> None:
        self.window: deque[int] = deque(maxlen=window)
        self.fresh = False

    def add(self, delay_ns: int) -> None:
        """Count a message."""
        self.window.append(delay_ns)
        self.fresh = True

    def reset(self) -> None:
        """Forget all messages."""
        self.window.clear()


def report(delays: Delays) -> str:
    """Return what ros2 prints once a second; nothing before the first message."""
    window = delays.window
    if not window:
        return ""
    if not delays.fresh:
        return "no new messages\n"
    delays.fresh = False
    mean = sum(window) / len(window)
    deviation = math.sqrt(sum((delay - mean) ** 2 for delay in window) / len(window))
    return (
        f"average delay: {mean / 1e9:.3f}\n"
        f"\tmin: {min(window) / 1e9:.3f}s max: {max(window) / 1e9:.3f}s"
        f" std dev: {deviation / 1e9:.5f}s window: {len(window)}\n"
    )
