"""Tests of the board's TCP and TLS transports on MicroPython, which here lacks socket and ssl.

The fake modules behave as those of MicroPython 1.27: a socket raises EINPROGRESS and EAGAIN, and
``read`` and ``write`` of an SSL socket return None instead; a refused certificate raises
ValueError, after which the SSL socket has no socket any longer; certificates are DER alone.
"""

from collections.abc import Iterator

import pytest
from mpy.harness import MicroPython, portable_sources

SOCKET = """
import errno

AF_INET, SOCK_STREAM = 2, 1
created = []
addresses = [(2, 1, 0, "", ("192.0.2.7", 8888))]

def getaddrinfo(host, port, family=0, kind=0):
    return addresses

class socket:
    def __init__(self, family, kind):
        self.connected = False
        self.refused = False
        self.incoming = b""
        self.ended = False
        self.room = 10000
        self.sent = b""
        self.closed = 0
        created.append(self)

    def setblocking(self, flag):
        assert not flag

    def connect(self, address):
        assert address == addresses[0][-1]
        raise OSError(errno.EINPROGRESS)

    def recv(self, size):
        if not self.incoming:
            if self.ended:
                return b""
            raise OSError(errno.EAGAIN)
        data, self.incoming = self.incoming[:size], self.incoming[size:]
        return data

    def send(self, data):
        if not self.room:
            raise OSError(errno.EAGAIN)
        size = min(self.room, len(data))
        self.room -= size
        self.sent += bytes(data[:size])
        return size

    def close(self):
        self.closed += 1
"""
SELECT = """
POLLIN, POLLOUT, POLLERR, POLLHUP = 1, 4, 8, 16
polled = []

class poll:
    def register(self, stream, events):
        self.stream, self.events = stream, events

    def modify(self, stream, events):
        assert stream is self.stream
        self.events = events

    def poll(self, timeout_ms):
        polled.append((self.events, timeout_ms))
        sock = getattr(self.stream, "sock", self.stream)
        if sock.refused:
            return [(self.stream, POLLERR | POLLHUP)]
        return [(self.stream, POLLOUT)] if sock.connected and self.events & POLLOUT else []
"""
SSL = """
PROTOCOL_TLS_CLIENT, CERT_NONE, CERT_REQUIRED = 0, 0, 2
created = []
refusal = None

class SSLContext:
    def __init__(self, protocol):
        assert protocol == PROTOCOL_TLS_CLIENT
        self.verify_mode = CERT_NONE  # as micropython-lib's does
        self.ca = self.chain = None

    def load_verify_locations(self, cafile=None, cadata=None):
        if cadata[:1] != b"0":
            raise ValueError("invalid cert")
        self.ca = cadata

    def load_cert_chain(self, cert, key):
        if cert[:1] != b"0" or key[:1] != b"0":
            raise ValueError("invalid key")
        self.chain = cert, key

    def wrap_socket(self, sock, server_side=False, do_handshake_on_connect=True,
                    server_hostname=None):
        if self.verify_mode == CERT_REQUIRED and server_hostname is None:
            raise ValueError("CERT_REQUIRED requires server_hostname")
        assert not do_handshake_on_connect  # the handshake would block
        return SSLSocket(self, sock, server_hostname)

class SSLSocket:
    def __init__(self, context, sock, name):
        self.context, self.sock, self.name = context, sock, name
        self.shaken = False
        created.append(self)

    def _shake(self):
        if refusal:
            self.raw, self.sock = self.sock, None
            raise ValueError(refusal)

    def read(self, size):
        self._shake()
        if not self.shaken:
            return None
        try:
            return self.sock.recv(size)
        except OSError:
            return None

    def write(self, data):
        self._shake()
        if not self.shaken:
            return None
        try:
            return self.sock.send(data)
        except OSError:
            return None

    def close(self):
        if self.sock is not None:
            self.sock.close()
            self.sock = None
"""


@pytest.fixture
def board() -> Iterator[MicroPython]:
    with MicroPython() as micropython:
        micropython.install({"socket.py": SOCKET, "select.py": SELECT, "ssl.py": SSL})
        micropython.install(portable_sources())
        # A built-in select of the interpreter has precedence on sys.path.
        micropython.run(
            "import sys\n"
            "for name in ('socket', 'select', 'ssl'):\n    sys.modules.pop(name, None)\n"
            "sys.path.insert(0, '/lib')"
        )
        micropython.write(
            "/lib/ca.pem", "-----BEGIN CERTIFICATE-----\nMAEC\n-----END CERTIFICATE-----\n"
        )
        micropython.write("/lib/board.key", b"0key")
        micropython.run("import socket, select, ssl\nassert hasattr(socket, 'addresses') and"
               " hasattr(select, 'polled')")  # fmt: skip
        yield micropython


