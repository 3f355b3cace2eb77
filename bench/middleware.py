"""Compares the agent's middlewares, in one run: dds, rtps and ros2.

    python bench/middleware.py [--quick] [--domain N] [--middleware dds rtps ...]

Strings of 64 bytes, best effort, over UDP on loopback. An agent of each middleware runs, and they
take turns within each measurement; the agents are started anew some times. A figure is the median
of the turns. The ratio is that of rtps to dds, and behind it the range of the ratios of turns that
follow each other. Goals are printed beside the ratios; what misses its goal is told at the end, and
is no exit status.

The other process is the same for all of them: echo.py for round trips and counter.py else, both on
Cyclone, which is C, so that little of a figure is theirs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from load import DRIVES, Board, Pacer, paced_send, round_trips, text, until_answered
from process import (
    MIDDLEWARES,
    NO_ROS,
    ROS_PYTHON,
    Process,
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
)

SAMPLE = text(64)
BOARDS = 100  # with a datawriter and a datareader each
# Messages a second, and the drive. At 1,000 a second, both drives are the same.
LOADS = [(1000, "even"), *((rate, drive) for drive in DRIVES for rate in (5000, 20_000))]
# What decides the default: the largest ratio of rtps to dds.
GOALS = {
    "by another process, p50, µs": 1.0,
    "by another process, cores awake, p50, µs": 1.0,
    "CPU µs/msg at 1000/s, even": 1.1,
    "CPU µs/msg at 5000/s, even": 1.1,
    "CPU µs/msg at 20000/s, even": 1.5,
    "memory idle, MB": 1.0,
    f"memory with {2 * BOARDS} endpoints, MB": 1.0,
}


class Contestant:
    """An agent of one middleware, and three boards of it."""

    def __init__(self, name: str, number: int, other: Process) -> None:
        """``other`` sends what it receives on the topic ``rt/NAME`` back."""
        self.name = name
        port = settings.port + number
        started = time.perf_counter()
        self.process = agent(name, number)
        # Its samples come back by the other process, and within the agent; those of the last one
        # are only counted.
        board = Board(port, 0x1000, f"rt/{name}", reads=f"rt/{name}_back")
        sample = board.sample(SAMPLE)
        other.ask()
        while not other.ask():
            paced_send(board.sock, sample, 2, 1, 500)
        self.start = time.perf_counter() - started
        itself = Board(port, 0x1001, f"rt/{name}_itself", reads=f"rt/{name}_itself")
        self.ways = {
            "by another process": (board.sock, sample),
            "to the board itself": (itself.sock, itself.sample(SAMPLE)),
        }
        for sock, datagram in self.ways.values():
            until_answered(sock, datagram, 2)
        self._counted = Board(port, 0x1002, f"rt/board_{number}")
        self._sample = self._counted.sample(SAMPLE)

    def send(self, count: int, rate: float, drive: float) -> None:
        """Send samples that are counted, best effort."""
        paced_send(self._counted.sock, self._sample, 2, count, rate, drive)

    def send_reliable(self, count: int, rate: float) -> None:
        """Send samples that are counted, evenly, and wait until the agent has them all."""
        self._counted.send_reliable(count, rate, SAMPLE)


class Comparison:
    """The figures of some middlewares.

    Attributes:
        figures: By title and middleware, the values of all turns.
    """

    def __init__(self, names: list[str]) -> None:
        self.names = names
        self.figures: dict[str, dict[str, list[float]]] = {}

    def note(self, what: str, name: str, value: float) -> None:
        self.figures.setdefault(what, {}).setdefault(name, []).append(value)

    def show(self) -> None:
        heading(*self.names)
        decides = self.names[:2] == ["dds", "rtps"]
        missed = []
        for what, turns in self.figures.items():
            row = [middle(turns[name]) for name in self.names]
            goal = GOALS.get(what, 0.0) if decides else 0.0
            note = ""
            if decides and row[0]:
                ratios = [b / a for a, b in zip(turns["dds"], turns["rtps"], strict=True) if a]
                note = f"({min(ratios):.2f} to {max(ratios):.2f})" if len(ratios) > 1 else ""
            show(what, row, f"≤ {goal} ×" if goal else "", note=note)
            if goal and row[1] > goal * row[0]:
                missed.append(what)
        if decides:
            print("  " + ("missed: " + "; ".join(missed) if missed else "all goals are reached"))


def bench_trips(comparison: Comparison, contestants: list[Contestant], count: int) -> None:
    """Round trips through another process, and to the board itself: p50 and p99 in µs."""

    def trips(way: str, title: str) -> None:
        for one in contestants:
            sock, datagram = one.ways[way]
            round_trips(sock, datagram, 2, 100)
            times = round_trips(sock, datagram, 2, count)
            comparison.note(f"{title}, p50, µs", one.name, times[count // 2])
            comparison.note(f"{title}, p99, µs", one.name, times[count * 99 // 100])

    for way in contestants[0].ways:
        trips(way, way)
        with cores_awake():
            trips(way, f"{way}, cores awake")


def bench_cpu(
    comparison: Comparison, contestants: list[Contestant], other: Process, seconds: float
) -> None:
    """The agent's CPU for a message that another process receives."""

    def sending(one: Contestant, send: Callable[[], None]) -> tuple[float, int]:
        """The CPU in µs, and how many samples arrive."""
        before = one.process.cpu()
        send()
        received = settled(other)
        return (one.process.cpu() - before) * 1e6, received

    for rate, drive in LOADS:
        count = int(rate * seconds)
        for one in contestants:
            cpu, received = sending(one, partial(one.send, count, rate, DRIVES[drive]))
            comparison.note(f"CPU µs/msg at {rate}/s, {drive}", one.name, cpu / count)
            lost = 100 * (count - received) / count
            comparison.note(f"  lost at {rate}/s, {drive}, %", one.name, lost)
    count = int(5000 * seconds)
    for one in contestants:
        cpu, _ = sending(one, partial(one.send_reliable, count, 5000))
        comparison.note("reliable: CPU µs/msg at 5000/s, even", one.name, cpu / count)
    count = int(100_000 * seconds)
    for one in contestants:
        cpu, received = sending(one, partial(one.send, count, 0, 0))
        comparison.note(f"received of {count} at full speed", one.name, received)
        comparison.note("CPU µs/msg received, at full speed", one.name, cpu / received)


