"""Many boards on one agent, and a board that loads the agent beside them.

    python bench/fleet.py [--quick] [--domain N] [--middleware NAME]

Boards are UDP sockets of one process, each with a topic of its own, 64-byte
strings, best effort; a DDS reader in another process counts the samples. A real
rclpy tests visibility where there is ``.venv-ros`` (``make test`` creates it). The
goals are printed beside the figures, without a check.
"""

from __future__ import annotations

import resource
import select
import signal
import subprocess
import sys
import time

from load import DRIVES, Board, Pacer, text
from process import (
    HERE,
    NO_ROS,
    ROS_PYTHON,
    Process,
    agent,
    counter,
    one_middleware,
    settings,
    settled,
    show,
    wait_matched,
)

SIZE = 64
# Boards, samples a second of each, and the goals: MB and cores, the latter for the even drive.
FLEETS = ((120, 10, "≤ 60", "≤ 0.15"), (1000, 10, "≤ 60", "≤ 0.5"), (2000, 5, "", ""))


def visible(boards: int) -> Process | None:
    """A node of rclpy that reports when it sees all boards' nodes and topics."""
    if not ROS_PYTHON.exists():
        return None
    arguments = (str(settings.domain), str(boards))
    return Process("visible.py", *arguments, ready="ready", python=ROS_PYTHON)


def bench_fleet(clients: int, rate: float, seconds: float, with_ros: bool) -> dict[str, float]:
    """Memory in MB, CPU in cores, set-up in ms each, samples lost in %, seconds until seen."""
    process = agent()
    other = counter(str(clients))
    peer = visible(clients) if with_ros else None
    figures = {"idle MB": process.resident()}
    try:
        boards = [Board(settings.port, 0x2000 + i, f"rt/board_{i}") for i in range(clients)]
        set_up = time.perf_counter()
        figures["set-up ms"] = sum(board.set_up for board in boards) / clients * 1000
        if peer is not None:
            peer.line()
            figures["seen s"] = time.perf_counter() - set_up
        pacer = Pacer(boards, text(SIZE))
        wait_matched(other, pacer.round, clients)
        for drive, ahead in DRIVES.items():
            before, started = process.cpu(), time.perf_counter()
            sent = pacer.run(rate, seconds, ahead)
            took = time.perf_counter() - started
            figures[f"cores, {drive}"] = (process.cpu() - before) / took
            figures[f"sent a second, {drive}"] = sent / took
            figures[f"lost %, {drive}"] = 100 * (sent - settled(other)) / sent
        figures["MB"] = process.resident()
        figures["MB each"] = (figures["MB"] - figures["idle MB"]) / clients
        if peer is not None:
            peer.close()
            started = time.perf_counter()
            peer = visible(clients)
            assert peer is not None
            peer.line()
            figures["seen late s"] = time.perf_counter() - started
        return figures
    finally:
        if peer is not None:
            peer.close()
        other.close()
        process.close()


def bench_beside(noise_by: str, seconds: float) -> tuple[float, float, float, float, float]:
    """Ten boards at 20 Hz receive their own samples, beside a board that loads the agent.

    Returns p50 and p99 in ms, the loss in %, the samples a second that the flood has sent, and how
    many of them arrived.
    """
    process = agent()
    boards = [
        Board(settings.port, 0x3000 + i, f"rt/board_{i}", reads=f"rt/board_{i}") for i in range(10)
    ]
    other = counter(*(["0", "reliable"] if noise_by == "stop" else []))
    noise = subprocess.Popen(
        [sys.executable, "noise.py", str(settings.port), noise_by, str(seconds + 2)], cwd=HERE,
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        if noise_by != "calm":
            while not other.ask():
                select.select([], [], [], 0.05)
        if noise_by == "stop":
            other.signal(signal.SIGSTOP)
        if noise_by == "flood":
            other.ask()
        started = time.perf_counter()
        sent, times = Pacer(boards, text(SIZE)).run_with_echo(20, seconds)
        took = time.perf_counter() - started
        arrived = other.ask() / took if noise_by == "flood" else 0.0
        sent_by_flood = float(noise.communicate()[0]) if noise_by == "flood" else 0.0
        return (
            times[len(times) // 2] * 1e3,
            times[len(times) * 99 // 100] * 1e3,
            100 * (sent - len(times)) / sent,
            sent_by_flood,
            arrived,
        )
    finally:
        other.signal(signal.SIGCONT)
        noise.kill()
        noise.wait()
        other.close()
        process.close()


def figure(title: str, value: float, goal: str = "", digits: int = 1) -> None:
    show(title, [value], goal, digits)


def main() -> None:
    quick = one_middleware(__doc__, "a fifth of the time, noisy")
    seconds = 2.0 if quick else 10.0
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    if not ROS_PYTHON.exists():
        print(f"  without what rclpy sees: {NO_ROS}")
    for clients, rate, megabytes, cores in FLEETS:
        figures = bench_fleet(clients, rate, seconds, with_ros=clients >= 1000)
        figure(f"{clients} boards at {rate} Hz: memory, MB", figures["MB"], megabytes)
        figure("  of which idle", figures["idle MB"])
        figure("  a board, MB", figures["MB each"], "≤ 0.1", 3)
        for drive in DRIVES:
            goal = cores if drive == "even" else ""
            figure(f"  CPU, cores, {drive}", figures[f"cores, {drive}"], goal, 3)
            figure(f"  sent a second, {drive}", figures[f"sent a second, {drive}"])
            figure(f"  lost, {drive}, %", figures[f"lost %, {drive}"], "0", 2)
        figure("  set-up each, ms", figures["set-up ms"], "≤ 3", 2)
        if "seen s" in figures:
            figure("  all seen by rclpy, s after the last", figures["seen s"], "≤ 10")
            figure("  all seen by an rclpy that starts then, s", figures["seen late s"], "≤ 2")
    for noise_by, title, goal in (
        ("calm", "ten boards at 20 Hz alone", ""),
        ("flood", "beside one that sends 50,000/s", "≤ 10"),
        ("stop", "beside one whose reader is stopped", "≤ 20"),
    ):
        p50, p99, lost, sent, arrived = bench_beside(noise_by, seconds)
        figure(f"{title}: p50, ms", p50, "", 2)
        figure("  p99, ms", p99, goal, 2)
        figure("  lost, %", lost, "≤ 1" if goal else "", 2)
        if sent:
            figure("  the flood: sent a second", sent, "")
            figure("  of which arrived", arrived, "")


if __name__ == "__main__":
    main()
