"""uros demo: the recorded board, the agent as a process, and what comes by DDS."""

import os
import re
import select
import signal
import subprocess
import sys

import pytest

from uros.boards.recorded import load, packaged
from uros.tools import demo
from uros.tools.errors import ToolError

TOPICS = [
    ("/garden/temperature", "sensor_msgs/msg/Temperature"),
    ("/garden/humidity", "sensor_msgs/msg/RelativeHumidity"),
]


def run(domain, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "uros", "demo", "--domain", str(domain), *arguments],
        capture_output=True, text=True, timeout=50, env=dict(os.environ, COLUMNS="200"),
    )  # fmt: skip


def test_every_topic_is_heard_and_the_end_is_in_time(own_domain_id):
    done = run(own_domain_id, "--seconds", "4")
    assert done.returncode == 0, done.stdout + done.stderr
    for what in ("datawriter created", "What arrives by DDS", "Every topic was heard."):
        assert what in done.stdout
    for name, type_name in TOPICS:
        row = rf"{name} +([1-9]\d*) +\d+\.\d Hz +\w+: [0-9.]+, variance: [0-9.]+ +{type_name}"
        assert re.search(row, done.stdout.split("Summary:")[1])


def test_the_topics_are_those_of_the_recording():
    assert demo.recorded_topics(load(packaged(demo.RECORDING))) == TOPICS


def test_a_topic_that_was_not_heard_is_named_and_fails(capsys):
    heard = demo._Topic(*TOPICS[0])
    heard.count = 1
    assert demo._summary([heard], True) == 0
    assert demo._summary([heard, demo._Topic(*TOPICS[1])], True) == 1
    assert "Not heard: /garden/humidity" in capsys.readouterr().err


def test_an_agent_that_does_not_start_is_an_error(monkeypatch, capsys):
    monkeypatch.setattr(demo, "_START_SECONDS", 5.0)
    with pytest.raises(ToolError, match="did not start"):
        demo._Agent(999)  # refused by the agent's command line
    assert "is not a ROS domain" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--seconds", "0"], ["--seconds", "x"], ["--domain", "233"]])
def test_bad_options(arguments):
    done = run(1, *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("usage:")


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_the_agent_ends_with_the_demo_however_it_ends(own_domain_id, number):
    demo_process = subprocess.Popen(
        [sys.executable, "-m", "uros", "demo", "--domain", str(own_domain_id)],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert demo_process.stdout is not None
    while "running..." not in demo_process.stdout.readline():
        pass
    children = f"/proc/{demo_process.pid}/task/{demo_process.pid}/children"
    with open(children) as file:
        child = os.pidfd_open(int(file.read().split()[0]))
    demo_process.send_signal(number)
    demo_process.wait(20)
    demo_process.stdout.close()
    assert select.select([child], [], [], 20)[0], "the agent lives on"
    os.close(child)
