"""The TCP transport of boards, plain and in TLS, with agents and with other peers."""

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


def until(node, done, complaint="it takes too long"):
    start = ticks_ms()
    while not done():
        assert ticks_diff(ticks_ms(), start) < SECONDS * 1000, complaint
        node.spin_once(0.005)


@pytest.fixture
def listener():
    """A listening socket without an agent."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        sock.settimeout(SECONDS)
        yield sock


def opened(listener, **options):
    """Return a connected transport and the socket of its peer."""
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1], **options)
    transport.open()
    return transport, listener.accept()[0]


def received(transport, timeout_ms=5000):
    """Return the next message, or None after ``timeout_ms``."""
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


def test_messages_are_exchanged_in_any_pieces(listener):
    transport, peer = opened(listener)
    with peer:
        transport.send(b"one")  # before the transport knows that it is connected
        assert transport.receive(0) is None
        assert peer.recv(100) == b"\3\0one"
        for byte in b"\5\0hello\1\0!\0\0\2\0ab":
            peer.sendall(bytes([byte]))
        assert [received(transport) for _ in range(3)] == [b"hello", b"!", b"ab"]
        assert transport.dropped == 0
        transport.send(b"x" * 513)
        assert transport.dropped == 1  # over the MTU
    transport.close()
    transport.close()


def test_messages_without_room_are_dropped_as_a_whole(listener):
    transport, peer = opened(listener, mtu=60_000)
    with peer:
        transport._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        assert transport.receive(0) is None
        sent = 0
        while transport.dropped < 3:
            transport.send(bytes([sent & 0xFF]) * 60_000)
            sent += 1
        peer.settimeout(SECONDS)
        stream = bytearray()
        whole = 60_002 * (sent - 3)
        while len(stream) < whole:
            transport.receive(0)
            stream += peer.recv(1 << 20)
    assert len(stream) == whole
    for number in range(sent - 3):
        message = stream[60_002 * number : 60_002 * (number + 1)]
        assert message == (60_000).to_bytes(2, "little") + bytes([number & 0xFF]) * 60_000
    transport.close()


def test_a_refused_connection_raises():
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
    transport = TcpTransport("127.0.0.1", port)
    transport.open()
    assert fails(transport, errno.ECONNREFUSED).endswith(
        f"nobody answers at 127.0.0.1, port {port}"
    )
    transport.close()


def test_a_closed_connection_raises_after_its_last_message(listener):
    transport, peer = opened(listener)
    peer.sendall(b"\2\0ok\7\0hal")
    peer.close()
    assert received(transport) == b"ok"
    assert "closed by 127.0.0.1" in fails(transport, errno.ECONNRESET)
    transport.close()


def test_a_silent_peer_times_out(listener):
    """A peer that never answers, and one that stops answering, time out."""
    transport, peer = opened(listener, patience_ms=100)
    with peer:
        assert "no answer from 127.0.0.1" in fails(transport, errno.ETIMEDOUT)
        transport.close()
    transport, peer = opened(listener, patience_ms=100)
    with peer:
        peer.sendall(b"\2\0ok")
        assert received(transport) == b"ok"
        assert transport.receive(300) is None  # no message waits for an answer
        transport.send(b"and now?")
        fails(transport, errno.ETIMEDOUT)
    transport.close()


def test_an_address_that_refuses_is_followed_by_the_next(listener, monkeypatch):
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
    for _ in range(2):  # the address that answered is kept
        transport.open()
        with listener.accept()[0] as peer:
            peer.sendall(b"\2\0ok")
            assert received(transport) == b"ok"
    transport.close()


def test_unknown_names_and_unreachable_hosts_raise(monkeypatch):
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
    """Return the reason that a node reports when it cannot connect."""
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


def test_the_ca_is_a_file_or_bytes_in_pem_or_der(tls_agent):
    pem = open_bytes(authority().ca)
    for ca in (authority().ca, pem, ssl.PEM_cert_to_DER_cert(pem.decode())):
        node = Node("node", transport_to(tls_agent, ca=ca), key=2, **QUICK)
        until(node, lambda node=node: node.state == AGENT_CONNECTED)
        node.destroy_node()


def open_bytes(path):
    with open(path, "rb") as file:
        return file.read()


def test_an_untrusted_agent_is_refused(tls_agent, tmp_path):
    unknown_authority = Authority(tmp_path)
    assert "CERTIFICATE_VERIFY_FAILED" in why_not(transport_to(tls_agent, ca=unknown_authority.ca))
    reason = why_not(transport_to(tls_agent, ca=authority().ca, name="robot.example"))
    assert "CERTIFICATE_VERIFY_FAILED" in reason and "robot.example" in reason


def test_verify_false_accepts_any_certificate(tls_agent):
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
def test_an_invalid_ca_file_is_reported_and_read_again(tls_agent, tmp_path, text):
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
        reason = why_not(transport_to(plain, ca=authority().ca))
    assert reason.startswith("the line is gone: ")


def test_a_handshake_that_is_not_answered(listener):
    port = listener.getsockname()[1]
    transport = TlsTransport("127.0.0.1", port, ca=authority().ca, patience_ms=100)
    transport.open()
    with listener.accept()[0]:
        fails(transport, errno.ETIMEDOUT)
    transport.close()


def test_an_unanswered_handshake_causes_no_busy_waiting(listener, monkeypatch):
    """Unsent messages must not make the socket look ready: the handshake comes first."""
    port = listener.getsockname()[1]
    transport = TlsTransport("127.0.0.1", port, ca=authority().ca)
    transport.open()
    with listener.accept()[0]:
        transport.send(b"ping")
        reads = []
        real = TlsTransport._read
        monkeypatch.setattr(TlsTransport, "_read", lambda line: reads.append(1) or real(line))
        assert transport.receive(200) is None
        assert len(reads) < 5
    transport.close()


def test_tls_with_the_server_of_openssl(tmp_path):
    """The server of openssl forwards to a plain agent."""
    certificates = Authority(tmp_path)
    cert, key = certificates.agent()
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
    command = ["openssl", "s_server", "-quiet", "-accept", f"127.0.0.1:{port}", "-naccept", "1",
               "-cert", cert, "-key", key, "-CAfile", certificates.ca, "-Verify", "1",
               "-verify_return_error"]  # fmt: skip
    board_cert, board_key = certificates.issue("board")
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

        threads = [threading.Thread(target=target) for target in (to_agent, from_agent)]
        for thread in threads:
            thread.start()
        transport = TlsTransport(
            "127.0.0.1", port, ca=certificates.ca, cert=board_cert, key=board_key
        )
        node = Node("node", transport, key=5, **QUICK)
        heard = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda message: heard.append(message.data))
        until(node, lambda: node.state == AGENT_CONNECTED)
        assert publisher.publish(Int32(data=77))
        until(node, lambda: heard == [77])
        node.destroy_node()
        server.terminate()
        inside.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join(SECONDS)


def test_a_node_reconnects_to_an_agent_with_new_certificates(tmp_path):
    """The agent's process restarts with new certificates; the board publishes before and after."""
    certificates = Authority(tmp_path)
    board_cert, board_key = certificates.issue("left")

    def command(port):
        cert, key = certificates.agent()
        return ("tcp4", "-p", port, "-m", "memory", "--tls-cert", cert, "--tls-key", key,
                "--tls-ca", certificates.ca)  # fmt: skip

    with agent_process(*command(0)) as first:
        port = int(first.until(r"TLSv4Agent +\| init .*port: (\d+)")[1])
        transport = TlsTransport(
            "127.0.0.1", port, ca=certificates.ca, cert=board_cert, key=board_key
        )
        node = Node("node", transport, key=6, **QUICK)
        heard = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda message: heard.append(message.data))
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


def test_pem_is_converted_to_der():
    pem = open_bytes(authority().ca)
    der = ssl.PEM_cert_to_DER_cert(pem.decode())
    assert _der(pem) == _der(der) == der
    assert _der(b"Issuer: us\n" + pem.replace(b"\n", b"\r\n") + pem) == der
    parameters = b"-----BEGIN EC PARAMETERS-----\nBggqhkjOPQMBBw==\n-----END EC PARAMETERS-----\n"
    assert _der(parameters + pem) == der
    for text in (b"-----BEGIN X", b"-----BEGIN X-----\nAAAA", b"-----BEGIN X-----\nA\n-----END "):
        with pytest.raises(ValueError):
            _der(text)
