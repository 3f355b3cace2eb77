"""A board's end of TCP, plain and in TLS, against agents and against what is none."""

import errno
import socket
import ssl
import subprocess
import threading

import pytest
from support.agent import running_agent
from support.certificates import Authority, authority
from support.lines import SECONDS
from unit.agent.transports.test_process import agent as agent_process
from uros.interfaces.std_msgs.msg import Int32

from uros.client import AGENT_CONNECTED, WAITING_AGENT, Node
from uros.ticks import ticks_diff, ticks_ms
from uros.transport.tcp import TcpTransport
from uros.transport.tls import TlsTransport, _der

QUICK = {"ping_ms": 20, "silence_ms": 400, "wait_ms": 20}


def until(node, done, what="it takes too long"):
    start = ticks_ms()
    while not done():
        assert ticks_diff(ticks_ms(), start) < SECONDS * 1000, what
        node.spin_once(0.005)


@pytest.fixture
def listener():
    """An agent's place without an agent."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        sock.settimeout(SECONDS)
        yield sock


def opened(listener, **options):
    """(transport, the other end), connected."""
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1], **options)
    transport.open()
    return transport, listener.accept()[0]


def received(transport, timeout_ms=5000):
    """The next message, or the error that comes instead."""
    start = ticks_ms()
    while ticks_diff(ticks_ms(), start) < timeout_ms:
        message = transport.receive(50)
        if message is not None:
            return message
    return None


def fails(transport, number=None):
    with pytest.raises(OSError) as caught:
        while True:
            transport.receive(1000)
    assert number is None or caught.value.errno == number
    return str(caught.value)


# --- TCP ---------------------------------------------------------------------------------------


def test_messages_there_and_back_in_any_pieces(listener):
    transport, there = opened(listener)
    with there:
        transport.send(b"one")  # before anybody has looked whether there is a connection
        assert transport.receive(0) is None
        assert there.recv(100) == b"\3\0one"
        for byte in b"\5\0hello\1\0!\0\0\2\0ab":
            there.sendall(bytes([byte]))
        assert [received(transport) for _ in range(3)] == [b"hello", b"!", b"ab"]
        assert transport.dropped == 0
        transport.send(b"x" * 513)
        assert transport.dropped == 1  # over the MTU
    transport.close()
    transport.close()


def test_what_the_network_does_not_take_is_kept_or_lost_whole(listener):
    transport, there = opened(listener, mtu=60_000)
    with there:
        transport._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        assert transport.receive(0) is None
        sent = 0
        while transport.dropped < 3:
            transport.send(bytes([sent & 0xFF]) * 60_000)
            sent += 1
        there.settimeout(SECONDS)
        stream = bytearray()
        whole = 60_002 * (sent - 3)
        while len(stream) < whole:
            transport.receive(0)
            stream += there.recv(1 << 20)
    assert len(stream) == whole
    for number in range(sent - 3):
        message = stream[60_002 * number : 60_002 * (number + 1)]
        assert message == (60_000).to_bytes(2, "little") + bytes([number & 0xFF]) * 60_000
    transport.close()


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
    transport = TcpTransport("127.0.0.1", port)
    transport.open()
    assert fails(transport, errno.ECONNREFUSED).endswith(
        f"nobody answers at 127.0.0.1, port {port}"
    )
    transport.close()


def test_the_end_of_the_connection(listener):
    transport, there = opened(listener)
    there.sendall(b"\2\0ok\7\0hal")
    there.close()
    assert received(transport) == b"ok"
    assert "closed by 127.0.0.1" in fails(transport, errno.ECONNRESET)
    transport.close()


def test_who_accepts_and_says_nothing_is_not_waited_for_for_ever(listener):
    """Nor a machine that is gone without a word."""
    transport, there = opened(listener, patience_ms=100)
    with there:
        assert "no answer from 127.0.0.1" in fails(transport, errno.ETIMEDOUT)
        transport.close()
    transport, there = opened(listener, patience_ms=100)
    with there:
        there.sendall(b"\2\0ok")
        assert received(transport) == b"ok"
        assert transport.receive(300) is None  # nothing was asked
        transport.send(b"and now?")
        fails(transport, errno.ETIMEDOUT)
    transport.close()


def test_an_address_that_does_not_answer_and_the_next_one(listener, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as sock:
        nobody = sock.getsockname()[1]
    addresses = [
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", nobody)),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", listener.getsockname()),
    ]
    monkeypatch.setattr("uros.transport.tcp.socket.getaddrinfo", lambda *_: addresses)
    transport = TcpTransport("robot.local")
    transport.open()
    fails(transport)
    for _ in range(2):  # and where somebody answered, it stays
        transport.open()
        with listener.accept()[0] as there:
            there.sendall(b"\2\0ok")
            assert received(transport) == b"ok"
    transport.close()


def test_a_name_that_nobody_knows_and_no_way(monkeypatch):
    def unknown(*_):
        raise socket.gaierror(-2, "Name or service not known")

    transport = TcpTransport("robot.local")
    monkeypatch.setattr("uros.transport.tcp.socket.getaddrinfo", unknown)
    with pytest.raises(OSError, match="not known"):
        transport.open()
    nowhere = [(socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("fe80::1", 9, 0, 0))]
    monkeypatch.setattr("uros.transport.tcp.socket.getaddrinfo", lambda *_: nowhere)
    with pytest.raises(OSError):
        transport.open()
    transport.close()


# --- TLS ---------------------------------------------------------------------------------------


def why_not(transport):
    """What a node says of the agent that it does not come to."""
    node = Node("node", transport, key=1, **QUICK)
    until(node, lambda: node.connection.reason)
    assert node.state == WAITING_AGENT
    reason = node.connection.reason
    node.connection.transport.close()
    return reason


@pytest.fixture(scope="module")
def tls_agent():
    with running_agent("tls", "memory") as running:
        yield running


def transport_to(agent, **options):
    return TlsTransport("127.0.0.1", agent.transport.port, **options)


def test_the_ca_by_its_file_or_its_bytes_pem_or_der(tls_agent):
    pem = open_bytes(authority().ca)
    for ca in (authority().ca, pem, ssl.PEM_cert_to_DER_cert(pem.decode())):
        node = Node("node", transport_to(tls_agent, ca=ca), key=2, **QUICK)
        until(node, lambda node=node: node.state == AGENT_CONNECTED)
        node.destroy_node()


def open_bytes(path):
    with open(path, "rb") as file:
        return file.read()


def test_an_agent_that_one_should_not_trust(tls_agent, tmp_path):
    other = Authority(tmp_path)
    assert "CERTIFICATE_VERIFY_FAILED" in why_not(transport_to(tls_agent, ca=other.ca))
    said = why_not(transport_to(tls_agent, ca=authority().ca, name="robot.example"))
    assert "CERTIFICATE_VERIFY_FAILED" in said and "robot.example" in said


def test_trust_in_anybody_is_asked_for_by_name(tls_agent):
    with pytest.raises(ValueError, match="ca is missing"):
        transport_to(tls_agent)
    node = Node("node", transport_to(tls_agent, verify=False), key=3, **QUICK)
    until(node, lambda: node.state == AGENT_CONNECTED)
    node.destroy_node()


def test_certificate_and_key_belong_together():
    for given in ({"cert": "a"}, {"key": "a"}):
        with pytest.raises(ValueError, match="cert and key belong together"):
            TlsTransport("127.0.0.1", ca=b"x", **given)


@pytest.mark.parametrize("text", [None, b"", b"nonsense", b"-----BEGIN CERTIFICATE-----\n\xff"])
def test_a_file_that_is_none_is_said_and_tried_again(tls_agent, tmp_path, text):
    path = tmp_path / "ca.pem"
    if text is not None:
        path.write_bytes(text)
    node = Node("node", transport_to(tls_agent, ca=str(path)), key=4, **QUICK)
    until(node, lambda: node.connection.reason)
    assert node.state == WAITING_AGENT
    path.write_bytes(open_bytes(authority().ca))
    until(node, lambda: node.state == AGENT_CONNECTED)
    node.destroy_node()


def test_an_agent_without_tls():
    with running_agent("tcp", "memory") as plain:
        said = why_not(transport_to(plain, ca=authority().ca))
    assert said.startswith("the line is gone: ")


def test_a_handshake_that_is_not_answered(listener):
    port = listener.getsockname()[1]
    transport = TlsTransport("127.0.0.1", port, ca=authority().ca, patience_ms=100)
    transport.open()
    with listener.accept()[0]:
        fails(transport, errno.ETIMEDOUT)
    transport.close()


def test_no_spinning_while_the_other_end_takes_its_time(listener, monkeypatch):
    """What waits to be sent must not make the socket look ready: the handshake comes first."""
    port = listener.getsockname()[1]
    transport = TlsTransport("127.0.0.1", port, ca=authority().ca)
    transport.open()
    with listener.accept()[0]:
        transport.send(b"ping")
        reads = []
        real = TlsTransport._read
        monkeypatch.setattr(TlsTransport, "_read", lambda it: reads.append(1) or real(it))
        assert transport.receive(200) is None
        assert len(reads) < 5
    transport.close()


def test_through_software_that_is_not_ours(tmp_path):
    """openssl's own server, and behind it, by hand, a plain agent."""
    made = Authority(tmp_path)
    cert, key = made.agent()
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
    command = ["openssl", "s_server", "-quiet", "-accept", f"127.0.0.1:{port}", "-naccept", "1",
               "-cert", cert, "-key", key, "-CAfile", made.ca, "-Verify", "1",
               "-verify_return_error"]  # fmt: skip
    board_cert, board_key = made.issue("board")
    with (
        running_agent("tcp", "memory") as plain,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as server,
        socket.create_connection(("127.0.0.1", plain.transport.port)) as inside,
    ):

        def to_agent():
            while chunk := server.stdout.read1(65536):
                inside.sendall(chunk)

        def from_agent():
            while chunk := inside.recv(65536):
                server.stdin.write(chunk)
                server.stdin.flush()

        threads = [threading.Thread(target=it) for it in (to_agent, from_agent)]
        for it in threads:
            it.start()
        transport = TlsTransport("127.0.0.1", port, ca=made.ca, cert=board_cert, key=board_key)
        node = Node("node", transport, key=5, **QUICK)
        heard = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data))
        until(node, lambda: node.state == AGENT_CONNECTED)
        assert publisher.publish(Int32(data=77))
        until(node, lambda: heard == [77])
        node.destroy_node()
        server.terminate()
        inside.shutdown(socket.SHUT_RDWR)
        for it in threads:
            it.join(SECONDS)


