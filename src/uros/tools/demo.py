"""``uros demo``: a board, an agent and a ROS 2 listener, on this machine alone.

The board says again what a real micro-ROS board once said: the recording
``rclc_temperature_humidity``. It talks by UDP to an agent in a process of its
own; what is shown has come from there by DDS.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from .common import domain, positive_float
from .errors import ToolError

if TYPE_CHECKING:
    from ..boards.recorded import Record
    from ..host.network import Received

RECORDING: Final = "rclc_temperature_humidity"
_START_SECONDS: Final = 15.0
_REDRAW_SECONDS: Final = 0.25
_VALUE_WIDTH: Final = 48


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=positive_float, metavar="S",
        help="end after so long; exit status 0 only if every topic was heard"
        " (default: until Ctrl-C)",
    )  # fmt: skip
    parser.add_argument(
        "--domain", type=domain, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID, or 0)"
    )


class _Topic:
    """What was heard of one topic."""

    def __init__(self, name: str, type_name: str) -> None:
        from ..interfaces import load

        self.name = name
        self.type_name = type_name
        self.count = 0
        self.value = "waiting…"
        self._first = self._last = 0
        self._class: Any = load(type_name)

    def heard(self, sample: Received) -> None:
        from ..interfaces.codec import from_cdr

        self.count += 1
        self._first = self._first or sample.received_ns
        self._last = sample.received_ns
        message = from_cdr(self._class, sample.cdr)
        fields = [
            f"{name}: {getattr(message, name):g}" if kind in ("double", "float") else
            f"{name}: {getattr(message, name)}"
            for name, kind in message.get_fields_and_field_types().items()
            if name != "header"
        ]  # fmt: skip
        text = ", ".join(fields)
        self.value = text if len(text) <= _VALUE_WIDTH else text[: _VALUE_WIDTH - 1] + "…"

    @property
    def rate(self) -> float:
        """Messages a second between the first and the last."""
        return (self.count - 1) * 1e9 / (self._last - self._first) if self.count > 1 else 0.0


class _Agent:
    """The agent as a child process, its log as lines."""

    def __init__(self, domain_id: int) -> None:
        self._lines: queue.Queue[str] = queue.Queue()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", "udp4", "--port", "0",
             "--domain", str(domain_id), "--stop-at-eof"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, encoding="utf-8",
            start_new_session=True,  # Ctrl-C is for us: the board takes its leave first
        )  # fmt: skip
        threading.Thread(target=self._read, daemon=True).start()
        self.port = self._wait_for_port()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line.rstrip())

    def _wait_for_port(self) -> int:
        end = time.monotonic() + _START_SECONDS
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, min(0.2, end - time.monotonic())))
            except queue.Empty:
                if self.ended or time.monotonic() > end:
                    self.close()
                    raise ToolError("the agent did not start") from None
                continue
            print(line)
            if "running..." in line:
                return int(line.rsplit("port: ", 1)[1])

    def print_news(self) -> None:
        while not self._lines.empty():
            print(self._lines.get())

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        """End it, kindly at first."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def run(args: argparse.Namespace) -> int:
    # Set before DDS is loaded, here and in the agent: a demo stays on this machine.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from ..boards.recorded import RecordedBoard, UdpBoard, load, packaged
    from .common import join

    args.interfaces = []
    topics = [_Topic(*it) for it in recorded_topics(load(packaged(RECORDING)))]
    with join(args) as network:
        print(f"An agent for boards, in ROS domain {network.domain}:")
        agent = _Agent(network.domain)
        try:
            from ..qos import sensor_data_profile

            for topic in topics:
                network.listen(topic.name, topic.type_name, sensor_data_profile(), topic.heard)
            board = RecordedBoard(load(packaged(RECORDING)), endless=True)
            with UdpBoard(board, ("127.0.0.1", agent.port)):
                try:
                    _watch(network, agent, topics, args.seconds)
                except KeyboardInterrupt:
                    print()
        finally:
            agent.close()
    return _summary(topics, args.seconds is not None)


def _watch(network: Any, agent: _Agent, topics: list[_Topic], seconds: float | None) -> None:
    """Serve the network and show what comes, until the time is up."""
    end = None if seconds is None else time.monotonic() + seconds
    drawn = 0
    live = sys.stdout.isatty()
    while end is None or time.monotonic() < end:
        if agent.ended:
            agent.print_news()
            raise ToolError("the agent ended")
        network.spin(lambda: False, _REDRAW_SECONDS)
        if not drawn:
            agent.print_news()
            if any(topic.count for topic in topics):
                print("\nWhat arrives by DDS (Ctrl-C ends it):\n")
                drawn = _draw(topics, live)
        elif live:
            print(f"\033[{drawn}A", end="")
            drawn = _draw(topics, live)


def _draw(topics: list[_Topic], live: bool = False) -> int:
    """Print the table, cut to the terminal where it is to be drawn over; its lines."""
    rows = [("TOPIC", "COUNT", "RATE", "VALUE", "TYPE")]
    for it in topics:
        rate = f"{it.rate:.1f} Hz" if it.count > 1 else "-"
        rows.append((it.name, str(it.count), rate, it.value, it.type_name))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    room = shutil.get_terminal_size().columns - 1
    for row in rows:
        cells = [row[0].ljust(widths[0]), row[1].rjust(widths[1]),
                 row[2].rjust(widths[2]), row[3].ljust(widths[3])]  # fmt: skip
        line = "  ".join([*cells, row[4]])
        # A line that wraps would be two to the cursor that goes up again.
        print(f"{line[:room]}\033[K" if live else line, flush=True)
    return len(rows)


def _summary(topics: list[_Topic], timed: bool) -> int:
    print("\nSummary:\n")
    _draw(topics)
    missing = [topic.name for topic in topics if not topic.count]
    if missing:
        print(f"\nNot heard: {', '.join(missing)}", file=sys.stderr)
        return 1
    print("\nEvery topic was heard." if timed else "")
    return 0


def recorded_topics(records: list[Record]) -> list[tuple[str, str]]:
    """``(topic, type)``, ROS names, of what the first board of a recording publishes."""
    from ..boards.recorded import submessages
    from ..host import names
    from ..wire import entities, ids
    from ..wire.cdr import Reader

    found = []
    for record in records:
        if not record.from_client or record.client:
            continue
        for kind, flags, payload in submessages(record.data):
            if kind != ids.CREATE:
                continue
            little = bool(flags & ids.FLAG_LITTLE_ENDIAN)
            created = entities.pull_create(Reader(payload, 0, len(payload), little))
            content = created[4]
            if created[2] != ids.KIND_TOPIC or not isinstance(content, bytes):
                continue
            name, type_name = entities.pull_binary_topic(Reader(content, 0, len(content), little))
            topic = names.topic_from_dds(name)
            if topic and type_name:
                found.append((topic, names.type_from_dds(type_name)))
    return found