def bench_running(comparison: Comparison, turns: int, count: int, seconds: float) -> None:
    """Start the agents and measure them in turn."""
    processes = [echo(*(f"rt/{name}" for name in comparison.names))]
    contestants: list[Contestant] = []
    try:
        for number, name in enumerate(comparison.names):
            one = Contestant(name, number, processes[0])
            contestants.append(one)
            comparison.note("start to first sample, ms", name, one.start * 1000)
        processes.append(counter(str(len(contestants))))
        for one in contestants:
            wait_matched(processes[1], lambda: one.send(1, 0, 0))  # noqa: B023
        for _ in range(turns):
            bench_trips(comparison, contestants, count)
            bench_cpu(comparison, contestants, processes[1], seconds)
    finally:
        for process in (*processes, *(one.process for one in contestants)):
            process.close()


def bench_memory(comparison: Comparison) -> None:
    """Memory before the first board, and with boards whose topics another process reads."""
    for name in comparison.names:
        other = counter(str(BOARDS))
        process = agent(name)
        try:
            comparison.note("memory idle, MB", name, process.resident())
            topics = [f"rt/board_{i}" for i in range(BOARDS)]
            boards = [
                Board(settings.port, 0x2000 + i, topic, reads=topic)
                for i, topic in enumerate(topics)
            ]
            wait_matched(other, Pacer(boards, SAMPLE).round, BOARDS)
            what = f"memory with {2 * BOARDS} endpoints, MB"
            comparison.note(what, name, process.resident())
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
    starts, turns, count, seconds = (1, 1, 500, 0.5) if parsed.quick else (3, 2, 1500, 1.0)
    comparison = Comparison(names)
    for _ in range(starts):
        bench_running(comparison, turns, count, seconds)
        bench_memory(comparison)
    comparison.show()


if __name__ == "__main__":
    main()
