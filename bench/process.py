"""The processes of a benchmark, its options, and the rows of its table."""

from __future__ import annotations

import argparse
import os
import queue
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROS_PYTHON = HERE.parent / ".venv-ros" / "bin" / "python"
NO_ROS = "there is no .venv-ros: run python3 scripts/env.py ros"
DOMAIN = 110
MIDDLEWARES = ("auto", "dds", "rtps", "ros2")

LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
)


class Settings:
    """What the agents of this run are started with.

    ``undone`` is the design choice that they run without; see without.py.
    """

    domain = DOMAIN
    middleware = "auto"
    undone = ""

    @property
    def port(self) -> int:
        """The first UDP port; each domain has some of its own."""
        return 18_000 + 8 * self.domain


settings = Settings()


def options(doc: str, quick: str, **others: dict[str, Any]) -> argparse.Namespace:
    """Parse the command line of a benchmark and apply it to the settings.

    ``others`` are options besides ``--quick`` and ``--domain``: arguments of ``add_argument``.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--domain", type=int, default=DOMAIN, help="the ROS domain, and the ports")
    for name, arguments in others.items():
        parser.add_argument(f"--{name}", **arguments)
    parsed = parser.parse_args()
    settings.domain = parsed.domain
    return parsed


def one_middleware(doc: str, quick: str) -> bool:
    """Parse the command line of a benchmark of one middleware; whether it is to be quick."""
    parsed = options(doc, quick, middleware={"choices": MIDDLEWARES, "default": "auto"})
    settings.middleware = parsed.middleware
    print(f"  middleware: {settings.middleware}")
    return bool(parsed.quick)


class Process:
    """A child process that prints a line when it is ready."""

    def __init__(
        self, *arguments: str, ready: str, python: Path | str = sys.executable, **variables: str
    ) -> None:
        environment = dict(
            os.environ, CYCLONEDDS_URI=LOOPBACK, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            PYTHONUNBUFFERED="1", **variables,
        )  # fmt: skip
        self._process = subprocess.Popen(
            [str(python), *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, env=environment, cwd=HERE,
        )  # fmt: skip
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        while ready not in self.line():
            pass

    def _read(self) -> None:
        """Read all the time: a full pipe would change the figures."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def line(self) -> str:
        line = self._lines.get()
        if not line:
            raise RuntimeError(f"{self._process.args} ended with {self._process.wait()}")
        return line

    def ask(self) -> int:
        """The number of samples that a counter has counted since the last call."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return int(self.line())

    def cpu(self) -> float:
        """The CPU time of all threads so far in seconds, user and system."""
        total = 0
        for task in Path(f"/proc/{self._process.pid}/task").iterdir():
            total += int((task / "schedstat").read_text().split()[0])
        return total / 1e9

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def resident(self) -> float:
        """Resident memory in MB."""
        for line in Path(f"/proc/{self._process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
        return 0.0

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()


def relay(echo: bool) -> Process:
    arguments = (str(settings.port), str(settings.domain), *(["echo"] if echo else []))
    return Process("relay.py", *arguments, ready="ready")


def counter(*arguments: str) -> Process:
    return Process("counter.py", str(settings.domain), *arguments, ready="ready")


def echo(*topics: str) -> Process:
    return Process("echo.py", str(settings.domain), *topics, ready="ready")


def agent(middleware: str = "", number: int = 0) -> Process:
    """Start an agent; ``number`` tells those that run at the same time apart."""
    middleware = middleware or settings.middleware
    program = ["without.py", settings.undone] if settings.undone else ["-m", "uros", "agent"]
    arguments = ("udp4", "-p", str(settings.port + number), "--domain", str(settings.domain))
    return Process(
        *program, *arguments, "-m", middleware, ready="running...",
        python=ROS_PYTHON if middleware == "ros2" else sys.executable,
        PYTHONPATH=str(HERE.parent / "src"),
    )  # fmt: skip


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


def settled(counter: Process) -> int:
    """The number of samples, after no more arrive."""
    total = counter.ask()
    while True:
        select.select([], [], [], 0.3)
        more = counter.ask()
        if not more:
            return total
        total += more


def wait_matched(counter: Process, send: Callable[[], object], readers: int = 1) -> None:
    """Call ``send`` until so many samples arrive after one call, and no more come."""
    end = time.monotonic() + 60
    counted = 0
    while counted < readers:
        if time.monotonic() > end:
            raise TimeoutError(f"{counted} of {readers} readers hear something")
        counter.ask()
        send()
        select.select([], [], [], 0.1 if readers == 1 else 0.3)
        counted = counter.ask()
    settled(counter)


def middle(values: Sequence[float]) -> float:
    """The median of runs."""
    return sorted(values)[len(values) // 2]


def heading(*columns: str) -> None:
    """Print the head of the table; the ratio is that of the second column to the first."""
    print(f"  {'':<42}" + "".join(f"{name:>12}" for name in columns) + "  ratio     goal")


def show(
    what: str, values: Sequence[float | None], goal: str = "", digits: int = 1, note: str = ""
) -> None:
    """Print a row of the table; ``note`` stands behind the goal."""
    cells = "".join(" " * 12 if one is None else f"{one:12.{digits}f}" for one in values)
    ratio = f"{values[1] / values[0]:6.2f} ×" if len(values) > 1 and values[0] and values[1] else ""
    print(f"  {what:<42}{cells}  {ratio:<9} {goal:<9} {note}".rstrip(), flush=True)
