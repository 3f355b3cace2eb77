"""Recording and playing bags: losses at 5,000 messages a second, kill -9, timing.

    python bench/bags.py [--quick] [--domain N] [--part losses kill timing] [--middleware auto rtps]
                         [--seconds S] [--kills N]

``auto`` is Cyclone where it is installed. Not part of ``make bench``: it takes ten minutes.
"""

from __future__ import annotations

import json
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from process import HERE, NO_ROS, ROS_PYTHON, options, settings

from uros.bag.metadata import FILE_NAME, TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.qos import QoSProfile

RATE = 5000
TYPE = "std_msgs/msg/UInt8MultiArray"
MS = 1_000_000
PARTS = ("losses", "kill", "timing")
MIDDLEWARES = ("auto", "rtps")
PROGRESS_SECONDS = 10.0
WITHOUT_CYCLONE = HERE.parent / "tests" / "support" / "without_cyclone"


def environment(middleware: str = "auto") -> dict[str, str]:
    """Return the variables of processes on loopback."""
    variables = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    variables["ROS_DOMAIN_ID"] = str(settings.domain)
    variables["PYTHONPATH"] = str(HERE.parent / "src")
    if middleware == "rtps":
        variables["PYTHONPATH"] += f":{WITHOUT_CYCLONE}"
    return variables


