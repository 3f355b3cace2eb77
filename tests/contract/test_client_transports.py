"""What a node of ours can do over every transport that a board's program has on a host."""

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


class Surroundings:
    """A place for an agent that comes and goes, and boards that stay."""

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
        """The agent's end, or its kind."""
        return self.kind

    def stop(self):
        agent, self.agent = self.agent, None
        agent.close()
        assert agent.error is None and not agent.thread.is_alive()
        assert "internal error" not in agent.said.getvalue(), agent.said.getvalue()


class Udp(Surroundings):
    count = 2

    def __init__(self, kind="udp", host="127.0.0.1"):
        super().__init__(kind)
        self.listens_on = host
        self.host = host  # what boards know it by
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
    """The agent wants a certificate of the boards too."""

    def __init__(self):
        self.folder = TemporaryDirectory()
        self.authority = Authority(self.folder.name)
        self.board = self.authority.issue("board")
        super().__init__("tls")

    def server(self):
        from uros.agent.transports.certificates import Certificates
        from uros.agent.transports.tls import TlsServer

        files = Certificates(*self.authority.agent(), self.authority.ca)  # new ones each time
        return TlsServer(self.port, self.listens_on, files)

    def transport(self):
        cert, key = self.board
        return TlsTransport(self.host, self.port, ca=self.authority.ca, cert=cert, key=key)

    def close(self):
        self.folder.cleanup()


class Serial(Surroundings):
    """Agent and board at the two ends of a line: two pseudo-terminals with a wire between."""

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
        """The device's name stays; what it stands for is the new agent's line."""
        if os.path.lexists(self.link):
            os.unlink(self.link)
        os.symlink(self.agent.transport.device, self.link)

    def transport(self):
        self.relink()
        return StreamTransport(DevicePort(self.link))

    def close(self):
        if os.path.lexists(self.link):
            os.unlink(self.link)


class Memory(Surroundings):
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


class Can(Surroundings):
    """python-can's bus in memory; each board has an id of its own there."""

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
    """UDP by modelled modems, each with its own, whose network is the host's."""

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
        made = KINDS[kind]()
        stack.callback(getattr(made, "close", lambda: None))
        stack.callback(lambda: made.agent and made.stop())
        yield made
        for node in made.nodes:
            node.connection.transport.close()
        for end in made.ends:
            end._socket.close()


@pytest.fixture(params=KINDS)
def made(request):
    with place(request.param) as it:
        yield it


def boards(made, *names):
    """Nodes, each with a line of its own; the agent runs from now on at the latest."""
    for name in names:
        key = len(made.nodes) + 1
        made.nodes.append(Node(name, made.transport(), key=key, **QUICK))
    if made.kind == "memory":
        made.begin()
    return made.nodes


def until(made, done, what="it takes too long"):
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, what
        for node in made.nodes:
            node.spin_once(0.005)


def connected(made):
    until(made, lambda: all(it.state == AGENT_CONNECTED for it in made.nodes))


def test_samples_there_and_back(made):
    node = boards(made, "node")[0]
    heard, images = [], []
    numbers = node.create_publisher(Int32, "numbers")
    blobs = node.create_publisher(UInt8MultiArray, "blobs")
    node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data), 1000)
    node.create_subscription(UInt8MultiArray, "blobs", lambda it: images.append(bytes(it.data)))
    connected(made)
    for i in range(200):
        assert numbers.publish(Int32(data=i))
    blob = bytes(i * 7 & 0xFF for i in range(20_000))
    assert blobs.publish(UInt8MultiArray(data=blob))
    until(made, lambda: len(heard) >= 200 and images, (len(heard), len(images)))
    assert heard == list(range(200)) and images == [blob]
    assert node.connection.connections == 1 and node.connection.dropped == 0


