"""The benchmarks of ``bench/``: what decides a figure, without measuring time."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"
MICROSECOND = 1e-6


@pytest.fixture
def bench(monkeypatch):
    """A function that imports a module of bench/, whose names others may have."""
    monkeypatch.syspath_prepend(str(BENCH))
    mine = {path.stem for path in BENCH.glob("*.py")}
    others = {name: sys.modules.pop(name) for name in mine & set(sys.modules)}
    yield importlib.import_module
    for name in mine & set(sys.modules):
        del sys.modules[name]
    sys.modules.update(others)


class Clock:
    """A clock that sleeping and sending advance, in place of the module ``time``."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Socket:
    """Sends in 4 µs and notes when."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.times: list[float] = []

    def send(self, datagram: bytes) -> None:
        self.times.append(self.clock.now)
        self.clock.now += 4 * MICROSECOND


def sending_times(bench, monkeypatch, rate: float, drive: str) -> list[float]:
    load = bench("load")
    clock = Clock()
    monkeypatch.setattr(load, "time", clock)
    sock = Socket(clock)
    load.paced_send(sock, bytearray(4), 2, 200, rate, load.DRIVES[drive])
    return sock.times


@pytest.mark.parametrize("rate", [1000, 5000, 20_000])
def test_the_even_drive_sends_each_sample_at_its_time(bench, monkeypatch, rate):
    times = sending_times(bench, monkeypatch, rate, "even")
    assert times == pytest.approx([number / rate for number in range(200)])


def test_the_burst_drive_sends_bursts_of_ten_and_keeps_the_rate(bench, monkeypatch):
    times = sending_times(bench, monkeypatch, 20_000, "burst")
    pauses = [
        number
        for number, (a, b) in enumerate(zip(times, times[1:], strict=False), 1)
        if b - a > 100 * MICROSECOND
    ]
    bursts = [b - a for a, b in zip(pauses, pauses[1:], strict=False)]
    assert bursts and set(bursts) <= {10, 11, 12}
    assert times[-1] == pytest.approx(200 / 20_000, abs=600 * MICROSECOND)


def test_a_goal_that_is_missed_is_told_with_its_name(bench, capsys):
    middleware = bench("middleware")
    comparison = middleware.Comparison(["dds", "rtps", "ros2"])
    for what, dds, rtps in (
        ("CPU µs/msg at 5000/s, even", (40.0, 10.0, 41.0), (43.0, 30.0, 44.0)),
        ("memory idle, MB", (30.0, 30.0, 30.0), (31.0, 20.0, 31.0)),
        ("CPU µs/msg at 5000/s, burst", (1.0, 1.0, 1.0), (9.0, 9.0, 9.0)),
    ):
        for ours, theirs in zip(rtps, dds, strict=True):
            for name, value in (("dds", theirs), ("rtps", ours), ("ros2", 99.0)):
                comparison.note(what, name, value)
    assert comparison.show() is None
    cpu, memory, _, last = capsys.readouterr().out.splitlines()[1:]
    assert " ".join(cpu.split()).endswith("40.0 43.0 99.0 1.07 × ≤ 1.1 × (1.07 to 3.00)")
    assert " ".join(memory.split()).endswith("30.0 31.0 99.0 1.03 × ≤ 1.0 × (0.67 to 1.03)")
    assert last == "  missed: memory idle, MB"


@pytest.mark.parametrize("name", ["rtps", "ros2"])
def test_an_agent_has_the_middleware_and_the_domain_that_were_asked_for(bench, monkeypatch, name):
    process = bench("process")
    started = []
    monkeypatch.setattr(process, "Process", lambda *a, **options: started.append((a, options)))
    monkeypatch.setattr(sys, "argv", ["bench", "--domain", "66", "--middleware", name])
    assert process.one_middleware("A bench.", "less time") is False
    process.agent(number=1)
    ((arguments, options),) = started
    port = 18_000 + 8 * 66 + 1
    expected = f"-m uros agent udp4 -p {port} --domain 66 -m {name}"
    assert " ".join(arguments) == expected
    assert (options["python"] == process.ROS_PYTHON) == (name == "ros2")


def test_each_benchmark_that_make_runs_knows_its_options(bench):
    for name in bench("run").BENCHMARKS:
        if name == "drive.py":  # in virtual time, without a network
            continue
        help_text = subprocess.run(
            [sys.executable, BENCH / name, "--help"], capture_output=True, text=True, cwd=BENCH
        ).stdout
        assert "--quick" in help_text and "--domain" in help_text, name


SMALLEST = """
import json, sys
import middleware
middleware.settings.domain = int(sys.argv[1])
comparison = middleware.Comparison(["dds", "rtps"])
middleware.bench_running(comparison, turns=1, count=2, seconds=0.01)
middleware.bench_memory(comparison)
print(json.dumps(comparison.figures))
"""


@pytest.mark.long
@pytest.mark.slow
def test_two_middlewares_in_one_run_have_each_figure_that_has_a_goal(bench, own_domain_id):
    """With real agents and the other process, and as few samples as possible."""
    command = [sys.executable, "-c", SMALLEST, str(own_domain_id)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=BENCH)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert set(bench("middleware").GOALS) <= set(figures)
    for what, turns in figures.items():
        assert {name: len(values) for name, values in turns.items()} == {"dds": 1, "rtps": 1}, what
