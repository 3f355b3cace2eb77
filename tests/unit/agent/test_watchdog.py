"""A data plane that hangs is logged with the place and the remedy; one that sleeps is not."""

import os
import signal
import sys
import threading
from types import SimpleNamespace

import pytest
from support.lines import SECONDS
from unit.agent.test_server import running
from unit.agent.transports.faults import wait_for
from unit.agent.transports.test_process import agent as process

from uros.agent.clock import Clock
from uros.agent.watchdog import Watchdog, standing
from uros.middleware.memory import MemoryWriter

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


class Log:
    def __init__(self):
        self.lines = []
        self.closed = False

    def warning(self, part, function, event, about):
        self.lines.append(f"{event}: {about}")

    error = warning

    def close(self):
        self.closed = True


class Bench:
    """A watchdog without a thread, whose time the test sets."""

    def __init__(self):
        self.server = SimpleNamespace(
            turns=0, asleep=False, thread=threading.get_ident(), stopping=False, clock=Clock()
        )
        self.log = Log()
        self.exit_codes = []
        self.dog = Watchdog(self.server, self.log, leave=self.exit_codes.append)
        self.dog._seen = self.dog._since = 100.0
        self.now = 100.0

    def passes(self, seconds, turns=0, asleep=False):
        """Let time pass, with two checks a second; return the lines logged meanwhile."""
        self.log.lines.clear()
        self.server.asleep = asleep
        for _ in range(int(seconds * 2)):
            self.now += 0.5
            self.server.turns += turns
            self.dog.check(self.now)
        return self.log.lines


@pytest.fixture
def bench():
    return Bench()


def test_a_data_plane_that_works_or_sleeps_does_not_hang(bench):
    assert bench.passes(10, turns=1) == []
    assert bench.passes(1000, asleep=True) == []
    assert bench.passes(1.5) == []
    assert bench.passes(10, turns=7) == []


def test_a_hang_is_logged_once_with_its_place_and_its_end(bench):
    bench.passes(1, turns=1)
    (line,) = bench.passes(20)
    assert line.startswith("the data plane hangs: since 2.0 s in ")
    assert "in check (agent/watchdog.py:" in line and "please report it" in line
    (line,) = bench.passes(1, turns=1)
    assert line == "the data plane goes on: it hung for 20.5 s"
    (line,) = bench.passes(3)
    assert "hangs" in line


def test_a_data_plane_that_sleeps_after_a_hang_goes_on(bench):
    bench.passes(1, turns=1)
    bench.passes(3)
    assert "goes on" in bench.passes(1, asleep=True)[0]


def test_a_process_that_was_stopped_is_logged_afterwards_and_is_no_hang(bench):
    bench.passes(1, turns=1)
    bench.now += 3600
    (line,) = bench.passes(1)
    assert line.startswith("the process stood still: for 3600.5 s") and "suspended" in line


def test_a_shutdown_that_hangs_is_forced(bench):
    bench.passes(1, turns=1)
    bench.server.stopping = True
    assert bench.passes(8)[0].startswith("the data plane hangs")
    assert not bench.exit_codes
    assert "ended by force" in bench.passes(3)[-1]
    assert bench.exit_codes[0] == 1 and bench.log.closed


def test_a_long_shutdown_that_makes_progress_is_not_forced(bench):
    bench.server.stopping = True
    assert bench.passes(60, turns=1) == [] and not bench.exit_codes


@pytest.mark.parametrize(
    ("file", "remedy"),
    [
        ("uros/middleware/dds/endpoints.py", "restart the agent"),
        ("uros/middleware/ros2/rcl.py", "-m dds"),
        ("uros/agent/transports/serial.py", "unplug it"),
        ("uros/agent/objects/ros_graph.py", "please report it"),
    ],
)
def test_the_place_is_the_innermost_frame_of_uros_and_the_remedy_is_that_of_its_package(
    file, remedy
):
    frames = []
    inner = compile("def poll(): frames.append(sys._getframe())\npoll()", "/usr/lib/x.py", "exec")
    outer = compile("def write(): exec(inner, there)\nwrite()", f"/opt/{file}", "exec")
    exec(outer, {"inner": inner, "there": {"frames": frames, "sys": sys}})
    where, advice = standing(frames[0])
    assert remedy in advice
    assert where.startswith("poll (x.py:1)") and f"write ({file[5:]}:1)" in where


def test_a_thread_that_has_ended():
    assert standing(None)[0] == "a thread that has ended"


def test_a_middleware_that_hangs_in_a_real_agent(monkeypatch):
    """All clients are served when the call returns."""
    hang, hanging = threading.Event(), threading.Event()
    write = MemoryWriter.write

    def stuck(self, cdr):
        if "stuck" in self._key[1]:
            hanging.set()
            hang.wait(SECONDS)
        return write(self, cdr)

    monkeypatch.setattr(MemoryWriter, "write", stuck)
    with running() as agent_run:
        dog = Watchdog(agent_run.server, agent_run.agent.log, hang=0.1, interval=0.02)
        dog.start()
        try:
            bad, good = agent_run.client(1), agent_run.client(2)
            writer = bad.writer("a", "rt/stuck", TYPE)
            bad._put(ids_of(writer)[0], ids_of(writer)[1], 0x80, 1)
            assert hanging.wait(SECONDS)
            wait_for(agent_run.said.getvalue, "the data plane hangs")
            assert "wait (threading.py:" in agent_run.said.getvalue()
            assert "write (agent/objects/endpoints.py:" in agent_run.said.getvalue()
            hang.set()
            wait_for(agent_run.said.getvalue, "the data plane goes on")
            assert good.ping() == 1
        finally:
            hang.set()
            dog.stop()
            dog.stop()
        assert not dog._thread.is_alive()


def ids_of(writer):
    from uros.wire import ids

    return ids.WRITE_DATA, b"\0\1" + writer.to_bytes(2, "big") + b"sample"


def test_a_stopped_process_logs_the_stop_when_it_goes_on():
    with process("udp4", "--port", "0", "-m", "memory") as agent:
        agent.until("port: (\\d+)")
        os.kill(agent.popen.pid, signal.SIGSTOP)
        try:
            os.waitid(os.P_PID, agent.popen.pid, os.WSTOPPED)
            # Only time shows how long another process has been stopped.
            threading.Event().wait(2.7)
        finally:
            os.kill(agent.popen.pid, signal.SIGCONT)
        agent.until("the process stood still")
        assert agent.end() == 0