def test_a_service(made):
    nodes = boards(made, *["server", "caller"][: made.count])
    asked = []

    def trigger(request, response):
        asked.append(1)
        response.success, response.message = True, f"no. {len(asked)}"
        return response

    nodes[0].create_service(Trigger, "trigger", trigger)
    client = nodes[-1].create_client(Trigger, "trigger")
    connected(made)
    answers = []
    for _ in range(5):
        client.call_async(Trigger.Request()).add_done_callback(
            lambda it: answers.append(it.result().message)
        )
    until(made, lambda: len(answers) == 5)
    assert answers == [f"no. {i + 1}" for i in range(5)]


def test_a_node_takes_its_leave(made):
    node = boards(made, "node")[0]
    node.create_publisher(Int32, "numbers")
    connected(made)
    assert len(made.agent.agent.clients) == 1
    node.destroy_node()
    until(made, lambda: not made.agent.agent.clients)  # at once, where the agent is not busy
    assert node.state == WAITING_AGENT


@pytest.mark.parametrize("kind", ["udp", "tcp", "tls", "serial", "can", "esp8266", "gs2200"])
def test_everything_is_there_again_after_another_agent(kind):
    with place(kind) as made:
        node = boards(made, "node")[0]
        heard, states = [], []
        node.on_state = states.append
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data))
        for turn in range(3):
            connected(made)
            assert publisher.publish(Int32(data=turn))
            until(made, lambda turn=turn: turn in heard)
            made.stop()
            until(made, lambda: node.state == WAITING_AGENT)
            made.start()
        connected(made)
        assert heard == [0, 1, 2] and node.connection.connections >= 4
        assert states.count(AGENT_DISCONNECTED) == 3
        assert len(made.agent.agent.clients) == 1


def test_an_agent_that_is_gone_with_its_line(made):
    node = boards(made, "node")[0]
    publisher = node.create_publisher(Int32, "numbers")
    connected(made)
    made.stop()
    for i in range(20):
        publisher.publish(Int32(data=i))
    until(made, lambda: node.state == WAITING_AGENT)
    assert node.connection.reason
    until(made, lambda: not publisher.publish(Int32()))
    calls = []
    node.create_timer(0.01, lambda: calls.append(1))
    until(made, lambda: len(calls) >= 10)  # and the program goes on


@pytest.mark.parametrize("kind", ["udp", "tcp", "tls", "esp8266", "gs2200"])
def test_an_agent_that_comes_later(kind):
    with place(kind) as made:
        made.stop()
        node = boards(made, "node")[0]
        calls = []
        node.create_timer(0.01, lambda: calls.append(1))
        until(made, lambda: len(calls) >= 10)
        assert node.state == WAITING_AGENT
        made.start()
        connected(made)


@pytest.mark.parametrize("kind", ["udp", "udp6"])
def test_a_name_with_addresses_of_both_families(kind, monkeypatch):
    """The agent listens on one of them, and no answer to the other comes but a refusal."""

    def both(host, port, *_):
        assert host == "robot.local"
        return [
            (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("fe80::1", port, 0, 0)),  # no way
            (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", port, 0, 0)),
            (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", port)),
        ]

    with place(kind) as made:
        monkeypatch.setattr("uros.transport.udp.socket.getaddrinfo", both)
        made.host = "robot.local"
        node = boards(made, "node")[0]
        connected(made)
        made.stop()
        until(made, lambda: node.state == WAITING_AGENT)
        made.start()
        connected(made)
        assert node.connection.connections == 2


def test_an_address_that_has_answered_is_kept_while_its_agent_restarts(monkeypatch):
    """A restarted agent with --state knows the board by its port."""

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


def test_a_name_with_no_way_to_any_address(monkeypatch):
    nowhere = [(socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("fe80::1", 9, 0, 0))]
    monkeypatch.setattr("uros.transport.udp.socket.getaddrinfo", lambda *_: nowhere)
    transport = UdpTransport("robot.local", 9)
    for _ in range(3):
        with pytest.raises(OSError):
            transport.open()
    transport.close()


# --- the device -------------------------------------------------------------------------------


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


def test_a_device_reads_and_writes_and_never_waits(terminal):
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
    assert total > 0  # full, and it did not wait
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


def test_why_a_device_does_not_open(terminal, tmp_path):
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
