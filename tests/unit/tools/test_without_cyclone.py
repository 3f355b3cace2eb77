"""uros in a Python without cyclonedds, as on ARM: all by rtps, in processes of their own.

tests/support/without_cyclone hides the package from them.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from contextlib import contextmanager

import pytest
from support.paths import ROOT
from support.waiting import eventually

HIDING = ROOT / "tests" / "support" / "without_cyclone"
TALKER = """
import sys
import uros
from uros.interfaces.std_msgs.msg import Int32
from uros.interfaces.std_srvs.srv import Trigger


def answer(request, response):
    response.success = True
    response.message = "here"
    return response


node = uros.Node("talker")
publisher = node.create_publisher(Int32, "count", 10)
node.create_service(Trigger, "where", answer)
node.create_timer(0.05, lambda: publisher.publish(Int32(data=7)))
node.spin()
"""


@pytest.fixture
def environment(own_domain_id):
    return dict(os.environ, PYTHONPATH=str(HIDING), ROS_DOMAIN_ID=str(own_domain_id), COLUMNS="200")


def start(environment, *arguments):
    return subprocess.Popen(
        [sys.executable, *arguments], env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


@contextmanager
def running(environment, *arguments):
    process = start(environment, *arguments)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=20)


def uros(environment, *arguments, status=(0,)):
    """Run a command of uros; return its output."""
    done = subprocess.run(
        [sys.executable, "-m", "uros", *arguments],
        env=environment, text=True, capture_output=True, timeout=60,
    )  # fmt: skip
    assert done.returncode in status, done.stdout + done.stderr
    return done.stdout


def test_the_package_is_hidden(environment):
    done = subprocess.run(
        [sys.executable, "-c", "import cyclonedds"], env=environment, text=True, capture_output=True
    )
    assert "No module named 'cyclonedds'" in done.stderr


def test_the_tools_see_a_node_of_the_host(environment):
    with running(environment, "-c", TALKER) as node:
        eventually(lambda: "/talker" in uros(environment, "node", "list"), node.poll)
        assert "/count: std_msgs/msg/Int32" in uros(environment, "node", "info", "/talker")
        assert "Publisher count: 1" in uros(environment, "topic", "info", "/count", "-v")
        assert "/count [std_msgs/msg/Int32]" in uros(environment, "topic", "list", "-t")
        echoed = uros(environment, "topic", "echo", "/count", "--once", "-i")
        assert "data: 7" in echoed
        stamps = dict(re.findall(r"(\w+)_timestamp: (\d+)", echoed))
        assert 0 < int(stamps["source"]) <= int(stamps["received"])
        assert "/where" in uros(environment, "service", "list")
        assert "message='here'" in uros(environment, "service", "call", "/where")


def test_the_first_board_program_of_the_readme(environment, tmp_path):
    """As a reader does it: the board with its agent, and two tools."""
    text = (ROOT / "README.md").read_text("utf-8").partition("## First board program")[2]
    text = text.partition("\n## ")[0]
    (tmp_path / "main.py").write_text(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1])
    commands = [shlex.split(line) for line in re.findall(r"^uros (.*)$", text, re.MULTILINE)]
    (run,) = [command for command in commands if command[:2] == ["board", "run"]]
    echo, publish = [command for command in commands if command[0] == "topic"][:2]
    run[run.index("counter")] = str(tmp_path)
    with running(environment, "-m", "uros", *run) as board:
        lines = iter(board.stdout.readline, "")
        told = [next(line for line in lines if "RTPS in Python" in line)]
        assert "cyclonedds is not installed: topics and services use rtps" in told[0]
        assert re.search(r"data: \d+", uros(environment, *echo, "--once"))
        uros(environment, *publish)
        for line in lines:
            told.append(line)
            if re.search(r"\b7$", line):
                break
    assert sum("RTPS in Python" in line for line in told) == 1
    assert re.search(r"\b7$", told[-1]), told


def test_the_demo_receives_every_topic(environment):
    assert "Every topic was received." in uros(environment, "demo", "--seconds", "6")


def test_the_doctor_says_what_is_used(environment):
    domain = environment["ROS_DOMAIN_ID"]
    options = ("--json", "--domain", domain, "--seconds", "0.1")
    # 1: agents of others on this machine may have problems.
    told = json.loads(uros(environment, "doctor", *options, status=(0, 1)))
    (one,) = [one for one in told["findings"] if one["check"] == "engine"]
    assert one["state"] == "ok"
    assert "graph" not in {one["check"] for one in told["findings"]}, "a domain was not joined"
    assert "cyclonedds is not installed" in one["what"] and "use rtps" in one["what"]
