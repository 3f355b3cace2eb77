"""Tests the discovery of an agent on MicroPython, whose build for tests has no sockets.

The fake sockets behave as those of MicroPython 1.27 over lwIP: addresses are results of
getaddrinfo, which here accepts numeric addresses alone; a UDP socket without data raises EAGAIN;
the source of a datagram is an address and a port, or octets as in the port for Unix.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mpy.harness import MicroPython, compiled, portable_sources, tree

from uros.boards.builder.file_system import build

SOCKET = """
import errno

AF_INET, SOCK_DGRAM = 2, 2
created = []
down = False

def getaddrinfo(host, port, family=0, kind=0):
    assert kind == SOCK_DGRAM
    return [(AF_INET, kind, 0, "", ("numeric", host, port))]

class socket:
    def __init__(self, family, kind):
        self.sent = []
        self.incoming = []
        self.closed = 0
        self.bound = self.peer = None
        created.append(self)

    def setblocking(self, flag):
        assert not flag

    def bind(self, address):
        self.bound = address

    def connect(self, address):
        self.peer = address

    def sendto(self, data, address):
        if down:
            raise OSError(errno.EHOSTUNREACH)
        self.sent.append((bytes(data), address))
        return len(data)

    def send(self, data):
        self.sent.append(bytes(data))
        return len(data)

    def recvfrom(self, size):
        if not self.incoming:
            raise OSError(errno.EAGAIN)
        data, source = self.incoming.pop(0)
        return data[:size], source

    def recv(self, size):
        return self.recvfrom(size)[0]

    def close(self):
        self.closed += 1
"""
SELECT = """
import time

POLLIN = 1
waited = []

class poll:
    def register(self, sock, events):
        assert events == POLLIN
        self.sock = sock

    def poll(self, timeout_ms):
        waited.append(timeout_ms)
        if self.sock.incoming:
            return [(self.sock, POLLIN)]
        time.sleep_ms(timeout_ms)
        return []
"""
# An agent at 192.0.2.7:8888, and one that listens at all addresses of its machine.
COMMON = """
from uros.transport.discovery import DiscoveringTransport, QUESTION, discover_agent
INFO = bytes.fromhex("80000000060124000009fffd0000010d585243450100010f00010d00"
                     "010000000100000001c000020700b822")
ANYWHERE = INFO[:-7] + bytes(5) + INFO[-2:]

def raises(call, *arguments):
    try:
        call(*arguments)
    except OSError as error:
        return str(error)
    raise AssertionError("nothing raised")
"""


def board_with(files: dict[str, str | bytes]) -> MicroPython:
    board = MicroPython()
    board.install({"socket.py": SOCKET, "select.py": SELECT})
    board.install(files)
    # The interpreter's built-in select has precedence on sys.path.
    board.run("import sys\nfor name in ('socket', 'select'):\n    sys.modules.pop(name, None)\n"
              "sys.path.insert(0, '/lib')")  # fmt: skip
    board.run("import socket, select\nassert hasattr(select, 'waited')")
    return board


def built(folder: Path, program: str) -> dict[str, bytes]:
    """Return a board's files, with this program as ``/lib/program.py``."""
    (folder / "program").mkdir()
    (folder / "program" / "program.py").write_text(program)
    build(folder / "program", folder / "out", "mpy")
    return tree(folder / "out")


@pytest.fixture(params=["py", "mpy"])
def board(request: pytest.FixtureRequest) -> Iterator[MicroPython]:
    files = portable_sources()
    with board_with(compiled(files) if request.param == "mpy" else dict(files)) as micropython:
        micropython.run(COMMON)
        yield micropython


WAITING = """
def scene(discover_agent, INFO, ANYWHERE):
    import select, socket
    original_poll = select.poll.poll

    def poll_with_answers(self, timeout_ms):
        if not self.sock.incoming:
            self.sock.incoming = [(b"nonsense", ("192.0.2.9", 7400))] + answers
        return original_poll(self, timeout_ms)

    select.poll.poll = poll_with_answers
    answers = [(INFO, ("192.0.2.1", 7400))]
    assert discover_agent(1000) == ("192.0.2.7", 8888)
    assert socket.created[-1].sent[0][1] == ("numeric", "239.255.0.2", 7400)
    assert len(socket.created[-1].sent) == 1 and socket.created[-1].closed == 1
    answers = [(ANYWHERE, ("192.0.2.1", 7400))]
    assert discover_agent(1000, (("10.0.0.1", 7401),), "10.0.0.7") == ("192.0.2.1", 8888)
    assert socket.created[-1].sent[0][1] == ("numeric", "10.0.0.1", 7401)
    assert socket.created[-1].bound == ("numeric", "10.0.0.7", 0)
    answers = [(INFO, b"sockaddr")]
    assert discover_agent(1000) == ("192.0.2.7", 8888)
    select.poll.poll = original_poll
"""


