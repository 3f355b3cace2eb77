"""A node of uros over every transport that a board's program can use on a host."""

import os
import select
import socket
import time
import tty
from contextlib import ExitStack, contextmanager
from tempfile import TemporaryDirectory

import pytest
from support.agent import RunningAgent
from support.certificates import Authority
from support.lines import SECONDS
from support.ports import lasting_port
from uros.interfaces.std_msgs.msg import Int32, UInt8MultiArray
from uros.interfaces.std_srvs.srv import Trigger

from uros.agent.transports.base import TransportError
from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import HostRadioNetwork
from uros.client import AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT, Node
from uros.ticks import ticks_ms
from uros.transport.can import CanTransport
from uros.transport.can_host import CanPort
from uros.transport.esp8266 import Esp8266Transport
from uros.transport.gs2200 import Gs2200Transport
from uros.transport.serial import StreamTransport
from uros.transport.serial_host import DevicePort
from uros.transport.tcp import TcpTransport
from uros.transport.tls import TlsTransport
from uros.transport.udp import UdpTransport

QUICK = {"ping_ms": 20, "silence_ms": 200, "wait_ms": 20, "limit": 300_000}


class AgentSetup:
    """An agent that is stopped and started, and nodes that stay."""

    def __init__(self, kind):
        self.kind = kind
        self.agent = None
        self.port = 0
        self.nodes = []
        self.ends = []

    def start(self):
        self.agent = RunningAgent(self.server(), "memory", 0, 4)
        self.agent.start()

    def server(self):
        """The agent's transport, or its kind."""
        return self.kind

    def stop(self):
        agent, self.agent = self.agent, None
        agent.close()
        assert agent.error is None and not agent.thread.is_alive()
        assert "internal error" not in agent.said.getvalue(), agent.said.getvalue()


class Udp(AgentSetup):
    count = 2

    def __init__(self, kind="udp", host="127.0.0.1"):
        super().__init__(kind)
        self.listens_on = host
        self.host = host  # the address that boards use
        self.port = lasting_port(host)
        self.start()

    def server(self):
        from uros.agent.transports.udp import UdpServer

        return UdpServer(self.port, self.listens_on)

    def transport(self):
        return UdpTransport(self.host, self.port)


class Udp6(Udp):
    def __init__(self):
        super().__init__("udp6", "::1")


class Tcp(Udp):
    def __init__(self):
        super().__init__("tcp")

    def server(self):
        from uros.agent.transports.tcp import TcpServer

        return TcpServer(self.port, self.listens_on)

    def transport(self):
        return TcpTransport(self.host, self.port)


class Tls(Udp):
    """TLS with a certificate of the boards too."""

    def __init__(self):
        self.folder = TemporaryDirectory()
        self.authority = Authority(self.folder.name)
        self.board = self.authority.issue("board")
        super().__init__("tls")

    def server(self):
        from uros.agent.transports.certificates import Certificates
        from uros.agent.transports.tls import TlsServer

        files = Certificates(
            *self.authority.agent(), self.authority.ca
        )  # new certificates at each start
        return TlsServer(self.port, self.listens_on, files)

    def transport(self):
        cert, key = self.board
        return TlsTransport(self.host, self.port, ca=self.authority.ca, cert=cert, key=key)

    def close(self):
        self.folder.cleanup()


class Serial(AgentSetup):
    """Agent and board at the two ends of a pseudo-terminal."""

    count = 1

    def __init__(self):
        super().__init__("pseudoterminal")
        self.start()
        self.link = f"/tmp/uros-test-{os.getpid()}"

    def start(self):
        super().start()
        if getattr(self, "link", None):
            self.relink()

    def relink(self):
        """Point the constant name of the device to the new agent's pseudo-terminal."""
        if os.path.lexists(self.link):
            os.unlink(self.link)
        os.symlink(self.agent.transport.device, self.link)

    def transport(self):
        self.relink()
        return StreamTransport(DevicePort(self.link))

    def close(self):
        if os.path.lexists(self.link):
            os.unlink(self.link)


class Memory(AgentSetup):
    count = 2

    def __init__(self):
        super().__init__("memory")
        self.agent = RunningAgent("memory", "memory", 0, 4)

    def start(self):
        pass

    def transport(self):
        end = self.agent.transport.connect()
        self.ends.append(end)
        return end

    def begin(self):
        self.agent.start()


class Can(AgentSetup):
    """python-can's virtual bus, with an id for each board."""

    count = 2

    def __init__(self):
        super().__init__("can")
        self.channel = f"uros-client-{os.getpid()}"
        self.start()

    def server(self):
        from support.can import CanServer

        return CanServer(self.channel, "virtual")

    def transport(self):
        return CanTransport(CanPort(self.channel, "virtual"), 0x200 + len(self.nodes))


class Modem(Udp):
    """UDP over virtual modems, one for each board, on the network of the host."""

    def __init__(self):
        self.network = HostRadioNetwork({"robots": "secret99"})
        super().__init__("udp")

    def close(self):
        self.network.close()


