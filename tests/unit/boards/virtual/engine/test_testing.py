"""A board with an agent and a node of a test's own: on a line, by Wi-Fi, and when it fails."""

import pytest
from uros.interfaces.std_msgs.msg import Int32

from uros.boards.virtual.engine.runner import StartError
from uros.boards.virtual.engine.testing import board_with_agent

WIFI = """
import secrets
from std_msgs.msg import Int32
from uros.client import Node
from uros.transport.udp import UdpTransport
from uros.transport.wlan import Over, Station

network = Station(secrets.WIFI_SSID, secrets.WIFI_PASSWORD)
node = Node("board", Over(network, UdpTransport("10.16.1.2")))
publisher = node.create_publisher(Int32, "count", 10)
reasons = set()

def tick():
    publisher.publish(Int32(data=7))
    if node.connection.reason not in reasons:
        reasons.add(node.connection.reason)
        print("reason:", node.connection.reason)

node.create_timer(0.1, tick)
node.spin()
"""
PASSWORD = "secret99"  # of the access point of virtual boards


@pytest.fixture
def program(tmp_path):
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text(WIFI)
    (folder / "secrets.py").write_text(f"WIFI_SSID = 'robots'\nWIFI_PASSWORD = {PASSWORD!r}\n")
    return folder


def test_a_board_joins_its_network_with_its_secrets_which_nobody_prints(program):
    with board_with_agent(program, "esp32_wifi_publisher") as (board, node):
        counts = []
        node.create_subscription(Int32, "/count", counts.append, 10)
        node.spin_until(lambda: counts, "a count")
        lines = [board.wait("reason: [Errno 115] joining robots"), node.agent_log()]
    while not board.console.empty():
        lines.append(board.console.get())
    assert "client_key" in lines[1] and not any(PASSWORD in line for line in lines)


def test_a_wrong_password_is_reported_without_it(program):
    (program / "secrets.py").write_text("WIFI_SSID = 'robots'\nWIFI_PASSWORD = 'wrong-one'\n")
    with board_with_agent(program, "esp32_wifi_publisher") as (board, _):
        assert "wrong-one" not in board.wait("the password is wrong")


def test_what_is_waited_for_in_vain_is_reported_with_the_agents_log(program):
    (program / "main.py").write_text("print('idle')\n")
    (program / "secrets.py").unlink()
    with board_with_agent(program, "esp32_publisher") as (board, node):
        board.wait("idle")
        with pytest.raises(
            TimeoutError, match="waited 0 s for a miracle; the agent said:\n.*SerialAgent"
        ):
            node.spin_until(lambda: False, "a miracle", 0)


def test_a_program_that_cannot_be_built_ends_the_agent_too(program):
    (program / "main.py").write_text("import numpyy\n")
    with pytest.raises(StartError, match="no module numpyy"):
        with board_with_agent(program, "esp32_wifi_publisher"):
            pass