@contextmanager
def child(command: Sequence[object], middleware: str = "auto", **options: Any) -> Iterator[Any]:
    """Run a process within the block, without a terminal, and kill it in the end."""
    variables = {"env": environment(middleware), "stdin": subprocess.DEVNULL, **options}
    process = subprocess.Popen([str(word) for word in command], **variables)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def recording(folder: Path, middleware: str) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Run a recorder of the topic."""
    command = [sys.executable, "-m", "uros", "bag", "record", "/bench", "-o", folder]
    return child(command, middleware, stdout=subprocess.DEVNULL)


@contextmanager
def talking(
    middleware: str, rate: float, seconds: float, reliability: str
) -> Iterator[subprocess.Popen[str]]:
    """Run a talker, from when it has found its subscription."""
    command = [sys.executable, HERE / "bag_talker.py", settings.domain, rate, seconds, reliability]
    with child(command, middleware, stdout=subprocess.PIPE, text=True) as talker:
        expect(talker, "matched\n")
        yield talker


def expect(process: subprocess.Popen[str], line: str) -> None:
    """Read the next line of a process.

    Raises:
        RuntimeError: It is another one.
    """
    assert process.stdout is not None
    found = process.stdout.readline()
    if found != line:
        raise RuntimeError(f"{process.args} has printed {found!r} in place of {line!r}")


def progress(text: str) -> None:
    """Print what goes on, on standard error: the figures are on standard output."""
    print(f"    {text}", file=sys.stderr, flush=True)


def bench_losses(middleware: str, seconds: float, reliability: str) -> tuple[int, int, float]:
    """Record at 5,000 messages a second; return published, recorded, and CPU µs a message."""
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory() as folder,
        recording(Path(folder) / "bag", middleware) as recorder,
        talking(middleware, RATE, seconds, reliability) as talker,
    ):
        assert talker.stdout is not None
        while not select.select([talker.stdout], [], [], PROGRESS_SECONDS)[0]:
            progress(f"{reliability}: {time.monotonic() - began:.0f} of about {seconds:.0f} s")
        published = int(talker.stdout.readline().split()[1])
        talker.wait()
        recorder.send_signal(signal.SIGINT)
        _, status, used = os.wait4(recorder.pid, 0)
        recorder.returncode = status
        recorded = BagReader(Path(folder) / "bag").metadata.message_count
    return published, recorded, (used.ru_utime + used.ru_stime) * 1e6 / max(1, recorded)


def bench_kill(middleware: str, moments: int) -> list[float]:
    """Kill the recorder at random moments; return how much of the end is lost, in seconds."""
    lost = []
    for number in range(moments):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bag"
            with (
                recording(folder, middleware) as recorder,
                talking(middleware, 500, 60, "reliable"),
            ):
                last = time.time_ns()  # about when the first message was sent
                time.sleep(random.uniform(0.2, 4.0))
                killed_at = time.time_ns()
                recorder.kill()
                recorder.wait()
            # It fails where nothing at all was flushed.
            subprocess.run(
                [sys.executable, "-m", "uros", "bag", "recover", str(folder)], env=environment(),
                check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            count = 0
            for message in BagReader(folder).messages() if (folder / FILE_NAME).exists() else ():
                assert int.from_bytes(message.cdr[4:12], "little") == count, "a hole"
                last = int.from_bytes(message.cdr[12:20], "little")
                count += 1
            lost.append((killed_at - last) / 1e9)
        progress(f"kill {number + 1} of {moments}: {count} messages, {lost[-1]:.2f} s are lost")
    return sorted(lost)


def bench_timing(middleware: str, seconds: float) -> tuple[bool, float, float, float]:
    """Play 200 messages a second into rclpy; return whether in order, and errors in ms."""
    count = round(200 * seconds)
    begin = 1_700_000_000 * 1000 * MS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bag"
        with BagWriter(folder) as writer:
            topic = writer.add_topic(TopicMetadata("/bench", TYPE, [QoSProfile()]))
            for number in range(count):
                at = begin + number * 5 * MS
                writer.write(topic, b"\0\1\0\0" + number.to_bytes(8, "little") + bytes(80), at, at)
        progress(f"playing {seconds:.0f} s into rclpy")
        with child(
            [ros_python(), HERE / "bag_listener.py", count],
            env={**environment(), "PYTHONPATH": ""}, stdout=subprocess.PIPE, text=True,
        ) as listener:  # fmt: skip
            expect(listener, "ready\n")
            subprocess.run(
                [sys.executable, "-m", "uros", "bag", "play", str(folder)], check=True,
                env=environment(middleware), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            )  # fmt: skip
            arrivals = json.loads(listener.stdout.readline())
    numbers = [number for number, _ in arrivals]
    offsets = [at - number * 5 * MS for number, at in arrivals]
    middle = sorted(offsets)[len(offsets) // 2]
    errors = sorted(abs(offset - middle) / MS for offset in offsets)
    in_order = numbers == list(range(count))
    return in_order, errors[len(errors) // 2], errors[len(errors) * 99 // 100], errors[-1]


def ros_python() -> Path:
    """Return the interpreter that has rclpy."""
    return Path(os.environ.get("UROS_TEST_ROS_PYTHON") or ROS_PYTHON)


def show_losses(middleware: str, seconds: float) -> None:
    """Measure and print what is lost at a high rate."""
    for reliability in ("reliable", "best_effort"):
        published, recorded, cpu = bench_losses(middleware, seconds, reliability)
        print(
            f"  {reliability}, {RATE}/s for {seconds:.0f} s: {published} published,"
            f" {published - recorded} lost, CPU {cpu:.1f} µs a message",
            flush=True,
        )


def show_kill(middleware: str, moments: int) -> None:
    """Measure and print what a killed recorder loses."""
    lost = bench_kill(middleware, moments)
    print(
        f"  kill -9 at {moments} moments: of the end {lost[len(lost) // 2]:.2f} s (median) and"
        f" {lost[-1]:.2f} s (most) are lost",
        flush=True,
    )


def show_timing(middleware: str, seconds: float) -> None:
    """Measure and print how exactly messages are played."""
    if not ros_python().exists():
        print(NO_ROS)
        return
    in_order, p50, p99, most = bench_timing(middleware, seconds)
    print(
        f"  played into rclpy at 200/s: {'in order' if in_order else 'NOT IN ORDER'}, error of"
        f" the time p50 {p50:.2f} ms, p99 {p99:.2f} ms, most {most:.2f} ms",
        flush=True,
    )


def main() -> int:
    chosen = options(
        __doc__ or "", "a tenth of the time",
        part={"choices": PARTS, "nargs": "+", "default": PARTS, "help": "what to measure"},
        middleware={"choices": MIDDLEWARES, "nargs": "+", "default": MIDDLEWARES},
        seconds={"type": float, "help": "of recording (60), and of playing (20)"},
        kills={"type": int, "help": "how often a recorder is killed on each middleware (25)"},
    )  # fmt: skip
    recorded = chosen.seconds or (6.0 if chosen.quick else 60.0)
    played = chosen.seconds or (5.0 if chosen.quick else 20.0)
    kills = chosen.kills or (3 if chosen.quick else 25)
    for middleware in chosen.middleware:
        print(f"  middleware: {middleware}", flush=True)
        if "losses" in chosen.part:
            show_losses(middleware, recorded)
        if "kill" in chosen.part:
            show_kill(middleware, kills)
        if "timing" in chosen.part:
            show_timing(middleware, played)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