def test_an_agent_process_that_is_started_again_with_new_certificates(tmp_path):
    """The command line, from end to end: a board publishes, and comes back by itself."""
    made = Authority(tmp_path)
    board_cert, board_key = made.issue("left")

    def command(port):
        cert, key = made.agent()
        return ("tcp4", "-p", port, "-m", "memory", "--tls-cert", cert, "--tls-key", key,
                "--tls-ca", made.ca)  # fmt: skip

    with agent_process(*command(0)) as first:
        port = int(first.until(r"TLSv4Agent +\| init .*port: (\d+)")[1])
        transport = TlsTransport("127.0.0.1", port, ca=made.ca, cert=board_cert, key=board_key)
        node = Node("node", transport, key=6, **QUICK)
        heard = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data))
        until(node, lambda: node.state == AGENT_CONNECTED)
        assert publisher.publish(Int32(data=1))
        until(node, lambda: heard == [1])
        first.until(r"session established .*address: 127\.0\.0\.1:\d+ \(CN=left\)")
        assert first.end() == 0
    until(node, lambda: node.state == WAITING_AGENT)
    with agent_process(*command(port)) as second:
        until(node, lambda: node.state == AGENT_CONNECTED)
        assert publisher.publish(Int32(data=2))
        until(node, lambda: heard == [1, 2])
        node.destroy_node()
        second.until("session closed")
        assert second.end() == 0


def test_pem_is_turned_into_der_for_boards():
    pem = open_bytes(authority().ca)
    der = ssl.PEM_cert_to_DER_cert(pem.decode())
    assert _der(pem) == _der(der) == der
    assert _der(b"Issuer: us\n" + pem.replace(b"\n", b"\r\n") + pem) == der
    parameters = b"-----BEGIN EC PARAMETERS-----\nBggqhkjOPQMBBw==\n-----END EC PARAMETERS-----\n"
    assert _der(parameters + pem) == der
    for text in (b"-----BEGIN X", b"-----BEGIN X-----\nAAAA", b"-----BEGIN X-----\nA\n-----END "):
        with pytest.raises(ValueError):
            _der(text)
