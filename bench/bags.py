"""Recording and playing bags: losses at 5,000 messages a second, kill -9, timing.

    python bench/bags.py [--quick] [--domain N]

With Cyclone where it is installed, and on rtps. Not part of ``make bench``: it takes five minutes.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from process import HERE, NO_ROS, ROS_PYTHON, options, settings

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.qos import QoSProfile

RATE = 5000
TYPE = "std_msgs/msg/UInt8MultiArray"
MS = 1_000_000
WITHOUT_CYCLONE = HERE.parent / "tests" / "support" / "without_cyclone"


def environment(middleware: str = "auto") -> dict[str, str]:
    """Return the variables of processes on loopback."""
    variables = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    variables["ROS_DOMAIN_ID"] = str(settings.domain)
    variables["PYTHONPATH"] = str(HERE.parent / "src")
    if middleware == "rtps":
        variables["PYTHONPATH"] += f":{WITHOUT_CYCLONE}"
    return variables


def record(folder: Path, middleware: str, *arguments: str) -> subprocess.Popen[bytes]:
    """Start a recorder of everything."""
    command = [sys.executable, "-m", "uros", "bag", "record", "/bench", "-o", str(folder)]
    return subprocess.Popen(
        [*command, *arguments], env=environment(middleware), stdout=subprocess.DEVNULL
    )


def talk(middleware: str, rate: float, seconds: float, reliability: str) -> subprocess.Popen[str]:
    """Start a talker; return when it has found its subscription."""
    talker = subprocess.Popen(
        [sys.executable, str(HERE / "bag_talker.py"),
         str(settings.domain), str(rate), str(seconds), reliability],
        env=environment(middleware), stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert talker.stdout is not None
    assert talker.stdout.readline() == "matched\n"
    return talker


def bench_losses(middleware: str, seconds: float, reliability: str) -> tuple[int, int, float]:
    """Record at 5,000 messages a second; return published, recorded, and CPU µs a message."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = record(Path(folder) / "bag", middleware)
        talker = talk(middleware, RATE, seconds, reliability)
        assert talker.stdout is not None
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
    for _ in range(moments):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bag"
            recorder = record(folder, middleware)
            talker = talk(middleware, 500, 60, "reliable")
            time.sleep(random.uniform(0.2, 4.0))
            killed_at = time.time_ns()
            recorder.kill()
            recorder.wait()
            talker.kill()
            talker.wait()
            subprocess.run(
                [sys.executable, "-m", "uros", "bag", "recover", str(folder)],
                env=environment(), check=True, stdout=subprocess.DEVNULL,
            )  # fmt: skip
            last, count = 0, 0
            for message in BagReader(folder).messages():
                assert int.from_bytes(message.cdr[4:12], "little") == count, "a hole"
                last = int.from_bytes(message.cdr[12:20], "little")
                count += 1
            lost.append((killed_at - last) / 1e9 if count else 9.0)
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
        listener = subprocess.Popen(
            [str(ros_python()), str(HERE / "bag_listener.py"), str(count)],
            env={**environment(), "PYTHONPATH": ""}, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert listener.stdout is not None
        assert listener.stdout.readline() == "ready\n"
        subprocess.run(
            [sys.executable, "-m", "uros", "bag", "play", str(folder)],
            env=environment(middleware), check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        arrivals = json.loads(listener.stdout.readline())
        listener.wait()
    numbers = [number for number, _ in arrivals]
    offsets = [at - number * 5 * MS for number, at in arrivals]
    middle = sorted(offsets)[len(offsets) // 2]
    errors = sorted(abs(offset - middle) / MS for offset in offsets)
    in_order = numbers == list(range(count))
    return in_order, errors[len(errors) // 2], errors[len(errors) * 99 // 100], errors[-1]


def ros_python() -> Path:
    """Return the interpreter that has rclpy."""
    return Path(os.environ.get("UROS_TEST_ROS_PYTHON") or ROS_PYTHON)


def main() -> int:
    quick = options(__doc__ or "", "a tenth of the time").quick
    seconds, moments = (6.0, 3) if quick else (60.0, 25)
    for middleware in ("auto", "rtps"):
        print(f"  middleware: {middleware}", flush=True)
        for reliability in ("reliable", "best_effort"):
            published, recorded, cpu = bench_losses(middleware, seconds, reliability)
            print(
                f"  {reliability}, {RATE}/s for {seconds:.0f} s: {published} published,"
                f" {published - recorded} lost, CPU {cpu:.1f} µs a message",
                flush=True,
            )
        lost = bench_kill(middleware, moments)
        median, most = lost[len(lost) // 2], lost[-1]
        print(
            f"  kill -9 at {moments} moments: of the end {median:.2f} s (median) and {most:.2f} s"
            " (most) are lost",
            flush=True,
        )
        if not ros_python().exists():
            print(NO_ROS)
            continue
        in_order, p50, p99, most = bench_timing(middleware, 5.0 if quick else 20.0)
        print(
            f"  played into rclpy at 200/s: {'in order' if in_order else 'NOT IN ORDER'}, error of"
            f" the time p50 {p50:.2f} ms, p99 {p99:.2f} ms, most {most:.2f} ms",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
