"""Tests of a node on a virtual board with a modem or a radio, on both engines."""

import textwrap

import pytest
from mpy.harness import INSTALLED
from support.agent import RunningAgent

from uros.boards.virtual.engine.runner import RunningBoard, StartError

ENGINES = ("cpython", "micropython")

# The part of the program that uses the transport ``TRANSPORT``.
PROGRAM = """
from std_msgs.msg import Int32
from uros.client import AGENT_CONNECTED, Node

def start():
    global node, numbers, count, last_reason
    count = 0
    last_reason = ""
    node = Node("node", TRANSPORT, key=7, ping_ms=100, silence_ms=1000, wait_ms=50, limit=65536)
    numbers = node.create_publisher(Int32, "numbers", 10)
    node.create_subscription(Int32, "numbers", heard, 100)
    node.create_timer(0.02, publish)
    node.on_state = state

def state(code):
    if code == AGENT_CONNECTED:
        print("connected")

def publish():
    global count
    if node.state == AGENT_CONNECTED:
        count += 1
        numbers.publish(Int32(data=count))

def heard(message):
    print("heard", message.data)

def step():
    global last_reason
    node.spin_once(0.05)
    reason = node.connection.reason
    if reason != last_reason:
        last_reason = reason
        print("reason:", reason)

def main():
    start()
    while True:
        step()

if __name__ == "__main__":
    main()
"""
TRANSPORTS = {
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


def program(folder, kind, port, password="secret99"):
    folder.mkdir()
    text = textwrap.dedent(TRANSPORTS[kind][1]) + PROGRAM
    (folder / "main.py").write_text(f"PORT = {port}\nPASSWORD = {password!r}\n" + text)
    return folder


def server(kind):
    if kind == "wlan_tcp":
        from uros.agent.transports.tcp import TcpServer

        return TcpServer(0, "127.0.0.1")
    from uros.agent.transports.udp import UdpServer

    return UdpServer(0, "127.0.0.1")


@pytest.fixture
def agent(kind):
    running_agent = RunningAgent(server(kind), "memory", 0, 4)
    running_agent.start()
    yield running_agent
    running_agent.close()
    assert running_agent.error is None


@pytest.mark.parametrize(
    ("kind", "engine"),
    [
        ("wlan", "micropython"),
        *(
            pytest.param(kind, engine, marks=pytest.mark.slow)
            for kind, engine in (
                *((kind, "micropython") for kind in TRANSPORTS if kind != "wlan"),
                ("esp8266", "cpython"),
            )
        ),
    ],
)
def test_a_node_connects_publishes_and_reconnects(kind, agent, engine, tmp_path):
    folder = program(tmp_path / "program", kind, agent.transport.port)
    with RunningBoard(folder, "ra6m5_sensor_node", engine, plugs=[TRANSPORTS[kind][0]]) as board:
        board.wait("connected")
        board.wait("heard 50")
        name = kind.partition("_")[0]
        board.happen(f"{name}:lost")
        board.wait("reason: ")
        board.happen(f"{name}:off")
        board.wait("connected")
        board.wait("heard")
        assert not board.ended


@pytest.mark.parametrize("kind", ["esp8266", "gs2200", "wlan"])
def test_a_wrong_password_is_told(kind, tmp_path):
    folder = program(tmp_path / "program", kind, 9, "wrong-one")
    with RunningBoard(folder, "ra6m5_sensor_node", plugs=[TRANSPORTS[kind][0]]) as board:
        while True:
            line = board.wait("cannot join robots")
            if "password" in line:
                break
        assert not board.ended


def test_a_reset_of_the_modem_and_one_of_the_board(tmp_path):
    kind = "esp8266"
    running_agent = RunningAgent(server(kind), "memory", 0, 4)
    running_agent.start()
    try:
        folder = program(tmp_path / "program", kind, running_agent.transport.port)
        with RunningBoard(folder, "ra6m5_sensor_node", plugs=[TRANSPORTS[kind][0]]) as board:
            board.wait("heard 20")
            board.happen("esp8266:reset")
            board.wait("started anew")
            board.wait("connected")
            board.wait("heard")
            board.reset()
            board.wait("connected")
            board.wait("heard 20")
    finally:
        running_agent.close()


@pytest.mark.parametrize(
    ("plug", "message"),
    [
        ("esp32:uart=1", "there is no plug"), ("esp8266", "say which"),
        ("esp8266:uart=x", "no number"), ("gs2200:spi=1", "say which"),
        ("wlan:colour=red", "no option colour"),
    ],
)  # fmt: skip
def test_an_invalid_plug_is_refused(plug, message, tmp_path):
    folder = program(tmp_path / "program", "wlan", 9)
    with pytest.raises(StartError, match=message):
        RunningBoard(folder, "ra6m5_sensor_node", plugs=[plug]).start()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_board_without_plugs_has_no_uart_spi_or_network(engine, tmp_path):
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

            for call in (lambda: UART(1), lambda: SPI(1), network, socket):
                try:
                    call()
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
        "no: UART(1) doesn't exist: this virtual board has its own USB, which"
        " uros.drivers.port.open_port() opens; --plug esp8266:uart=1 adds a Wi-Fi modem on UART(1)",
        "no: SPI(1) doesn't exist: this virtual board has no SPI bus; --plug"
        " gs2200:spi=1,ready=PIN,cs=PIN adds a Wi-Fi modem on SPI(1)",
        "no: no module named 'network': this virtual board has no radio; --plug wlan adds one",
        "no: no module named 'socket': this virtual board has no radio; --plug wlan adds one",
        "done",
    ]  # fmt: skip
