"""An agent that is started twice names the process that has its port."""

import os
import socket
import subprocess
import sys

import pytest

from uros.tools.agent import port_in_use

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="not on this platform: needs /proc"
)


def started(*arguments):
    command = [sys.executable, "-m", "uros", "agent", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(params=["udp4", "tcp4"])
def taken(request):
    kind = socket.SOCK_DGRAM if request.param == "udp4" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("0.0.0.0", 0))
        if kind == socket.SOCK_STREAM:
            sock.listen()
        yield request.param, sock.getsockname()[1]


def test_the_process_is_named_with_its_pid(taken):
    transport, port = taken
    done = started(transport, "--port", port, "-m", "memory")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"port {port} is in use by " in line and f"(pid {os.getpid()})" in line
    assert line.endswith("stop it, or choose another port with --port")


def test_a_process_of_another_user_cannot_be_seen(taken, monkeypatch):
    transport, port = taken
    monkeypatch.setattr("uros.tools.doctor.process._holders", lambda wanted, own: [])
    protocol = "UDP" if transport == "udp4" else "TCP"
    text = f"{protocol} port {port} is in use, perhaps by another agent: stop it"
    assert port_in_use.name_holder(text) == (
        f"{protocol} port {port} is in use by a process of another user"
        f" (sudo ss -lpn 'sport = :{port}'): stop it"
    )


@pytest.mark.parametrize("text", ["TCP port 80 is not permitted", ""])
def test_other_errors_stay_as_they_are(text):
    assert port_in_use.name_holder(text) == text


def test_without_proc_the_message_stays(taken, monkeypatch):
    _, port = taken
    monkeypatch.setattr(port_in_use, "can_look", lambda: False)
    text = f"UDP port {port} is in use, perhaps by another agent: stop it"
    assert port_in_use.name_holder(text) == text
