"""``uros plot``: plot fields of topics in the terminal."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from ...printable import printable, unguarded
from ..common import add_common, discover, join, positive_float, remedy
from ..errors import ToolError
from ..values.qos_subscribe import add_qos_arguments, choose
from ..values.typed_values import load_message
from ..waiting import warn
from .chart import Series, draw
from .field import getter

if TYPE_CHECKING:
    from ...host.network import Network, Received

_WINDOW: Final = 10.0
_FRAME: Final = 0.1
# Another screen without a cursor, and back.
_ENTER: Final = "\033[?1049h\033[?25l"
_LEAVE: Final = "\033[?25h\033[?1049l"

Plotted = list[tuple[Series, Callable[[Any], "float | None"]]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros plot``."""
    parser.add_argument(
        "paths", metavar="TOPIC/FIELD", nargs="+",
        help="what to plot, such as /imu/linear_acceleration/x or /battery/cell_voltage[0]",
    )  # fmt: skip
    add_common(parser)
    add_qos_arguments(parser)
    parser.add_argument(
        "-w", "--window", metavar="S", type=positive_float, default=_WINDOW,
        help=f"seconds from the left end to the right one (default: {_WINDOW:g})",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Plot until Ctrl-C; where the output is no terminal, print each point as a line of CSV.

    Raises:
        ToolError: There is no such topic or field, or the topic has several types.
    """
    try:
        with join(args) as network:
            discover(network, args)
            terminal = sys.stdout.isatty()
            if not terminal:
                print("seconds,name,value", flush=True)
            series = _subscribe(network, args, None if terminal else _print)
            if terminal:
                with _screen() as show:
                    while True:
                        size = shutil.get_terminal_size()
                        now = time.monotonic()
                        show(draw(series, now, args.window, size.columns, size.lines))
                        network.spin(lambda: False, _FRAME)
            network.spin(lambda: False)
    except KeyboardInterrupt:
        return 0  # the usual end
    return 0


def _print(at: float, name: str, value: float) -> None:
    print(f"{at:.6f},{name},{value!r}", flush=True)


def _subscribe(
    network: Network, args: argparse.Namespace, tell: Callable[[float, str, float], None] | None
) -> list[Series]:
    """Subscribe to each topic once; return a series for each path.

    Args:
        network: The domain, discovered.
        args: The command line.
        tell: Called with each point.
    """
    by_topic: dict[str, list[tuple[str, str]]] = {}
    for path in dict.fromkeys(args.paths):
        topic, field = split(network, path)
        by_topic.setdefault(topic, []).append((path, field))
    every = []
    for topic, paths in by_topic.items():
        types = network.graph.topics()[topic]
        if len(types) > 1:
            raise ToolError(f"{topic} has several types: {', '.join(types)}")
        message_class = load_message(types[0], network)
        plotted: Plotted = [
            (Series(printable(path)), getter(message_class, field)) for path, field in paths
        ]
        every += [series for series, _ in plotted]
        qos, notes = choose(args, [one.qos for one in network.graph.publishers(topic)])
        for note in notes:
            warn(note)
        network.listen(topic, types[0], qos, _receiver(message_class, plotted, tell))
    return every


def split(network: Network, path: str) -> tuple[str, str]:
    """Return the topic that a path begins with, and the field behind it.

    Raises:
        ToolError: It begins with no topic, or there is nothing behind.
    """
    topics = network.graph.topics()
    absolute = path if path.startswith("/") else f"/{path}"
    for topic in sorted(topics, key=len, reverse=True):
        if absolute == topic:
            example = f"{topic}/FIELD"
            raise ToolError(
                f"{topic} is a topic: name a field too, as {example}; 'uros interface show"
                f" {topics[topic][0]}' prints them"
            )
        if absolute.startswith((f"{topic}/", f"{topic}.")):
            return topic, absolute[len(topic) + 1 :]
    if _is_bag(path):
        raise ToolError(
            f"{path!r} is a bag, and plot takes topics: 'uros bag play {shlex.quote(path)}' in"
            " another terminal publishes its topics, and 'uros bag info' lists them"
        )
    raise ToolError(f"{path!r} begins with no topic{remedy(network, absolute, topics)}")


def _is_bag(path: str) -> bool:
    """Return whether this is the folder of a bag, or a file of one."""
    from ...bag import metadata, storage

    if os.path.isfile(path):
        suffixes = tuple(storage.SUFFIXES.values())
        return path.removesuffix(storage.PACKED_SUFFIX).endswith(suffixes)
    return os.path.isfile(os.path.join(path, metadata.FILE_NAME))


def _receiver(
    message_class: Any, plotted: Plotted, tell: Callable[[float, str, float], None] | None
) -> Callable[[Received], None]:
    from ...interfaces import InterfaceError, codec

    def on_sample(received: Received) -> None:
        try:
            message = codec.from_cdr(message_class, received.cdr)
        except InterfaceError:
            return  # of another definition
        now = time.monotonic()
        for series, get in plotted:
            value = get(message)
            if value is not None:
                series.add(now, value)
                if tell is not None:
                    tell(received.received_ns / 1e9, series.name, value)

    return on_sample


@contextmanager
def _screen() -> Iterator[Callable[[Sequence[str]], None]]:
    """Take over the terminal, and give it back as it was.

    Yields:
        A function that shows lines in place of those before.
    """
    out = unguarded(sys.stdout)

    def show(lines: Sequence[str]) -> None:
        out.write("\033[H" + "\033[K\r\n".join(lines) + "\033[K\033[J")
        out.flush()

    out.write(_ENTER)
    out.flush()
    try:
        yield show
    finally:
        out.write(_LEAVE)
        out.flush()
