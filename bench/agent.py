"""Compares the agent with the bare relay, in one run.

    python bench/agent.py [--quick]

Best-effort std_msgs/String of 64 bytes over UDP on loopback, counted by a DDS
reader in another process. Ratios are agent over relay, so that machines
can be compared; the goals are printed beside them, without a check.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from load import Board, paced_send, round_trips, text
from process import DOMAIN, PORT, Process, agent, relay, settled, show, wait_matched

SIZE = 64


def relay_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", PORT))
    return sock


def median_of(runs):  # type: ignore[no-untyped-def]
    """The median run, by its first number."""
    return sorted(runs)[len(runs) // 2]


@contextmanager
def cores_awake() -> Iterator[None]:
    """Keep every core from sleeping, by processes with the policy SCHED_IDLE.

    On a virtual machine, waking a sleeping core takes longer than the measured operations.
    """
    spin = "import os\nos.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\nwhile True: pass"
    spinners = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()


def bench_round_trip(count: int, runs: int) -> dict[str, tuple[float, float]]:
    """p50 and p99 in µs, the median of alternating runs."""
    figures: dict[str, list[tuple[float, float]]] = {"relay": [], "agent": []}
    for _ in range(runs):
        for name in ("relay", "agent"):
            process = relay(True) if name == "relay" else agent()
            try:
                if name == "relay":
                    sock, datagram, at = relay_socket(), bytearray(b"\0\0" + bytes(SIZE)), 0
                else:
                    board = Board(PORT, 0x1000, reading=True)
                    sock, datagram, at = board.sock, board.sample(text(SIZE), False), 2
                round_trips(sock, datagram, at, 200)
                times = round_trips(sock, datagram, at, count)
                figures[name].append((times[len(times) // 2], times[len(times) * 99 // 100]))
            finally:
                process.close()
    return {name: median_of(values) for name, values in figures.items()}


def bench_cpu(seconds: float, runs: int) -> list[tuple[str, float, float]]:
    """(figure, relay, agent) of CPU µs a message, and of messages received."""
    rows: dict[str, dict[str, list[float]]] = {}

    def note(what: str, end: str, value: float) -> None:
        rows.setdefault(what, {}).setdefault(end, []).append(value)

    for _ in range(runs):
        for end in ("relay", "agent"):
            process = relay(False) if end == "relay" else agent()
            counter = Process("counter.py", str(DOMAIN), ready="ready")
            try:
                if end == "relay":
                    sock, datagram, at = relay_socket(), bytearray(b"\0\0" + bytes(SIZE)), 0
                else:
                    board = Board(PORT, 0x1000)
                    sock, datagram, at = board.sock, board.sample(text(SIZE), False), 2

                def burst(count: int, rate: float) -> float:
                    return paced_send(sock, datagram, at, count, rate)  # noqa: B023

                wait_matched(counter, lambda: burst(1, 0))  # noqa: B023
                for rate in (5_000, 20_000):
                    count = int(rate * seconds)
                    before = process.cpu()
                    burst(count, rate)
                    received = settled(counter)
                    note(f"CPU µs/msg at {rate}/s", end, (process.cpu() - before) / count * 1e6)
                    note(f"received of {count} at {rate}/s", end, received)
                before = process.cpu()
                burst(100_000, 0)
                received = settled(counter)
                note("received of 100000 at full speed", end, received)
                cpu = (process.cpu() - before) / received * 1e6
                note("CPU µs/msg received, at full speed", end, cpu)
                if end == "agent":
                    for rate in (5_000, 20_000):
                        count = int(rate * seconds)
                        before = process.cpu()
                        seconds_taken = board.send_reliable(count, rate, text(SIZE))
                        cpu = (process.cpu() - before) / count * 1e6
                        received = settled(counter)
                        note(f"reliable: CPU µs/msg at {rate}/s", end, cpu)
                        note(f"reliable: received of {count}", end, received)
                        note(f"reliable: messages a second at {rate}/s", end, count / seconds_taken)
            finally:
                process.close()
                counter.close()
    out = []
    for what, values in rows.items():
        middle = {end: sorted(figures)[len(figures) // 2] for end, figures in values.items()}
        out.append((what, middle.get("relay", 0.0), middle["agent"]))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the time, noisy")
    quick = parser.parse_args().quick
    seconds, runs = (0.5, 1) if quick else (4.0, 3)
    print(f"  {'':<42}{'relay':>12}{'agent':>12}  ratio     goal")
    with cores_awake():
        trips = bench_round_trip(500 if quick else 3000, runs + 2)
    show("round trip p50, µs", trips["relay"][0], trips["agent"][0], "≤ 1.25 ×")
    show("round trip p99, µs", trips["relay"][1], trips["agent"][1], "")
    trips = bench_round_trip(500 if quick else 3000, runs)
    show("  the same, cores asleep in between: p50", trips["relay"][0], trips["agent"][0], "")
    show("  the same, cores asleep in between: p99", trips["relay"][1], trips["agent"][1], "")
    rows = bench_cpu(seconds, runs)
    base = {what: value for what, value, _ in rows}
    goals = {
        "CPU µs/msg at 20000/s": "≤ 1.25 ×",
        "CPU µs/msg received, at full speed": "≤ 1.25 ×",
        "received of 100000 at full speed": "≥ 1 ×",
    }
    for what, relay_value, agent_value in rows:
        goal = goals.get(what, "")
        if what.startswith("reliable: CPU"):
            relay_value = base[what.removeprefix("reliable: ")]
            goal = "≤ 1.8 ×" if "20000" in what else ""
        show(what, relay_value, agent_value, goal)


if __name__ == "__main__":
    main()
