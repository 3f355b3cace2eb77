"""Tools that a signal ends leave the network at once, not when their lease is over."""

import signal
import subprocess
import sys

import pytest
from support.lines import SECONDS
from support.signals import default_signals
from support.variants import slow_except

from uros.host.network import Network

# Each with its node and its exit status, to which the number of the signal is added.
COMMANDS = {
    "topic echo": (("topic", "echo", "/numbers", "std_msgs/msg/Int32", "-n", "ears"), "/ears", 128),
    "run": (("run", "listener"), "/listener", None),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("number", slow_except([signal.SIGTERM, signal.SIGHUP], signal.SIGTERM))
def test_a_tool_that_a_signal_ends_leaves_the_network(monkeypatch, own_domain_id, command, number):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain_id))
    arguments, node, status = COMMANDS[command]
    with Network(own_domain_id) as network:
        with default_signals():
            process = subprocess.Popen(
                [sys.executable, "-m", "uros", *arguments],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
        try:
            assert network.spin(lambda: node in network.graph.nodes(), 20)
            process.send_signal(number)
            _, errors = process.communicate(timeout=SECONDS)
            assert errors == ""
            assert process.returncode == (0 if status is None else status + number)
            # Without a farewell its lease ends after ten seconds at the earliest.
            assert network.spin(lambda: node not in network.graph.nodes(), 5)
        finally:
            process.kill()
            process.communicate()
