"""Compares the agent's middlewares, in one run: dds, rtps and ros2.

    python bench/middleware.py [--quick] [--domain N] [--middleware dds rtps ...]

Strings of 64 bytes, best effort, over UDP on loopback. The middlewares take turns, each figure is
the median of the runs, and the ratio is that of rtps to dds. Goals are printed beside the ratios;
what misses its goal is told at the end, and is no exit status.

The other process is the same for all of them: echo.py for round trips and counter.py else, both on
Cyclone, which is C, so that little of a figure is theirs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from echo import BACK
from load import DRIVES, Board, Pacer, paced_send, round_trips, text, until_answered
from process import (
    MIDDLEWARES,
    NO_ROS,
    ROS_PYTHON,
    agent,
    cores_awake,
    counter,
    echo,
    heading,
    middle,
    options,
    settings,
    settled,
    show,
    wait_matched,
)  # fmt: skip

SAMPLE = text(64)
BOARDS = 100  # with a datawriter and a datareader each
# Messages a second, and the drive. At 1,000 a second, both drives are the same.
LOADS = [(1000, "even"), *((rate, drive) for drive in DRIVES for rate in (5000, 20_000))]
# What decides the default: the largest ratio of rtps to dds.
GOALS = {
    "by another process, p50, µs": 1.0,
    "by another process, cores awake, p50, µs": 1.0,
    "to the board itself, p50, µs": 1.0,
    "to the board itself, cores awake, p50, µs": 1.0,
    "CPU µs/msg at 1000/s, even": 1.1,
    "CPU µs/msg at 5000/s, even": 1.1,
    "CPU µs/msg at 20000/s, even": 1.5,
    "memory idle, MB": 1.0,
    f"memory with {2 * BOARDS} endpoints, MB": 1.0,
}

Figures = Iterator[tuple[str, float]]


def bench_trips(middleware: str, count: int) -> Figures:
    """From the start to the first sample; round trips to another process and to the board."""
    other = echo()
    started = time.perf_counter()
    process = agent(middleware)
    try:
        board = Board(settings.port, 0x1000, reads=BACK)
        datagram = board.sample(SAMPLE)
        while not other.ask():
            paced_send(board.sock, datagram, 2, 1, 500)
        yield "start to first sample, ms", (time.perf_counter() - started) * 1e3
        own = Board(settings.port, 0x1001, "rt/bench_own", reads="rt/bench_own")
        for way, sock, sample in (
            ("by another process", board.sock, datagram),
            ("to the board itself", own.sock, own.sample(SAMPLE)),
        ):
            until_answered(sock, sample, 2)
            round_trips(sock, sample, 2, 200)
            asleep = round_trips(sock, sample, 2, count)
            with cores_awake():
                awake = round_trips(sock, sample, 2, count)
            for which, times in (("", asleep), (", cores awake", awake)):
                yield f"{way}{which}, p50, µs", times[count // 2]
                yield f"{way}{which}, p99, µs", times[count * 99 // 100]
    finally:
        process.close()
        other.close()


def bench_cpu(middleware: str, seconds: float) -> Figures:
    """The agent's CPU for a message that another process receives."""
    other = counter()
    process = agent(middleware)
    try:
        board = Board(settings.port, 0x1000)
        datagram = board.sample(SAMPLE)
        wait_matched(other, lambda: paced_send(board.sock, datagram, 2, 1, 0))
        for rate, drive in LOADS:
            count = int(rate * seconds)
            before = process.cpu()
            paced_send(board.sock, datagram, 2, count, rate, DRIVES[drive])
            received = settled(other)
            cpu = (process.cpu() - before) / count * 1e6
            yield f"CPU µs/msg at {rate}/s, {drive}", cpu
            yield f"  lost at {rate}/s, {drive}, %", 100 * (count - received) / count
    finally:
        process.close()
        other.close()


def bench_memory(middleware: str) -> Figures:
    """Memory before the first board, and with boards whose topics another process reads."""
    other = counter(str(BOARDS))
    process = agent(middleware)
    try:
        yield "memory idle, MB", process.resident()
        boards = [
            Board(settings.port, 0x2000 + i, f"rt/board_{i}", reads=f"rt/board_{i}")
            for i in range(BOARDS)
        ]
        wait_matched(other, Pacer(boards, SAMPLE).round, BOARDS)
        yield f"memory with {2 * BOARDS} endpoints, MB", process.resident()
    finally:
        process.close()
        other.close()


def main() -> None:
    names = [name for name in MIDDLEWARES if name != "auto"]
    parsed = options(
        __doc__, "a tenth of the time, noisy",
        middleware={"nargs": "+", "choices": names, "default": names},
    )  # fmt: skip
    names = list(parsed.middleware)
    if "ros2" in names and not ROS_PYTHON.exists():
        print(f"  without ros2: {NO_ROS}")
        names.remove("ros2")
    seconds, count, runs = (0.5, 300, 1) if parsed.quick else (4.0, 3000, 3)
    figures: dict[str, dict[str, list[float]]] = {}
    for _ in range(runs):
        for name in names:
            for bench in (
                bench_trips(name, count), bench_cpu(name, seconds), bench_memory(name)
            ):  # fmt: skip
                for what, value in bench:
                    figures.setdefault(what, {}).setdefault(name, []).append(value)
    heading(*names)
    missed = []
    for what, values in figures.items():
        row = [middle(values[name]) for name in names]
        goal = GOALS.get(what)
        show(what, row, f"≤ {goal} ×" if goal else "")
        if goal and names[:2] == ["dds", "rtps"] and row[1] > goal * row[0]:
            missed.append(what)
    if names[:2] == ["dds", "rtps"]:
        print("  " + ("missed: " + "; ".join(missed) if missed else "all goals are reached"))


if __name__ == "__main__":
    main()
