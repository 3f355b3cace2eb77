"""A board's node on CPython closes its session when its program ends."""

import signal
import subprocess
import sys

import pytest
from support.agent import running_agent
from support.lines import SECONDS
from support.signals import default_signals
from support.waiting import eventually

PROGRAM = """
import uros
from uros.interfaces.std_msgs.msg import Int32
from uros.transport.udp import UdpTransport

node = uros.Node("counter", UdpTransport("127.0.0.1", {port}), key=0x5EED)
publisher = node.create_publisher(Int32, "count", 10)
node.create_timer(0.05, lambda: publisher.publish(Int32()))
while not publisher.published:
    node.spin_once(0.1)
node.create_timer(0.01, lambda: print("spins", flush=True))
{ending}
"""


@pytest.mark.parametrize(
    ("ending", "number"),
    [
        ("node.spin()", signal.SIGINT),
        ("node.spin()", signal.SIGTERM),
        pytest.param("node.spin()", signal.SIGHUP, marks=pytest.mark.slow),
        ("1 / 0", None),
    ],
)
def test_a_node_closes_its_session_however_its_program_ends(ending, number):
    with running_agent("udp", "memory") as agent:
        program = PROGRAM.format(port=agent.transport.port, ending=ending)
        with default_signals():
            process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        try:
            if number is not None:
                assert process.stdout.readline() == b"spins\n"
                process.send_signal(number)
            assert process.wait(SECONDS) == (1 if number is None else 0)
        finally:
            process.kill()
            process.communicate()
        eventually(lambda: "session closed" in agent.said.getvalue(), agent.said.getvalue)
