"""A whole node on a virtual board with a modem or a radio, on both engines, and an agent by UDP."""

import textwrap

import pytest
from mpy.harness import INSTALLED
from support.agent import RunningAgent

from uros.boards.virtual.engine.runner import RunningBoard, StartError

ENGINES = ("cpython", "micropython")

# What a program does with its transport, after it has made one.
PROGRAM = """
from std_msgs.msg import Int32
from uros.client import AGENT_CONNECTED, Node

def start():
    global node, numbers, count, told
    count = 0
    told = ""
    node = Node("node", TRANSPORT, key=7, ping_ms=100, silence_ms=1000, wait_ms=50, limit=65536)
    numbers = node.create_publisher(Int32, "numbers", 10)
    node.create_subscription(Int32, "numbers", heard, 100)
    node.create_timer(0.02, publish)
    node.on_state = state

def state(it):
    if it == AGENT_CONNECTED:
        print("connected")

def publish():
    global count
    if node.state == AGENT_CONNECTED:
        count += 1
        numbers.publish(Int32(data=count))

def heard(it):
    print("heard", it.data)

def step():
    global told
    node.spin_once(0.05)
    reason = node.connection.reason
    if reason != told:
        told = reason
        print("reason:", reason)

def main():
    start()
    while True:
        step()

if __name__ == "__main__":
    main()
"""
WAYS = {
    "esp8266": (
        "esp8266:uart=1",
        """
        from machine import UART
        from uros.transport.esp8266 import Esp8266Transport

        uart = UART(1, 115200, rxbuf=4096)
        TRANSPORT = Esp8266Transport(uart, "robots", PASSWORD, "127.0.0.1", PORT)
        """,
    ),
    "gs2200": (
        "gs2200:spi=1,ready=P115,cs=P301",
        """
        from machine import SPI, Pin
        from uros.transport.gs2200 import Gs2200Transport

        spi = SPI(1, 4000000, polarity=0, phase=1)
        ready, cs = Pin("P115", Pin.IN), Pin("P301", Pin.OUT, value=1)
        TRANSPORT = Gs2200Transport(spi, ready, "robots", PASSWORD, "127.0.0.1", PORT, cs=cs)
        """,
    ),
    "wlan": (
        "wlan",
        """
        from uros.transport.udp import UdpTransport
        from uros.transport.wlan import Over, Station

        TRANSPORT = Over(Station("robots", PASSWORD), UdpTransport("127.0.0.1", PORT))
        """,
    ),
    "wlan_tcp": (
        "wlan",
        """
        from uros.transport.tcp import TcpTransport
        from uros.transport.wlan import Over, Station

        TRANSPORT = Over(Station("robots", PASSWORD), TcpTransport("127.0.0.1", PORT))
        """,
    ),
}


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))


def program(folder, way, port, password="secret99"):
    folder.mkdir()
    text = textwrap.dedent(WAYS[way][1]) + PROGRAM
    (folder / "main.py").write_text(f"PORT = {port}\nPASSWORD = {password!r}\n" + text)
    return folder


def server(way):
    if way == "wlan_tcp":
        from uros.agent.transports.tcp import TcpServer

        return TcpServer(0, "127.0.0.1")
    from uros.agent.transports.udp import UdpServer

    return UdpServer(0, "127.0.0.1")


@pytest.fixture
def agent(way):
    running = RunningAgent(server(way), "memory", 0, 4)
    running.start()
    yield running
    running.close()
    assert running.error is None


@pytest.mark.parametrize(
    ("way", "engine"), [*((way, "micropython") for way in WAYS), ("esp8266", "cpython")]
)
def test_a_node_finds_its_agent_talks_and_comes_back(way, agent, engine, tmp_path):
    folder = program(tmp_path / "program", way, agent.transport.port)
    with RunningBoard(folder, "ra6m5_sensor_node", engine, plugs=[WAYS[way][0]]) as board:
        board.wait("connected")
        board.wait("heard 50")
        name = way.partition("_")[0]
        board.happen(f"{name}:lost")
        board.wait("reason: ")
        board.happen(f"{name}:off")
        board.wait("connected")
        board.wait("heard")
        assert not board.ended


@pytest.mark.parametrize("way", ["esp8266", "gs2200", "wlan"])
def test_a_wrong_password_is_told(way, tmp_path):
    folder = program(tmp_path / "program", way, 9, "wrong-one")
    with RunningBoard(folder, "ra6m5_sensor_node", plugs=[WAYS[way][0]]) as board:
        while True:
            line = board.wait("cannot join robots")
            if "password" in line:
                break
        assert not board.ended


def test_a_reset_of_the_modem_and_one_of_the_board(tmp_path):
    way = "esp8266"
    running = RunningAgent(server(way), "memory", 0, 4)
    running.start()
    try:
        folder = program(tmp_path / "program", way, running.transport.port)
        with RunningBoard(folder, "ra6m5_sensor_node", plugs=[WAYS[way][0]]) as board:
            board.wait("heard 20")
            board.happen("esp8266:reset")
            board.wait("started anew")
            board.wait("connected")
            board.wait("heard")
            board.reset()
            board.wait("connected")
            board.wait("heard 20")
    finally:
        running.close()


@pytest.mark.parametrize(
    ("plug", "said"),
    [
        ("esp32:uart=1", "there is no plug"), ("esp8266", "say which"),
        ("esp8266:uart=x", "no number"), ("gs2200:spi=1", "say which"),
        ("wlan:colour=red", "no option colour"),
    ],
)  # fmt: skip
def test_what_cannot_be_plugged_in(plug, said, tmp_path):
    folder = program(tmp_path / "program", "wlan", 9)
    with pytest.raises(StartError, match=said):
        RunningBoard(folder, "ra6m5_sensor_node", plugs=[plug]).start()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_board_without_plugs_has_none_of_it(engine, tmp_path):
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text(
        textwrap.dedent(
            """
            from machine import SPI, UART

            def network():
                import network

            def socket():
                import socket

            for it in (lambda: UART(1), lambda: SPI(1), network, socket):
                try:
                    it()
                except (ValueError, ImportError) as error:
                    print("no:", error)
            print("done")
            """
        )
    )
    with RunningBoard(folder, "ra6m5_sensor_node", engine) as board:
        assert board.wait_end() == ""
        lines = [board.console.get(timeout=10) for _ in range(5)]
    assert lines == [
        "no: UART(1) doesn't exist", "no: SPI(1) doesn't exist", "no: no module named 'network'",
        "no: no module named 'socket'", "done",
    ]  # fmt: skip