def test_waiting_for_an_agent(board: MicroPython) -> None:
    board.run(WAITING + """
scene(discover_agent, INFO, ANYWHERE)
assert discover_agent(30) is None and socket.created[-1].closed == 1
socket.down = True
raises(discover_agent, 1000)
assert socket.created[-1].closed == 1
""")  # fmt: skip


def test_the_transport(board: MicroPython) -> None:
    board.run("""
t = DiscoveringTransport(patience_ms=300)
t.open()
search = socket.created[-1]
assert search.sent == [(QUESTION, ("numeric", "239.255.0.2", 7400))]
t.send(bytearray(b"ping..."), 4)
assert t.receive(0) is None and t.agent is None
search.incoming = [(b"nonsense", ("192.0.2.9", 1)), (ANYWHERE, ("192.0.2.7", 7400))]
assert t.receive(0) is None and t.agent == ("192.0.2.7", 8888)
line = socket.created[-1]
assert search.closed == 1 and line.peer == ("numeric", "192.0.2.7", 8888)
assert line.sent == [b"ping"]
line.incoming = [(b"pong", None)]
assert t.receive(1000) == b"pong"
assert t.receive(350) is None
t.send(b"more", 4)
assert line.sent == [b"ping", b"more"]
t.close()
assert line.closed == 1 and t.close() is None

t.open()  # and again
assert socket.created[-1] is not search
assert "no agent answers at 239.255.0.2 port 7400" in raises(t.receive, 350)
t.close()
t.open()
socket.created[-1].incoming = [(INFO, ("192.0.2.1", 7400))]
assert t.receive(0) is None and t.agent == ("192.0.2.7", 8888)
assert "192.0.2.7 port 8888, and is silent there" in raises(t.receive, 350)
t.close()
socket.down = True
raises(t.open)
assert socket.created[-1].closed == 1
""")


@pytest.mark.slow
def test_discovery_works_in_a_bytecode_build(tmp_path: Path) -> None:
    """Discovery and a node find the agent in a default ``--mpy`` build."""
    program = (
        COMMON
        + WAITING
        + """
from uros.client import Node

def run():
    scene(discover_agent, INFO, ANYWHERE)
    import socket
    node = Node("node", DiscoveringTransport(), key=1, wait_ms=0)
    node.spin_once(0)
    socket.created[-1].incoming = [(INFO, ("192.0.2.1", 7400))]
    node.spin_once(0)
    line = socket.created[-1]
    assert line.peer == ("numeric", "192.0.2.7", 8888) and line.sent[0][4] == 2
"""
    )
    with board_with(built(tmp_path, program)) as board:
        board.run("import program\nprogram.run()")


@pytest.mark.slow
def test_heap_of_discovery(tmp_path: Path) -> None:
    """Discovery takes at most 5,400 bytes more than a known address: today's cost and a tenth."""
    program = """
from uros.client import Node
from uros.transport.{0} import {1}

def run():
    node = Node("node", {1}({2}))
    publisher = node.create_publisher(None, "topic", 10)
    node.create_timer(1.0, lambda: publisher.publish(None))
    node.spin()
"""
    heaps = []
    for name, *rest in (
        ("known", "udp", "UdpTransport", "'h'"),
        ("found", "discovery", "DiscoveringTransport", ""),
    ):
        (tmp_path / name).mkdir()
        with board_with(built(tmp_path / name, program.format(*rest))) as board:
            before = board.heap()
            board.run("import uros._all")
            heaps.append(board.heap() - before)
    print(f"\nfinding the agent: {heaps[1] - heaps[0]} bytes")
    assert 0 < heaps[1] - heaps[0] <= 5400