COMMON = """
from uros.transport.tcp import TcpTransport
from uros.transport.tls import TlsTransport

def raises(call, *arguments):
    try:
        call(*arguments)
    except OSError as error:
        return str(error)
    raise AssertionError("nothing raised")
"""


def test_tcp(board: MicroPython) -> None:
    board.run(
        COMMON
        + """
t = TcpTransport("agent.local")
t.open()
sock = socket.created[-1]
t.send(b"ping")
assert t.receive(0) is None and sock.sent == b""
sock.connected = True
assert t.receive(0) is None and sock.sent == b"\\4\\0ping"
sock.incoming = b"\\2\\0ok\\3\\0wel"
assert t.receive(1000) == b"ok"
sock.incoming = b"l"
assert t.receive(1000) == b"wel"
sock.room = 3
t.send(b"large")
t.send(b"lost")
assert t.dropped == 1
assert t.receive(0) is None
sock.room = 100
assert t.receive(0) is None and sock.sent == b"\\4\\0ping\\5\\0large"
sock.ended = True
assert "closed by agent.local, port 8888" in raises(t.receive, 0)
t.close()
assert sock.closed and t.close() is None

t.open()
socket.created[-1].refused = True
assert "nobody answers at agent.local" in raises(t.receive, 0)
t = TcpTransport("agent.local", patience_ms=30)
t.open()
assert "no answer from agent.local" in raises(t.receive, 1000)
"""
    )


def test_tls(board: MicroPython) -> None:
    board.run(
        COMMON
        + """
t = TlsTransport("agent.local", ca="/lib/ca.pem", cert=b"0cert", key="/lib/board.key")
t.open()
sock = socket.created[-1]
t.send(b"ping")
assert t.receive(0) is None and not ssl.created
sock.connected = True
assert t.receive(0) is None
line = ssl.created[-1]
assert line.name == "agent.local" and line.context.verify_mode == ssl.CERT_REQUIRED
assert line.context.ca == b"0\\1\\2" and line.context.chain == (b"0cert", b"0key")
assert sock.sent == b""  # the handshake is not done
line.shaken = True
assert t.receive(0) is None and sock.sent == b"\\4\\0ping"
sock.incoming = b"\\2\\0ok"
assert t.receive(1000) == b"ok"
sock.room = 0
t.send(b"more")
assert t.receive(0) is None
sock.room = 99
assert t.receive(0) is None and sock.sent == b"\\4\\0ping\\4\\0more"
sock.ended = True
raises(t.receive, 0)
t.close()
assert sock.closed

t.open()  # and again
assert socket.created[-1] is not sock
t.close()
"""
    )


def test_a_certificate_that_is_refused(board: MicroPython) -> None:
    board.run(
        COMMON
        + """
t = TlsTransport("agent.local", ca="/lib/ca.pem", name="robot")
t.open()
sock = socket.created[-1]
sock.connected = True
ssl.refusal = "\\nThe certificate is not correctly signed by the trusted CA\\n"
text = raises(t.receive, 0)
assert text == "the agent's certificate is refused: " + ssl.refusal.strip(), text
assert ssl.created[-1].name == "robot"
t.close()
assert sock.closed == 1  # although the SSL socket does not close it any longer

bad = TlsTransport("agent.local", ca=b"no certificate")
assert "cannot be used: invalid cert" in raises(bad.open)
bad = TlsTransport("agent.local", ca="/lib/none.pem")
raises(bad.open)
free = TlsTransport("agent.local", verify=False)
ssl.refusal = None
free.open()
socket.created[-1].connected = True
free.receive(0)
assert ssl.created[-1].context.verify_mode == ssl.CERT_NONE
"""
    )


def test_heap_of_the_tls_transport(board: MicroPython) -> None:
    board.run("import uros.client, uros.transport.serial")
    before = board.heap()
    board.run("import uros.transport.tls")
    cost = board.heap() - before
    print(f"\ntransport.tlsboard, .py: {cost} bytes")
    assert 0 < cost <= 9_000
