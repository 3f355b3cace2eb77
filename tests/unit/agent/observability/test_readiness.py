"""Whether an agent can serve boards: over HTTP, in the status, by an exit status."""

import datetime
import json
import os
import subprocess
import sys
import threading
import urllib.error
from pathlib import Path

import pytest
from support.certificates import Authority
from support.lines import SECONDS
from support.waiting import eventually
from unit.agent.observability.test_prometheus import board, get, measured, status
from unit.agent.transports.test_process import agent as process

from uros.agent.observability import prometheus
from uros.agent.observability.readiness import readiness
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.discovery import DiscoveryServer
from uros.agent.transports.memory import MemoryServer
from uros.agent.transports.tls import TlsServer


def judged(running):
    """Ask /readyz; return the HTTP status and the answer."""
    try:
        text, kind = get(running, "/readyz")
        code = 200
    except urllib.error.HTTPError as error:
        with error:
            code, text, kind = error.code, error.read(), error.headers["Content-Type"]
    assert kind == "application/json"
    return code, json.loads(text)


def test_a_healthy_agent():
    with measured() as running:
        assert get(running, "/healthz")[0] == "ok\n"
        assert judged(running) == (200, {"ready": True, "problems": []})


def test_an_agent_that_waits_for_its_only_device_is_not_ready_but_healthy():
    with measured("serial") as running:
        assert judged(running)[0] == 200
        line = running.transport.line
        stream = line.stream
        line.stream = None
        label = running.transport.label()
        assert judged(running) == (
            503, {"ready": False, "problems": [f"{label}: the agent waits for it"]}
        )  # fmt: skip
        assert get(running, "/healthz")[0] == "ok\n"
        line.stream = stream


def test_an_agent_with_a_second_transport_is_ready_with_a_problem():
    with measured() as running:
        waiting = MemoryServer()
        waiting.is_waiting, waiting.label = lambda: True, lambda: "/dev/x"
        transports = running.server.transports
        running.server.transports = [*transports, waiting]
        answer = judged(running)
        running.server.transports = transports
        assert answer == (200, {"ready": True, "problems": ["/dev/x: the agent waits for it"]})


def test_an_agent_that_waits_and_only_answers_questions_for_agents_is_not_ready():
    with measured("serial") as running:
        running.server.transports.append(DiscoveryServer([]))
        stream, running.transport.line.stream = running.transport.line.stream, None
        assert judged(running)[0] == 503
        running.transport.line.stream = stream
        assert judged(running)[0] == 200
        running.server.transports.pop()


def test_files_of_tls_that_have_ended_let_no_board_connect(tmp_path):
    ca = Authority(tmp_path / "current")
    yesterday = datetime.datetime.now(datetime.timezone.utc) - datetime.timedelta(1)
    old = Certificates(*Authority(tmp_path / "old").agent(not_after=yesterday))
    ended = Certificates(*ca.agent(), ca.ca, ca.revoke(days=-1))
    for files, said in (
        (old, f"--tls-cert {old.cert} expired on {yesterday:%Y-%m-%d}: make a new one"),
        (ended, f"--tls-crl {ended.crl}: a revocation list ended on"),
    ):
        with measured(TlsServer(0, "127.0.0.1", files)) as running:
            code, answer = judged(running)
            (problem,) = answer["problems"]
            assert (code, answer["ready"]) == (503, False)
            assert problem.startswith(f"{running.transport.label()}: {said}")
            running.server.transports.append(MemoryServer())
            assert judged(running)[1] == {"ready": True, "problems": [problem]}
            running.server.transports.pop()


