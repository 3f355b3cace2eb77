"""``uros demo``: run a virtual board, an agent and a ROS 2 subscriber, on this machine only.

The board is an EK-RA6M5 with three I2C sensors and the firmware of ``firmware/ra6m5_sensor_node``.
Its USB line is a pseudo-terminal, on which an agent in a process of its own listens. The messages
that are shown have come from there over DDS.
"""

from __future__ import annotations

import argparse
import bisect
import os
import queue
import shutil
import statistics
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from ..printable import printable, unguarded
from .agent.child_process import AgentProcess
from .common import add_engine, domain, positive_float
from .ending import uninterrupted
from .errors import ToolError

if TYPE_CHECKING:
    from pathlib import Path

    from ..boards.virtual.engine.runner import RunningBoard
    from ..host.network import Received
    from ..qos import QoSProfile

BOARD: Final = "ra6m5_sensor_node"
_CLIMATE, _THERMOCOUPLE, _LIGHT = 0x44, 0x67, 0x13
# What the board publishes, and the I2C device that it reads before; None: published by event.
TOPICS: Final = (
    ("/sensors/room_temp", "sensor_msgs/msg/Temperature", _CLIMATE),
    ("/sensors/humidity", "sensor_msgs/msg/RelativeHumidity", _CLIMATE),
    ("/sensors/thermocouple_hot", "sensor_msgs/msg/Temperature", _THERMOCOUPLE),
    ("/sensors/thermocouple_cold", "sensor_msgs/msg/Temperature", _THERMOCOUPLE),
    ("/sensors/proximity", "std_msgs/msg/UInt16", _LIGHT),
    ("/sensors/ambient_light", "std_msgs/msg/UInt16", _LIGHT),
    ("/sensors/diagnostic", "std_msgs/msg/String", None),
)
TYPES: Final = tuple(type_name for _, type_name, _ in TOPICS)
# How many of the last delays the median is of while the demo runs.
_RECENT: Final = 50
_REDRAW_SECONDS: Final = 0.25
_VALUE_WIDTH: Final = 40
# Log level of the agent: the table shows what it would log at level info.
_WARNINGS: Final = "3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros demo``."""
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="exit after so many seconds; exit status 1 if a topic was not received"
        " (default: until Ctrl-C)",
    )  # fmt: skip
    parser.add_argument(
        "--domain", type=domain, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID, or 0)"
    )
    add_engine(parser)
    parser.add_argument(
        "--fault", action="append", default=[], metavar="SPEC",
        help="fault of the hardware, as with 'uros board run'; may be repeated",
    )  # fmt: skip


class _Reads:
    """The ends of reads of each I2C device, by this machine's monotonic clock."""

    def __init__(self) -> None:
        self._ends: dict[int, list[int]] = {}

    def ended(self, address: int, ns: int) -> None:
        """Note the end of a read. Called from another thread."""
        self._ends.setdefault(address, []).append(ns)

    def before(self, address: int, ns: int) -> int | None:
        """Return the last end of a read of the device until ``ns``."""
        ends = self._ends.get(address, [])
        at = bisect.bisect_right(ends, ns)
        return ends[at - 1] if at else None


class _Topic:
    """What was received of one topic."""

    def __init__(self, name: str, type_name: str, device: int | None, reads: _Reads) -> None:
        from ..interfaces import load

        self.name = name
        self.type_name = type_name
        self.count = 0
        self.value = "waiting…"
        self._device = device
        self._reads = reads
        self._heard: list[int] = []  # monotonic ns
        self._class: Any = load(type_name)

    def heard(self, sample: Received) -> None:
        from ..interfaces.codec import from_cdr

        self._heard.append(time.monotonic_ns())
        self.count += 1
        message = from_cdr(self._class, sample.cdr)
        fields = [
            f"{name}: {getattr(message, name):g}" if kind in ("double", "float") else
            f"{name}: {getattr(message, name)}"
            for name, kind in message.get_fields_and_field_types().items()
            if name not in ("header", "variance")
        ]  # fmt: skip
        text = ", ".join(fields)
        self.value = text if len(text) <= _VALUE_WIDTH else text[: _VALUE_WIDTH - 1] + "…"

    def qos(self) -> QoSProfile:
        """Return the QoS to subscribe with. An event is published once, for late joiners too."""
        from ..qos import DurabilityPolicy, QoSProfile, sensor_data_profile

        if self._device is not None:
            return sensor_data_profile()
        return QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL)

    @property
    def rate(self) -> float | None:
        """The rate between the first and the last message; None if not known, or by event."""
        if self.count < 2 or self._device is None:
            return None
        return (self.count - 1) * 1e9 / (self._heard[-1] - self._heard[0])

    def delays_ms(self, last: int = 0) -> list[float]:
        """Return the delays from the sensor's read to here of the last samples (0: all)."""
        if self._device is None:
            return []
        pairs = [(ns, self._reads.before(self._device, ns)) for ns in self._heard[-last:]]
        return [(ns - end) / 1e6 for ns, end in pairs if end is not None]


