"""Measures each design choice of docs/performance.md: the agent with it and without it.

    python bench/choices.py [--quick] [--domain N]

Not part of ``make bench``: it takes four minutes.
"""

from __future__ import annotations

from agent import bench_cpu, bench_round_trip
from fleet import bench_beside, bench_fleet
from process import cores_awake, options, settings


def both(choice: str, measurement, *arguments):  # type: ignore[no-untyped-def]
    """The results of a measurement with the choice, and without it."""
    results = []
    for undone in ("", choice):
        settings.undone = undone
        results.append(measurement(*arguments))
    settings.undone = ""
    return results


def row(choice: str, what: str, with_it: float, without: float, digits: int = 1) -> None:
    print(f"  {choice:<10}{what:<46}{with_it:12.{digits}f}{without:12.{digits}f}", flush=True)


def main() -> None:
    quick = options(__doc__, "a fifth of the time, noisy").quick
    settings.middleware = "dds"  # whose choices they are
    seconds, runs = (1.0, 1) if quick else (4.0, 3)
    print(f"  {'choice':<10}{'':<46}{'with':>12}{'without':>12}")
    cpu = both("batching", bench_cpu, seconds, runs)
    for (what, _, with_it), (_, _, without) in zip(*cpu, strict=True):
        if "CPU" in what or "full speed" in what:
            row("batching", what, with_it, without)
    fleet = both("sharing", bench_fleet, 40, 10, seconds, False)
    for what, digits in (("MB", 1), ("MB each", 3), ("cores, burst", 3), ("set-up ms", 2)):
        row("sharing", f"40 boards at 10 Hz: {what}", fleet[0][what], fleet[1][what], digits)
    with cores_awake():
        trips = both("local", bench_round_trip, 500 if quick else 3000, runs)
    for index, what in enumerate(("p50", "p99")):
        row("local", f"round trip between boards: {what}, µs",
            trips[0]["agent"][index], trips[1]["agent"][index])  # fmt: skip
    for choice, beside in (("turns", "flood"), ("patience", "stop")):
        results = both(choice, bench_beside, beside, seconds)
        what = "a flood" if beside == "flood" else "a reader that is stopped"
        row(choice, f"beside {what}: p99, ms", results[0][1], results[1][1], 2)
        row(choice, f"beside {what}: lost, %", results[0][2], results[1][2], 2)


if __name__ == "__main__":
    main()