class ByEsp8266(Modem):
    def transport(self):
        modem = Esp8266(self.network, ticks_ms, join_ms=20, answer_ms=1, send_ms=1)
        return Esp8266Transport(modem, "robots", "secret99", self.host, self.port)


class ByGs2200(Modem):
    def transport(self):
        modem = Gs2200(self.network, ticks_ms, key_ms=20, join_ms=20)
        return Gs2200Transport(modem, modem, "robots", "secret99", self.host, self.port)


KINDS = {
    "udp": Udp, "udp6": Udp6, "tcp": Tcp, "tls": Tls, "serial": Serial, "memory": Memory,
    "can": Can, "esp8266": ByEsp8266, "gs2200": ByGs2200,
}  # fmt: skip


@contextmanager
def place(kind):
    with ExitStack() as stack:
        setup = KINDS[kind]()
        stack.callback(getattr(setup, "close", lambda: None))
        stack.callback(lambda: setup.agent and setup.stop())
        yield setup
        for node in setup.nodes:
            node.connection.transport.close()
        for end in setup.ends:
            end._socket.close()


@pytest.fixture(params=KINDS)
def setup(request):
    with place(request.param) as running:
        yield running


def boards(setup, *names):
    """Create nodes, each with a transport of its own; the agent runs afterwards."""
    for name in names:
        key = len(setup.nodes) + 1
        setup.nodes.append(Node(name, setup.transport(), key=key, **QUICK))
    if setup.kind == "memory":
        setup.begin()
    return setup.nodes


def until(setup, done, what="it takes too long"):
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, what
        for node in setup.nodes:
            node.spin_once(0.005)


def connected(setup):
    until(setup, lambda: all(node.state == AGENT_CONNECTED for node in setup.nodes))


def test_samples_in_both_directions(setup):
    node = boards(setup, "node")[0]
    received, images = [], []
    numbers = node.create_publisher(Int32, "numbers")
    blobs = node.create_publisher(UInt8MultiArray, "blobs")
    node.create_subscription(Int32, "numbers", lambda message: received.append(message.data), 1000)
    node.create_subscription(
        UInt8MultiArray, "blobs", lambda message: images.append(bytes(message.data))
    )
    connected(setup)
    for i in range(200):
        assert numbers.publish(Int32(data=i))
    blob = bytes(i * 7 & 0xFF for i in range(20_000))
    assert blobs.publish(UInt8MultiArray(data=blob))
    until(setup, lambda: len(received) >= 200 and images, (len(received), len(images)))
    assert received == list(range(200)) and images == [blob]
    assert node.connection.connections == 1 and node.connection.dropped == 0


def test_a_service(setup):
    nodes = boards(setup, *["server", "caller"][: setup.count])
    requests = []

    def trigger(request, response):
        requests.append(1)
        response.success, response.message = True, f"no. {len(requests)}"
        return response

    nodes[0].create_service(Trigger, "trigger", trigger)
    client = nodes[-1].create_client(Trigger, "trigger")
    connected(setup)
    answers = []
    for _ in range(5):
        client.call_async(Trigger.Request()).add_done_callback(
            lambda future: answers.append(future.result().message)
        )
    until(setup, lambda: len(answers) == 5)
    assert answers == [f"no. {i + 1}" for i in range(5)]


def test_destroying_a_node_closes_its_session(setup):
    node = boards(setup, "node")[0]
    node.create_publisher(Int32, "numbers")
    connected(setup)
    assert len(setup.agent.agent.clients) == 1
    node.destroy_node()
    until(setup, lambda: not setup.agent.agent.clients)
    assert node.state == WAITING_AGENT


@pytest.mark.parametrize("kind", ["udp", "tcp", "tls", "serial", "can", "esp8266", "gs2200"])
def test_all_entities_are_created_again_at_a_new_agent(kind):
    with place(kind) as setup:
        node = boards(setup, "node")[0]
        received, states = [], []
        node.on_state = states.append
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda message: received.append(message.data))
        for turn in range(3):
            connected(setup)
            assert publisher.publish(Int32(data=turn))
            until(setup, lambda turn=turn: turn in received)
            setup.stop()
            until(setup, lambda: node.state == WAITING_AGENT)
            setup.start()
        connected(setup)
        assert received == [0, 1, 2] and node.connection.connections >= 4
        assert states.count(AGENT_DISCONNECTED) == 3
        assert len(setup.agent.agent.clients) == 1


def test_an_agent_that_ends_together_with_its_line(setup):
    node = boards(setup, "node")[0]
    publisher = node.create_publisher(Int32, "numbers")
    connected(setup)
    setup.stop()
    for i in range(20):
        publisher.publish(Int32(data=i))
    until(setup, lambda: node.state == WAITING_AGENT)
    assert node.connection.reason
    until(setup, lambda: not publisher.publish(Int32()))
    calls = []
    node.create_timer(0.01, lambda: calls.append(1))
    until(setup, lambda: len(calls) >= 10)  # the program continues


