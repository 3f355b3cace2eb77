"""The agent against the bare relay, in one run.

    python bench/agent.py [--quick]

Best-effort std_msgs/String of 64 bytes over UDP on loopback, counted by a DDS
reader in another process. Ratios are agent over relay, so that they mean the
same on every machine; the goals are printed beside them and decide nothing.
"""

from __future__ import annotations

import argparse
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from load import Board, paced_send, round_trips, text

HERE = Path(__file__).resolve().parent
PORT = 18_888
DOMAIN = 110
SIZE = 64

LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
)


class Process:
    """A child process that says when it is ready."""

    def __init__(self, *arguments: str, ready: str) -> None:
        environment = dict(os.environ, CYCLONEDDS_URI=LOOPBACK, PYTHONUNBUFFERED="1")
        self._process = subprocess.Popen(
            [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, env=environment, cwd=HERE,
        )  # fmt: skip
        while True:
            line = self.line()
            if ready in line:
                return

    def line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self._process.args} ended with {self._process.wait()}")
        return line

    def ask(self) -> int:
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return int(self.line())

    def cpu(self) -> float:
        """Seconds of CPU used so far, all threads (user and system)."""
        total = 0
        for task in Path(f"/proc/{self._process.pid}/task").iterdir():
            total += int((task / "schedstat").read_text().split()[0])
        return total / 1e9

    def resident(self) -> float:
        """Resident memory in MB."""
        for line in Path(f"/proc/{self._process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
        return 0.0

    def close(self) -> None:
        self._process.terminate()
        self._process.communicate()


def relay(echo: bool) -> Process:
    return Process("relay.py", str(PORT), str(DOMAIN), *(["echo"] if echo else []), ready="ready")


def agent() -> Process:
    return Process(
        "-m", "uros", "agent", "udp4", "-p", str(PORT), "--domain", str(DOMAIN), ready="running..."
    )


def relay_socket():  # type: ignore[no-untyped-def]
    import socket

    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", PORT))
    return sock


def settled(counter: Process) -> int:
    """Samples counted once no more arrive."""
    total = counter.ask()
    while True:
        select.select([], [], [], 0.3)
        more = counter.ask()
        if not more:
            return total
        total += more


def wait_matched(counter: Process, send) -> None:  # type: ignore[no-untyped-def]
    """Send until the counter hears."""
    end = time.monotonic() + 10
    while not counter.ask():
        if time.monotonic() > end:
            raise TimeoutError("the counting reader hears nothing")
        send()
        select.select([], [], [], 0.1)
    settled(counter)


def median_of(runs):  # type: ignore[no-untyped-def]
    """The run in the middle, by its first number."""
    return sorted(runs)[len(runs) // 2]


@contextmanager
def cores_awake() -> Iterator[None]:
    """Keep every core from sleeping, by processes that run only where nobody else would.

    On a virtual machine, waking a sleeping core costs more than what is measured here.
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
    """p50 and p99 in µs, the median of runs taken in turns."""
    found: dict[str, list[tuple[float, float]]] = {"relay": [], "agent": []}
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
                found[name].append((times[len(times) // 2], times[len(times) * 99 // 100]))
            finally:
                process.close()
    return {name: median_of(values) for name, values in found.items()}


def bench_cpu(seconds: float, runs: int) -> list[tuple[str, float, float]]:
    """(what, relay, agent) of CPU µs a message, and of messages received."""
    rows: dict[str, dict[str, list[float]]] = {}

    def note(what: str, who: str, value: float) -> None:
        rows.setdefault(what, {}).setdefault(who, []).append(value)

    for _ in range(runs):
        for who in ("relay", "agent"):
            process = relay(False) if who == "relay" else agent()
            counter = Process("counter.py", str(DOMAIN), ready="ready")
            try:
                if who == "relay":
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
                    got = settled(counter)
                    note(f"CPU µs/msg at {rate}/s", who, (process.cpu() - before) / count * 1e6)
                    note(f"received of {count} at {rate}/s", who, got)
                burst(100_000, 0)
                note("received of 100000 at full speed", who, settled(counter))
                if who == "agent":
                    for rate in (5_000, 20_000):
                        count = int(rate * seconds)
                        before = process.cpu()
                        took = board.send_reliable(count, rate, text(SIZE))
                        cpu = (process.cpu() - before) / count * 1e6
                        got = settled(counter)
                        note(f"reliable: CPU µs/msg at {rate}/s", who, cpu)
                        note(f"reliable: received of {count}", who, got)
                        note(f"reliable: messages a second at {rate}/s", who, count / took)
            finally:
                process.close()
                counter.close()
    out = []
    for what, values in rows.items():
        middle = {who: sorted(found)[len(found) // 2] for who, found in values.items()}
        out.append((what, middle.get("relay", 0.0), middle["agent"]))
    return out


def bench_fleet(clients: int, rate: float, seconds: float) -> dict[str, float]:
    """Many boards: memory in MB, CPU in cores, set-up in ms each."""
    process = agent()
    try:
        idle = process.resident()
        boards = [Board(PORT, 0x2000 + i, f"rt/board_{i}") for i in range(clients)]
        set_up = sum(board.set_up for board in boards) / clients * 1000
        payload = text(SIZE)
        datagrams = [board.sample(payload, False) for board in boards]
        time.sleep(0.5)
        before, started = process.cpu(), time.perf_counter()
        interval = 1 / (rate * clients)
        sent = 0
        while time.perf_counter() - started < seconds:
            board, datagram = boards[sent % clients], datagrams[sent % clients]
            number = sent // clients
            datagram[2], datagram[3] = number & 0xFF, number >> 8 & 0xFF
            board.sock.send(datagram)
            sent += 1
            ahead = started + sent * interval - time.perf_counter()
            if ahead > 0.0005:
                time.sleep(ahead)
        took = time.perf_counter() - started
        return {
            "idle MB": idle,
            "MB": process.resident(),
            "cores": (process.cpu() - before) / took,
            "set-up ms": set_up,
        }
    finally:
        process.close()


def show(what: str, relay_value: float, agent_value: float, goal: str) -> None:
    ratio = f"{agent_value / relay_value:6.2f} ×" if relay_value else ""
    known = f"{relay_value:12.1f}" if relay_value else " " * 12
    print(f"  {what:<42}{known}{agent_value:12.1f}  {ratio:<9} {goal}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the time, noisy")
    quick = parser.parse_args().quick
    seconds, runs = (0.5, 1) if quick else (4.0, 3)
    print(f"  {'':<42}{'relay':>12}{'agent':>12}  ratio     goal")
    with cores_awake():
        trips = bench_round_trip(500 if quick else 3000, runs + 2)
    show("round trip p50, µs", trips["relay"][0], trips["agent"][0], "≤ 1.5 ×")
    show("round trip p99, µs", trips["relay"][1], trips["agent"][1], "")
    trips = bench_round_trip(500 if quick else 3000, runs)
    show("  the same, cores asleep in between: p50", trips["relay"][0], trips["agent"][0], "")
    show("  the same, cores asleep in between: p99", trips["relay"][1], trips["agent"][1], "")
    rows = bench_cpu(seconds, runs)
    base = {what: value for what, value, _ in rows}
    goals = {"CPU µs/msg at 20000/s": "≤ 1.6 ×", "received of 100000 at full speed": "≥ 0.75 ×"}
    for what, relay_value, agent_value in rows:
        goal = goals.get(what, "")
        if what.startswith("reliable: CPU"):
            relay_value = base[what.removeprefix("reliable: ")]
            goal = "≤ 2 ×" if "20000" in what else ""
        show(what, relay_value, agent_value, goal)
    fleet = bench_fleet(120, 10, 2.0 if quick else 10.0)
    show("120 boards at 10 Hz: memory, MB", 0, fleet["MB"], "≤ 60")
    show("  of which idle", 0, fleet["idle MB"], "")
    print(f"  {'120 boards at 10 Hz: CPU, cores':<54}{fleet['cores']:12.3f}{'':12}≤ 0.2")
    show("120 boards: set-up each, ms", 0, fleet["set-up ms"], "≤ 4")


if __name__ == "__main__":
    main()
