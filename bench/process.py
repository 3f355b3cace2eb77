"""The processes of a benchmark: agent, relay, counter; and the rows of its table."""

from __future__ import annotations

import os
import queue
import select
import subprocess
import sys
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
PORT = 18_888
DOMAIN = 110

LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
)


class Process:
    """A child process that prints a line when it is ready."""

    def __init__(
        self, *arguments: str, ready: str, python: Path | str = sys.executable, **variables: str
    ) -> None:
        environment = dict(os.environ, CYCLONEDDS_URI=LOOPBACK, PYTHONUNBUFFERED="1", **variables)
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
    return Process("relay.py", str(PORT), str(DOMAIN), *(["echo"] if echo else []), ready="ready")


# The design choice that the agent runs without; see without.py.
undone = ""


def agent() -> Process:
    program = ["without.py", undone] if undone else ["-m", "uros", "agent"]
    return Process(*program, "udp4", "-p", str(PORT), "--domain", str(DOMAIN), ready="running...")


def settled(counter: Process) -> int:
    """The number of samples, after no more arrive."""
    total = counter.ask()
    while True:
        select.select([], [], [], 0.3)
        more = counter.ask()
        if not more:
            return total
        total += more


def wait_matched(counter: Process, send) -> None:  # type: ignore[no-untyped-def]
    """Send until the counter receives samples."""
    end = time.monotonic() + 10
    while not counter.ask():
        if time.monotonic() > end:
            raise TimeoutError("the counting reader hears nothing")
        send()
        select.select([], [], [], 0.1)
    settled(counter)


def show(what: str, relay_value: float, agent_value: float, goal: str, digits: int = 1) -> None:
    """Print a row of the table."""
    ratio = f"{agent_value / relay_value:6.2f} ×" if relay_value else ""
    known = f"{relay_value:12.1f}" if relay_value else " " * 12
    print(f"  {what:<42}{known}{agent_value:12.{digits}f}  {ratio:<9} {goal}", flush=True)
