"""``uros pid``: the document's conversation with the verb itself, its page and its terminal."""

import argparse
import http.client
import json
import queue
import re
import signal
import socket
import subprocess
import sys
import threading

import pytest
from support.lines import SECONDS
from support.signals import default_signals

from uros.tools.errors import ToolError
from uros.tools.rover import pid as pid_view

DOCUMENT = "200,30,5,200,30,5,1.0,0"


class Pid:
    """The command, as a process; and its page's and the rover's port, as it says them."""

    def __init__(self):
        with default_signals():
            self.process = subprocess.Popen(
                [sys.executable, "-m", "uros", "pid", "--no-open", "--port", "0",
                 "--page-port", "0", "--host", "127.0.0.1"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            )  # fmt: skip
        self._lines = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.page = int(re.search(r":(\d+)/", self.wait("shown at http://127.0.0.1:")).group(1))
        self.port = int(re.search(r"port (\d+)", self.wait("waiting for the rover")).group(1))

    def _read(self):
        for line in self.process.stdout:
            self._lines.put(line.rstrip())

    def wait(self, text):
        """The next line with this text in it."""
        while text not in (line := self._lines.get(timeout=SECONDS)):
            pass
        return line

    def ask(self, path, body=None):
        page = http.client.HTTPConnection("127.0.0.1", self.page, timeout=SECONDS)
        try:
            kind = {"Content-Type": "application/json"} if body else {}
            page.request("POST" if body else "GET", path, body and json.dumps(body), kind)
            answer = page.getresponse()
            return answer.status, json.loads(answer.read())
        finally:
            page.close()

    def type(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()


@pytest.fixture(scope="module")
def pid():
    made = Pid()
    yield made
    made.process.send_signal(signal.SIGINT)
    assert made.process.wait(SECONDS) == 0
    made.process.stdin.close()
    made.process.stdout.close()


@pytest.fixture
def rover(pid):
    with socket.create_connection(("127.0.0.1", pid.port)) as one:
        one.settimeout(SECONDS)
        pid.wait("connected: 127.0.0.1")
        yield one


def test_the_exchange_of_the_document(pid, rover):
    """A rover that ends no lines, and a person who types in the terminal."""
    rover.sendall(b"113,-87")
    version = -1
    while True:
        status, state = pid.ask(f"/state?version={version}")
        assert status == 200
        version = state["version"]
        if state["samples"]:
            break
    assert state["samples"] == [[113, -87]] and state["rover"] == "127.0.0.1"
    pid.type(DOCUMENT)
    assert rover.recv(100) == b"200,30,5,200,30,5,1,0\n"
    assert pid.wait("sent ") == "sent 200,30,5,200,30,5,1,0"


def test_invalid_input_is_reported_and_not_sent(pid, rover):
    pid.type("")
    pid.type("1,2,3")
    assert pid.wait("not sent") == (
        "not sent: 3 values instead of 8: R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot"
    )
    pid.type(DOCUMENT)
    assert rover.recv(100).startswith(b"200,")


def test_gains_of_the_page(pid, rover):
    assert pid.ask("/gains", {"line": DOCUMENT}) == (200, {"sent": "200,30,5,200,30,5,1,0"})
    assert rover.recv(100) == b"200,30,5,200,30,5,1,0\n"
    status, answer = pid.ask("/gains", {"line": "200,30,5,200,30,5,nan,0"})
    assert (status, answer["error"]) == (409, "speed is nan, which is no number")
    for wrong in ([1], {"line": 5}, {"other": ""}):
        assert pid.ask("/gains", wrong)[0] == 400


def test_invalid_lines_of_the_rover_are_printed(pid, rover):
    rover.sendall(b"\x1b[31mhello\n# flat battery\n1,2\n")
    assert "[31mhello is no whole number" in pid.wait("left out what the rover sent")
    assert pid.wait("the rover says") == "the rover says: flat battery"


def test_no_rover_is_connected(pid):
    while (state := pid.ask("/state"))[1]["rover"]:
        pid.ask(f"/state?version={state[1]['version']}")
    status, answer = pid.ask("/gains", {"line": DOCUMENT})
    assert status == 409 and "no rover is connected" in answer["error"]


def options(*arguments):
    parser = argparse.ArgumentParser()
    pid_view.add_arguments(parser)
    return parser.parse_args([*arguments])


def test_the_rover_may_be_remote_and_the_page_is_local():
    assert (options().host, options().port) == ("0.0.0.0", pid_view.PORT)
    assert (options().page_host, options().page_port) == ("127.0.0.1", pid_view.PAGE_PORT)


@pytest.mark.parametrize("option", ["--port", "--page-port"])
def test_a_port_in_use(option):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ports = {"--port": "0", "--page-port": "0", option: str(taken.getsockname()[1])}
        words = [word for pair in ports.items() for word in pair]
        with pytest.raises(ToolError, match=f"in use, .* give another port with {option}"):
            pid_view.run(options("--no-open", "--host", "127.0.0.1", *words))
