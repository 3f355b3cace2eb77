"""Compares the agent with the bare relay, in one run.

    python bench/agent.py [--quick] [--domain N] [--middleware NAME]

Best-effort std_msgs/String of 64 bytes over UDP on loopback, counted by a DDS
reader in another process. Ratios are agent over relay, so that machines
can be compared; the goals are printed beside them, without a check. They are for the even drive.
"""

from __future__ import annotations

import socket

from load import BURST, DRIVES, Board, paced_send, round_trips, text
from process import (
    agent,
    cores_awake,
    counter,
    heading,
    middle,
    one_middleware,
    relay,
    settings,
    settled,
    show,
    wait_matched,
)
from relay import TOPIC

SIZE = 64
RATES = (5_000, 20_000)
GOALS = {
    "round trip p50, µs": "≤ 1.3 ×",
    "  cores awake, p50, µs": "≤ 1.3 ×",
    "CPU µs/msg at 5000/s, even": "≤ 1.0 ×",
    "CPU µs/msg at 20000/s, even": "≤ 0.85 ×",
    "received of 100000 at full speed": "≥ 1 ×",
    "CPU µs/msg received, at full speed": "≤ 1.25 ×",
    "reliable: CPU µs/msg at 5000/s, even": "≤ 1.6 ×",
}


def relay_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", settings.port))
    return sock


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
                    board = Board(settings.port, 0x1000, reads=TOPIC)
                    sock, datagram, at = board.sock, board.sample(text(SIZE)), 2
                round_trips(sock, datagram, at, 200)
                times = round_trips(sock, datagram, at, count)
                figures[name].append((times[len(times) // 2], times[len(times) * 99 // 100]))
            finally:
                process.close()
    return {name: sorted(values)[len(values) // 2] for name, values in figures.items()}


def bench_cpu(seconds: float, runs: int) -> list[tuple[str, float | None, float]]:
    """(figure, relay, agent) of CPU µs a message, and of messages received.

    The relay has no reliable stream; those figures stand beside its best-effort ones.
    """
    rows: dict[str, dict[str, list[float]]] = {}

    def note(what: str, end: str, value: float) -> None:
        rows.setdefault(what, {}).setdefault(end, []).append(value)

    for _ in range(runs):
        for end in ("relay", "agent"):
            process = relay(False) if end == "relay" else agent()
            other = counter()
            try:
                if end == "relay":
                    sock, datagram, at = relay_socket(), bytearray(b"\0\0" + bytes(SIZE)), 0
                else:
                    board = Board(settings.port, 0x1000)
                    sock, datagram, at = board.sock, board.sample(text(SIZE)), 2

                def burst(count: int, rate: float, drive: float = BURST) -> None:
                    paced_send(sock, datagram, at, count, rate, drive)  # noqa: B023

                wait_matched(other, lambda: burst(1, 0))  # noqa: B023
                for drive, ahead in DRIVES.items():
                    for rate in RATES:
                        count = int(rate * seconds)
                        before = process.cpu()
                        burst(count, rate, ahead)
                        received = settled(other)
                        cpu = (process.cpu() - before) / count * 1e6
                        note(f"CPU µs/msg at {rate}/s, {drive}", end, cpu)
                        note(f"received of {count} at {rate}/s, {drive}", end, received)
                before = process.cpu()
                burst(100_000, 0)
                received = settled(other)
                note("received of 100000 at full speed", end, received)
                cpu = (process.cpu() - before) / received * 1e6
                note("CPU µs/msg received, at full speed", end, cpu)
                for rate in RATES if end == "agent" else ():
                    count = int(rate * seconds)
                    before = process.cpu()
                    seconds_taken = board.send_reliable(count, rate, text(SIZE))
                    cpu = (process.cpu() - before) / count * 1e6
                    note(f"reliable: CPU µs/msg at {rate}/s, even", end, cpu)
                    note(f"reliable: received of {count}", end, settled(other))
                    note(f"reliable: messages a second at {rate}/s", end, count / seconds_taken)
            finally:
                process.close()
                other.close()
    out = []
    for what, values in rows.items():
        like = what.removeprefix("reliable: ")
        relays = rows[like].get("relay") if like in rows else None
        out.append((what, middle(relays) if relays else None, middle(values["agent"])))
    return out


def main() -> None:
    quick = one_middleware(__doc__, "a tenth of the time, noisy")
    seconds, runs = (0.5, 1) if quick else (4.0, 3)
    heading("relay", "agent")
    trips = {"round trip": bench_round_trip(500 if quick else 3000, runs)}
    with cores_awake():
        trips["  cores awake,"] = bench_round_trip(500 if quick else 3000, runs + 2)
    for title, both in trips.items():
        for index, which in enumerate(("p50", "p99")):
            what = f"{title} {which}, µs"
            show(what, [both[end][index] for end in ("relay", "agent")], GOALS.get(what, ""))
    for what, relay_value, agent_value in bench_cpu(seconds, runs):
        show(what, [relay_value, agent_value], GOALS.get(what, ""))


if __name__ == "__main__":
    main()