def test_new_files_of_tls_that_are_refused_are_a_problem_until_they_are_mended(tmp_path):
    ca = Authority(tmp_path)
    cert, key = ca.agent()
    good = Path(cert).read_text()
    with measured(TlsServer(0, "127.0.0.1", Certificates(cert, key, ca.ca))) as running:

        def reloaded():
            running.server.soon(running.transport.reload)
            return judged(running)[1]

        for content in ("a slip of the editor", Path(ca.ca).read_text(), None):
            os.unlink(cert)
            if content is not None:
                Path(cert).write_text(content)
            answer = reloaded()
            (problem,) = answer["problems"]
            said = ": new files are refused, and a restart would fail: --tls-"
            assert answer["ready"] and said in problem and cert in problem
            Path(cert).write_text(good)
            assert judged(running)[1]["problems"] == [problem]  # not read yet
        assert reloaded() == {"ready": True, "problems": []}


def test_used_up_memory_and_a_failing_middleware_are_not_ready_and_full_places_are_named():
    with measured() as running:
        board(running)
        running.agent.admission.max_clients = 1
        code, answer = judged(running)
        assert code == 200
        assert answer["problems"] == ["no places left for boards (see --max-clients)"]
        running.agent.budget.full = True
        assert judged(running)[1]["ready"] is False
        running.agent.budget.full = False
        running.server._failures = 11
        assert judged(running)[1]["ready"] is False
        running.server._failures = 0
        running.server.troubles.append(lambda: "the disk is full")
        assert judged(running)[1]["problems"][-1] == "the disk is full"


def test_an_agent_that_hangs_is_neither_healthy_nor_ready(monkeypatch):
    monkeypatch.setattr(prometheus, "PATIENCE", 0.1)
    with measured() as running:
        go_on = threading.Event()
        running.server.soon(lambda: go_on.wait(SECONDS))
        for path in ("/healthz", "/readyz"):
            code, text = status(running, path)
            assert code == 503 and "the agent is busy" in text
        go_on.set()
        monkeypatch.setattr(prometheus, "PATIENCE", SECONDS)
        assert get(running, "/healthz")[0] == "ok\n"


def test_each_transport_tells_whether_it_waits():
    with measured() as running:
        assert not running.transport.is_waiting()
        assert readiness(running.server).ready
    with measured("custom") as running:
        eventually(lambda: not running.transport.is_waiting())
    with measured("can") as running:
        eventually(lambda: not running.transport.is_waiting())
        waits = []

        def drop():  # in the thread of the transport's sockets
            running.transport._drop_bus()
            waits.append(running.transport.is_waiting())

        running.server.soon(drop)
        eventually(lambda: waits)
        assert waits == [True]


# --- the command ------------------------------------------------------------------------------


def check(*more):
    return subprocess.run(
        [sys.executable, "-m", "uros", "agent", "status", "--check", *map(str, more)],
        capture_output=True, text=True, env=os.environ,
    )  # fmt: skip


def test_the_exit_status_of_the_command_says_whether_the_agent_is_ready(tmp_path):
    with process("serial", "-D", tmp_path / "none", "-m", "memory") as one:
        one.until("status socket open")
        pid = one.popen.pid
        done = check("--agent", pid)
        assert done.returncode == 1
        assert done.stdout == (
            f"agent {pid}: not ready; boards: 0; {tmp_path}/none: the agent waits for it\n"
        )
        assert json.loads(check("--agent", pid, "--json").stdout)["ready"] is False
        assert one.end() == 0
    assert check("--agent", pid).returncode == 1
    with process("udp4", "-p", 0, "-m", "memory") as one:
        one.until("status socket open")
        done = check("--agent", one.popen.pid)
        assert (done.returncode, done.stdout) == (0, f"agent {one.popen.pid}: ready; boards: 0\n")
        assert one.end() == 0


@pytest.mark.parametrize("problem", ["\x1b[2J", "a\nagent 1: ready"])
def test_problems_are_escaped(problem):
    from uros.tools.agent.status import page

    with measured() as running:
        running.server.troubles.append(lambda: problem)
        text = page(running.snapshot(), width=10_000)[-1]
    assert text.startswith("problem: ") and text.isprintable()