class _Agent(AgentProcess):
    """The agent, whose warnings are printed when there is time."""

    def __init__(self, device: Path, domain_id: int) -> None:
        self._news: queue.Queue[str] = queue.Queue()
        arguments = ("serial", "--dev", str(device), "--verbose", _WARNINGS)
        super().__init__(arguments, domain_id, self._news.put)

    def print_news(self) -> None:
        """Print what the agent has logged since the last call."""
        while not self._news.empty():
            print(self._news.get())


def run(args: argparse.Namespace) -> int:
    """Run the demo.

    Returns:
        0 if every topic was received, 130 if Ctrl-C came before, else 1.

    Raises:
        ToolError: The board or the agent ended early.
    """
    # Set before DDS is loaded, here and in the agent: a demo stays on this machine.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from ..boards.virtual.engine.runner import RunningBoard, StartError
    from .common import join

    args.interfaces, args.distro = [], None
    reads = _Reads()
    interrupted = False
    topics = [_Topic(name, type_name, device, reads) for name, type_name, device in TOPICS]
    with join(args) as network:
        for topic in topics:
            network.listen(topic.name, topic.type_name, topic.qos(), topic.heard)
        board = RunningBoard(BOARD, engine=args.engine, happen=args.fault, on_read=reads.ended)
        try:
            board.start()
        except StartError as error:
            raise ToolError(str(error)) from error
        try:
            print(
                f"A virtual EK-RA6M5 (engine {args.engine}) runs, with an agent in ROS domain"
                f" {network.domain}.\nIts USB line is {board.path}.\nWaiting for its topics ...",
                flush=True,
            )
            agent = _Agent(board.path, network.domain)
            try:
                _watch(network, agent, board, topics, args.seconds)
            except KeyboardInterrupt:
                interrupted = True
                print()
            finally:
                with uninterrupted():
                    agent.close()  # first: it would log the end of the board as a lost device
                    agent.print_news()
        finally:
            with uninterrupted():
                board.stop()
    return _summary(topics, interrupted)


def _watch(
    network: Any, agent: _Agent, board: RunningBoard, topics: list[_Topic], seconds: float | None
) -> None:
    """Serve the network and show the messages until the time is over."""
    end = None if seconds is None else time.monotonic() + seconds
    drawn = 0
    live = sys.stdout.isatty()
    while end is None or time.monotonic() < end:
        if agent.ended:
            agent.print_news()
            raise ToolError("the agent has ended; its log above has the reason")
        if board.ended:
            while not board.console.empty():
                print(f"board: {board.console.get()}")
            raise ToolError("the board's program has ended")
        if board.usb_error:
            raise ToolError(f"the board's USB: {board.usb_error}")
        pause = _REDRAW_SECONDS if end is None else end - time.monotonic()
        network.spin(lambda: False, max(0.0, min(_REDRAW_SECONDS, pause)))
        if drawn and live:
            # The cursor goes up to the table, and what is to be told scrolls up above it.
            print(f"\033[{drawn}A\033[J", end="", file=unguarded(sys.stdout))
        agent.print_news()
        if drawn and live:
            drawn = _draw(topics, live)
        elif not drawn and any(topic.count for topic in topics):
            print("\nMessages received over DDS (Ctrl-C to exit):\n")
            drawn = _draw(topics, live)


def _draw(topics: list[_Topic], live: bool = False) -> int:
    """Print the table and return its number of lines.

    On a terminal, a line that has no room is cut, and so is the end of a table that is too high.
    """
    rows = [("TOPIC", "COUNT", "RATE", "DELAY", "VALUE", "TYPE")]
    for topic in topics:
        rate = "-" if topic.rate is None else f"{topic.rate:.1f} Hz"
        delays = topic.delays_ms(_RECENT if live else 0)
        shown = f"{statistics.median(delays):.2f} ms" if delays else "-"
        rows.append((topic.name, str(topic.count), rate, shown, topic.value, topic.type_name))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    size = shutil.get_terminal_size()
    terminal = sys.stdout.isatty()
    whole = not terminal or sum(widths) + 2 * len(widths) + max(map(len, TYPES)) <= size.columns
    if terminal:
        rows = rows[: size.lines - 1]  # the cursor cannot move up further
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [row[i].rjust(widths[i]) for i in (1, 2, 3)]
        line = "  ".join([*cells, row[4].ljust(widths[4]), row[5]] if whole else [*cells, row[4]])
        if terminal and len(line) > size.columns:  # a line that wraps would break the redraw
            line = line[: size.columns - 1] + "…"
        print(printable(line.rstrip()), flush=True)
    return len(rows)


def _summary(topics: list[_Topic], interrupted: bool) -> int:
    if not sys.stdout.isatty():  # on a terminal the table is there
        print("\nSummary:\n")
        _draw(topics)
    delays = [delay for topic in topics for delay in topic.delays_ms()]
    if delays:
        print(
            "\nDELAY: median from the end of a sensor's I2C read to the DDS reader here;\nof all"
            f" {len(delays)} samples: {statistics.median(delays):.2f} ms"
        )
    missing = [topic.name for topic in topics if not topic.count]
    if missing:
        when = " until Ctrl-C" if interrupted else ""
        print(f"\nNot received{when}: {', '.join(missing)}", file=sys.stderr)
        return 130 if interrupted else 1
    print("\nEvery topic was received.")
    return 0
