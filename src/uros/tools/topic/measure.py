"""What ``topic hz``, ``bw`` and ``delay`` share: options, subscriptions and the report."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from ...printable import unguarded
from ..common import add_common, add_topic, discover, join, positive_int
from ..errors import ToolError, UsageError
from ..sim_time import TOPIC, add_use_sim_time, clock
from ..values.qos_subscribe import add_qos_arguments, choose
from ..waiting import topic_types, warn
from .list import add_hidden, visible_topics
from .lost import LostReport

if TYPE_CHECKING:
    from ...host.network import Network, Received

_PERIOD: Final = 1.0
_CLEAR: Final = "\033[H\033[2J"


class Meter(Protocol):
    """What measures the messages of one topic."""

    def reset(self) -> None:
        """Forget all messages, because the time went back."""


Measured = TypeVar("Measured", bound=Meter)
# Counts a message that came at a time in ns.
Count = Callable[["Received", int], None]


def add_arguments(parser: argparse.ArgumentParser, window: int) -> None:
    """Declare the options of the three verbs.

    Args:
        parser: Where to declare them.
        window: How many messages are averaged over by default.
    """
    add_common(parser)
    add_use_sim_time(parser)
    parser.add_argument(
        "-w",
        "--window",
        metavar="N",
        type=positive_int,
        default=window,
        help=f"average over so many messages (default: {window})",
    )
    add_qos_arguments(parser)


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Declare any number of topics, and ``--all``."""
    add_topic(parser, "*")
    parser.add_argument(
        "-a", "--all", action="store_true",
        help="measure all topics that exist now, and clear the screen before each report",
    )  # fmt: skip
    add_hidden(parser)


def check_topics(args: argparse.Namespace) -> None:
    """Check that there are topics, or ``--all``, and not both.

    Raises:
        UsageError: There is none of them, or both.
    """
    if args.all and args.topic:
        raise UsageError("give either topics or --all")
    if not args.all and not args.topic:
        raise UsageError("give the names of topics, or --all")


def measure(
    args: argparse.Namespace,
    topics: Sequence[str] | None,
    make: Callable[[], Measured],
    counting: Callable[[Measured, str], Count],
    report: Callable[[dict[str, Measured], int], str],
    announce: bool,
) -> int:
    """Measure topics, and print a report once a second until Ctrl-C.

    Args:
        args: The command line.
        topics: The topics; None for all that exist.
        make: Returns a new meter.
        counting: Returns what counts messages of a type in a meter.
        report: Returns what to print of the meters by topic, at a time in ns.
        announce: Whether to print each topic that is subscribed to.

    Raises:
        ToolError: ``counting`` refuses the type of a topic.
    """
    try:
        with join(args) as network:
            every = topics is None
            if topics is None:
                topics = list(visible_topics(network, args))
                if not topics:
                    print("No topics available")
                    return 0
                print(f"Subscribing to all {len(topics)} available topics...")
            else:
                discover(network, args)
            now = clock(network, args)
            meters: dict[str, Measured] = {}
            listeners = _Listeners(network, args, now)
            for topic in dict.fromkeys(topics):
                meter = make()
                if listeners.listen(topic, meter, partial(counting, meter), every):
                    meters[topic] = meter
                    if announce:
                        print(f"Subscribed to [{topic}]", flush=True)
            lost = LostReport(network)
            try:
                while True:
                    network.spin(lambda: False, _PERIOD)
                    listeners.tell()
                    lost.tell()
                    _print(report(meters, now()), every)
            finally:
                lost.tell(last=True)
    except KeyboardInterrupt:
        return 0  # the usual end


def _print(text: str, clear: bool) -> None:
    if clear and sys.stdout.isatty():
        unguarded(sys.stdout).write(_CLEAR)
    sys.stdout.write(text)
    sys.stdout.flush()


class _Listeners:
    """Passes messages to the meters, with the time of each."""

    def __init__(self, network: Network, args: argparse.Namespace, now: Callable[[], int]) -> None:
        self._network = network
        self._args = args
        self._sim_time = now if args.use_sim_time else None
        self._meters: list[Meter] = []
        self._last = 0
        self._went_back = False
        self._warned = False

    def listen(
        self, topic: str, meter: Meter, counting: Callable[[str], Count], lenient: bool
    ) -> bool:
        """Subscribe to a topic with each of its types.

        Args:
            topic: The topic, which is waited for.
            meter: What to reset when the time goes back.
            counting: Returns what counts messages of a type.
            lenient: Whether a type that ``counting`` refuses is left out with a warning.

        Returns:
            Whether it subscribed.

        Raises:
            ToolError: ``counting`` refuses a type.
        """
        from ...interfaces import InterfaceError

        subscribed = False
        for type_name in topic_types(self._network, topic):
            try:
                count = counting(type_name)
            except (ToolError, InterfaceError) as error:
                if not lenient:
                    raise
                warn(f"{topic} is left out: {error}")
                continue
            offered = [end.qos for end in self._network.graph.publishers(topic)]
            qos, notes = choose(self._args, offered)
            for note in notes:
                warn(f"{topic}: {note}")
            self._network.listen(topic, type_name, qos, self._timed(count))
            subscribed = True
        self._meters.append(meter)
        return subscribed

    def _timed(self, count: Count) -> Callable[[Received], None]:
        """Return what gives each message and its time to ``count``."""
        sim_time = self._sim_time

        def on_message(received: Received) -> None:
            now = received.received_ns if sim_time is None else sim_time()
            if now < self._last:
                self._reset()
            self._last = now
            if now:  # messages before the first time of /clock have none
                count(received, now)

        return on_message

    def _reset(self) -> None:
        self._went_back = True
        for meter in self._meters:
            meter.reset()

    def tell(self) -> None:
        """Warn if the time went back, and once if /clock tells no time."""
        if self._went_back:
            self._went_back = False
            warn("the time went back: measuring begins anew")
        if self._sim_time is not None and not self._sim_time() and not self._warned:
            self._warned = True
            warn(f"no time has come on {TOPIC}: without it, nothing is measured")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as ros2 prints it; nothing if there is no row."""
    if not rows:
        return ""
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