@pytest.mark.parametrize("kind", ["udp", "tcp", "tls", "esp8266", "gs2200"])
def test_an_agent_that_starts_later(kind):
    with place(kind) as setup:
        setup.stop()
        node = boards(setup, "node")[0]
        calls = []
        node.create_timer(0.01, lambda: calls.append(1))
        until(setup, lambda: len(calls) >= 10)
        assert node.state == WAITING_AGENT
        setup.start()
        connected(setup)


@pytest.mark.parametrize("kind", ["udp", "udp6"])
def test_a_name_with_addresses_of_both_families(kind, monkeypatch):
    """The agent listens on one address family; the board connects, also after a restart.

    Datagrams to the other family are refused.
    """

    def both(host, port, *_):
        assert host == "robot.local"
        return [
            (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("fe80::1", port, 0, 0)),  # unreachable
            (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", port, 0, 0)),
            (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", port)),
        ]

    with place(kind) as setup:
        monkeypatch.setattr("uros.transport.udp.socket.getaddrinfo", both)
        setup.host = "robot.local"
        node = boards(setup, "node")[0]
        connected(setup)
        setup.stop()
        until(setup, lambda: node.state == WAITING_AGENT)
        setup.start()
        connected(setup)
        assert node.connection.connections == 2


def test_an_address_that_has_answered_is_kept_while_its_agent_restarts(monkeypatch):
    """The board keeps its port, by which a restarted agent with --state finds its session."""

    def listen(port=0):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind(("127.0.0.1", port))
        sock.settimeout(10)
        return sock

    agent = listen()
    port = agent.getsockname()[1]
    both = [
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", port)),
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.2", port)),
    ]
    monkeypatch.setattr("uros.transport.udp.socket.getaddrinfo", lambda *_: both)
    transport = UdpTransport("robot.local", port)
    transport.open()
    transport.send(b"before")
    board = agent.recvfrom(100)[1]
    agent.sendto(b"answer", board)
    assert transport.receive(10000) == b"answer"
    agent.close()
    transport.send(b"lost")
    assert transport.receive(10000) is None  # the refusal
    agent = listen(port)
    transport.send(b"after")
    assert agent.recvfrom(100) == (b"after", board)
    agent.close()
    transport.close()


def test_a_name_without_a_reachable_address(monkeypatch):
    nowhere = [(socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("fe80::1", 9, 0, 0))]
    monkeypatch.setattr("uros.transport.udp.socket.getaddrinfo", lambda *_: nowhere)
    transport = UdpTransport("robot.local", 9)
    for _ in range(3):
        with pytest.raises(OSError):
            transport.open()
    transport.close()


# --- serial devices----------------------------------------------------------------------------


@pytest.fixture
def terminal():
    """(master, path of the slave) of a pseudo-terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    for fd in (master, slave):
        try:
            os.close(fd)
        except OSError:  # a test has closed it
            pass


def refused(port):
    with pytest.raises(OSError) as caught:
        port.open()
    return caught.value


def test_a_device_reads_and_writes_without_blocking(terminal):
    master, path = terminal
    port = DevicePort(path, 57600)
    port.open()
    assert port.read(100) is None
    os.write(master, b"abcdef")
    port.wait(1000)
    assert port.read(4) == b"abcd" and port.read(100) == b"ef"
    assert port.write(b"ghi") == 3 and os.read(master, 100) == b"ghi"
    total = 0
    while (taken := port.write(bytes(4096))) > 0:
        total += taken
    assert total > 0  # the buffer is full, and write did not block
    port.close()
    port.close()


def test_a_device_opens_again(terminal):
    master, path = terminal
    port = DevicePort(path)
    for _ in range(3):
        port.open()
        assert os.write(master, b"x") and select.select([port.fd], [], [], SECONDS)[0]
        assert port.read(10) == b"x"
    port.close()


def test_a_device_that_is_unplugged_is_an_error(terminal):
    master, path = terminal
    port = DevicePort(path)
    port.open()
    os.close(master)
    with pytest.raises(OSError):
        while True:
            port.read(100)
            port.write(b"x")
    port.close()


def test_the_errors_of_a_device_that_does_not_open(terminal, tmp_path):
    error = refused(DevicePort("/dev/ttyNONE0"))
    assert error.errno == 2 and "plug the board in" in str(error)
    error = refused(DevicePort(str(tmp_path)))
    assert "not a serial device" in str(error)
    plain = tmp_path / "file"
    plain.write_text("")
    assert "not a serial device" in str(refused(DevicePort(str(plain))))
    first = DevicePort(terminal[1])
    first.open()
    assert "in use by another program" in str(refused(DevicePort(terminal[1])))
    first.close()
    with pytest.raises(TransportError, match="baud rate 0 does not exist"):
        DevicePort(terminal[1], 0)
