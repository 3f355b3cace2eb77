"""Compares ``uros topic hz`` and ``uros topic echo`` with subscribers of rclpy, in one run.

    python bench/tools.py [--quick] [--domain N]

Strings of 64 bytes, best effort, 10,000 a second, over UDP on loopback. The contestants take turns;
each one is alone with the sender, which is Cyclone in this process. What they print goes into a
file. A figure is the median of the turns, and the ratio is that of uros to rclpy; goals are printed
beside it, and are no exit status.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from load import text
from process import LOOPBACK, NO_ROS, ROS_PYTHON, Process, heading, middle, options, settings, show
from relay import TYPE, qos

from uros.middleware.dds import cyclone

RATE = 10_000
SAMPLE = b"\0\1\0\0" + text(64)
TOPIC = "/bench_tools"
GOAL = "≤ 0.5 ×"
MATCH_SECONDS = 60.0
SETTLE_SECONDS = 0.5
REPORT_SECONDS = 1.5  # hz reports once a second, and its last report must have all messages
COMMANDS = {
    "hz": ("-m", "uros", "topic", "hz", TOPIC, "--window", "1000000"),
    "echo": ("-m", "uros", "topic", "echo", TOPIC),
}


class Sender:
    """A writer of this process."""

    def __init__(self) -> None:
        os.environ["CYCLONEDDS_URI"] = LOOPBACK
        cyclone.open_domain(settings.domain, LOOPBACK)
        participant = cyclone.create_participant(settings.domain, b"")
        topic = cyclone.create_topic(participant, "rt" + TOPIC, TYPE)
        publisher = cyclone.create_group("publisher", participant)
        self._writer = cyclone.create_writer(publisher, topic, qos(), b"")

    def wait_for(self, readers: int) -> None:
        """Wait until so many readers match."""
        end = time.monotonic() + MATCH_SECONDS
        while cyclone.count_readers(self._writer) != readers:
            if time.monotonic() > end:
                raise TimeoutError(f"there are not {readers} readers")
            time.sleep(0.05)

    def send(self, seconds: float) -> int:
        """Send evenly; return the number of samples."""
        count = int(RATE * seconds)
        start = time.perf_counter()
        for number in range(1, count + 1):
            cyclone.write(self._writer, SAMPLE)
            ahead = start + number / RATE - time.perf_counter()
            if ahead > 0.0:
                time.sleep(ahead)
        return count


def measured(sender: Sender, verb: str, rclpy: bool, seconds: float) -> tuple[float, float, str]:
    """Run a contestant; return CPU a message in µs, what it missed in %, and its warnings."""
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        arguments = ("rclpy_tool.py", verb, TOPIC) if rclpy else COMMANDS[verb]
        process = Started(ROS_PYTHON if rclpy else sys.executable, arguments, output, errors)
        try:
            sender.wait_for(1)
            time.sleep(SETTLE_SECONDS)
            before = process.cpu()
            sent = sender.send(seconds)
            time.sleep(REPORT_SECONDS)
            cpu = process.cpu() - before
        finally:
            process.end()
        sender.wait_for(0)
        output.seek(0)
        errors.seek(0)
        printed = output.read()
        if verb == "echo":
            received = printed.count("---\n")
        else:
            received = 1 + int(re.findall(r"window: (\d+)", printed)[-1])
        return cpu * 1e6 / received, 100 * (sent - received) / sent, errors.read()


class Started(Process):
    """A command whose output goes to files, and which says by its subscription that it is ready."""

    def __init__(self, python: Path | str, arguments: tuple[str, ...], output, errors) -> None:  # type: ignore[no-untyped-def]
        self._process = subprocess.Popen(
            [str(python), *arguments], stdout=output, stderr=errors, cwd=Path(__file__).parent,
            env=dict(
                os.environ, ROS_DOMAIN_ID=str(settings.domain),
                ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
                **({} if "rclpy_tool.py" in arguments else {"PYTHONPATH": SOURCE}),
            ),
        )  # fmt: skip

    def end(self) -> None:
        self.signal(signal.SIGINT)
        self._process.wait(30)


SOURCE = str(Path(__file__).resolve().parent.parent / "src")


def main() -> int:
    quick = options(__doc__, "a short run").quick
    if not ROS_PYTHON.exists():
        print(f"  {NO_ROS}")
        return 1
    turns, seconds = (1, 2.0) if quick else (3, 5.0)
    sender = Sender()
    figures: dict[str, dict[str, list[float]]] = {}
    said: list[str] = []
    for _ in range(turns):
        for verb in COMMANDS:
            for name in ("rclpy", "uros"):
                cpu, missed, warnings = measured(sender, verb, name == "rclpy", seconds)
                figures.setdefault(f"topic {verb}: CPU µs/msg", {}).setdefault(name, []).append(cpu)
                figures.setdefault(f"topic {verb}: missed, %", {}).setdefault(name, []).append(
                    missed
                )
                if name == "uros" and missed:
                    said.append(f"{verb} missed {missed:.2f} %, and said: {warnings.strip()}")
    heading("rclpy", "uros")
    for what, values in figures.items():
        goal = GOAL if "CPU" in what else ""
        show(what, [middle(values["rclpy"]), middle(values["uros"])], goal)
    for line in said:
        print(f"  {line}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
