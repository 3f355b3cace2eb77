"""What the table of uros board run says of a board's agent, from the first to the last."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.signals import default_signals

from uros.tools.agent import running_agents
from uros.tools.board.connections import Connections
from uros.tools.errors import ToolError


class Terminal:
    """A command in a terminal of its own, and all that it has drawn there."""

    def __init__(self, *arguments):
        self.pid, self.fd = pty.fork()
        if not self.pid:
            os.environ.update(TERM="xterm", COLUMNS="120", LINES="30")
            os.execv(sys.executable, [sys.executable, "-m", "uros", *arguments])
        self.drawn = ""

    def until(self, pattern, seconds=30):
        """Read on until the pattern appears in what comes from now on; return its match."""
        self.drawn = ""
        end = time.monotonic() + seconds
        while not (found := re.search(pattern, self.drawn)):
            assert time.monotonic() < end, f"no {pattern!r} in {self.drawn[-3000:]}"
            self.drawn += os.read(self.fd, 65536).decode("utf-8", "replace")
        return found

    def close(self):
        os.kill(self.pid, signal.SIGTERM)
        try:
            while os.read(self.fd, 65536):
                pass
        except OSError:
            pass  # the end
        os.waitpid(self.pid, 0)
        os.close(self.fd)


@pytest.mark.skipif(sys.platform != "linux", reason="not on this platform: only Linux tells")
def test_the_table_tells_whether_an_agent_has_the_board():
    board = Terminal("board", "run", "esp32_publisher", "--no-agent")
    try:
        hint = board.until(r"start an agent: uros (agent serial --dev (\S+)[^\x1b]*)")
        command, line = hint[1], hint[2]
        board.until(r"esp32_publisher +runs +configured +no agent +- +-")
        other = os.open(line, os.O_RDWR | os.O_NOCTTY)  # it may be another maker's agent
        assert "start an agent" not in board.until(r" line is open +-[^─]*─")[0]
        os.close(other)
        board.until(r" no agent +-")
        with default_signals():
            agent = subprocess.Popen(
                [sys.executable, "-m", "uros", *command.split()],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        try:
            board.until(r"/micro_ros_pub_node\S* +[\d.]+ +[\d.]+")
        finally:
            agent.terminate()
            agent.wait()
        board.until(r" no agent +-[\s\S]*start an agent: ")
    finally:
        board.close()


def test_the_table_tells_that_the_own_agent_has_not_got_the_board_yet():
    board = Terminal("board", "run", "esp32_publisher", "--seed", "7")
    try:
        board.until(r"esp32_publisher +runs +configured +not connected +- +-")
        board.until(r"esp32_publisher +runs +configured +/micro_ros_pub_node\S* +")
    finally:
        board.close()


def snapshot(port, *addresses):
    return {
        "transports": [{"label": f"port {port}"}],
        "clients": [{"address": address} for address in addresses],
    }


def test_agents_of_other_ports_and_agents_that_do_not_answer(monkeypatch, tmp_path):
    device, link = tmp_path / "pts", tmp_path / "tty"
    device.touch()
    link.symlink_to(device)
    answers = {
        1: snapshot(8888, "127.0.0.10:4711", "[::1]:4711"),
        2: None,
        3: snapshot(9999, "127.0.0.11:4711", f"{device} (1)"),
    }

    def ask(agent, question):
        if answers[agent.pid] is None:
            raise ToolError("the agent has not answered for 5 s")
        return answers[agent.pid]

    agents = [running_agents.RunningAgent(pid, Path("/dev/null")) for pid in answers]
    monkeypatch.setattr(running_agents, "find_agents", lambda: agents)
    monkeypatch.setattr(running_agents, "find_agent", lambda pid: agents[pid - 1])
    monkeypatch.setattr(running_agents, "ask", ask)

    def found(pid, path, address):
        """The address of the client that is found, once the agents were asked."""
        connections = Connections(pid, 8888)
        try:
            end = time.monotonic() + 10
            while connections.client(link, "127.0.0.10") is None and time.monotonic() < end:
                time.sleep(0.01)
            client = connections.client(path, address)
            return client and client["address"]
        finally:
            connections.close()

    assert found(None, link, "") == f"{device} (1)"  # an agent may have the link's target open
    assert found(None, tmp_path / "other", "127.0.0.10") == "127.0.0.10:4711"
    assert found(None, tmp_path / "other", "127.0.0.11") is None  # that agent has another port
    assert found(3, tmp_path / "other", "127.0.0.11") == "127.0.0.11:4711"  # of its own agent
    assert found(None, tmp_path / "other", "") is None
