"""pyserial's lines: a pseudo-terminal, loop://, socket://, rfc2217://; threads that end."""

import errno
import os
import socket
import sys
import threading
import tty

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS, SerialLine
from support.portable import framed
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import TYPE, wait_for

from uros.agent.transports import line as line_module
from uros.agent.transports import portable_serial as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.portable_serial import PySerialPort, PySerialServer, reason
from uros.transport.serial import StreamTransport
from uros.transport.serial_host import device_port


@pytest.fixture(autouse=True)
def all_threads_end():
    yield
    for thread in threading.enumerate():
        if thread.name.startswith("uros-serial"):
            thread.join(SECONDS)
            assert not thread.is_alive()


@pytest.fixture
def host():
    bare_host = BareHost()
    yield bare_host
    bare_host.close()


@pytest.fixture
def terminal():
    """(master, slave)"""
    ends = os.openpty()
    tty.setraw(ends[1])
    yield ends
    for fd in ends:
        os.close(fd)


def opened(host, *args, **options):
    server = PySerialServer(*args, **options)
    server.open(host)
    host.until(lambda: server.line.stream is not None, "the opening")
    return server


def test_a_pseudo_terminal_both_ways(host, terminal):
    server = opened(host, os.ttyname(terminal[1]))
    board = SerialLine(terminal[0], owned=False)
    text = bytes(range(256)) * 8
    for i in range(20):
        board.send(text + bytes([i]))
        host.until(lambda i=i: len(host.messages) > i)
        server.send(1, text + bytes([i]))
        messages = []
        while not messages:
            messages = board._read()
        assert host.messages[i] == (1, text + bytes([i])) and messages == [text + bytes([i])]
    assert f"dev: {os.ttyname(terminal[1])}, baudrate: 115200" in host.said()
    server.close()
    server.close()  # close() is idempotent


def test_loop(host):
    """The agent receives its own messages as frames for another address."""
    server = opened(host, "loop://")
    server.send(0, b"to myself")
    host.until(lambda: host.messages == [(0, b"to myself")])
    server.send(5, b"to a board")
    host.until(lambda: server.line.foreign == 1)
    server.close()


def test_a_socket_that_comes_back(host, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(SECONDS)
        server = PySerialServer(f"socket://127.0.0.1:{listener.getsockname()[1]}")
        server.open(host)
        for turn in range(2):
            board = listener.accept()[0]
            host.until(lambda: server.line.stream is not None, "the opening")
            board.sendall(framed(b"turn %d" % turn, 3))
            host.until(lambda turn=turn: host.messages[turn:] == [(3, b"turn %d" % turn)])
            server.send(3, b"yes")
            assert SerialLine(board.fileno(), 3, owned=False)._read() == [b"yes"]
            board.close()
            host.until(lambda turn=turn: host.said().count("device lost") > turn)
            host.fire()
        server.close()
    while host.calls:
        host.fire()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # pyserial 3.5 itself
def test_rfc2217(host):
    """Against pyserial's own server of that protocol, which offers a loop."""
    with Rfc2217() as rfc2217_server:
        server = opened(host, f"rfc2217://127.0.0.1:{rfc2217_server.port}", 57600)
        text = bytes(range(256))  # 255 is Telnet's own escape
        for turn in range(1, 4):
            server.send(0, text)
            host.until(lambda turn=turn: host.messages == [(0, text)] * turn)
        assert rfc2217_server.serial.baudrate == 57600
        server.close()


class Rfc2217:
    """A serial line, loop://, that is offered by RFC 2217 on a port."""

    def __enter__(self):
        import serial
        import serial.rfc2217

        self.serial = serial.serial_for_url("loop://", timeout=0)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(SECONDS)
        self.port = self.listener.getsockname()[1]
        self.thread = threading.Thread(target=self.run, args=(serial.rfc2217.PortManager,))
        self.thread.start()
        return self

    def run(self, manager_of):
        sock = self.listener.accept()[0]

        class Connection:
            def write(self, data):
                sock.sendall(data)

        with sock:
            manager = manager_of(self.serial, Connection())
            while data := sock.recv(1000):
                self.serial.write(b"".join(manager.filter(data)))
                sock.sendall(b"".join(manager.escape(self.serial.read(self.serial.in_waiting))))

    def __exit__(self, *error):
        self.thread.join(SECONDS)
        self.listener.close()
        self.serial.close()


def test_a_device_that_is_unplugged_and_plugged_in_again(tmp_path, monkeypatch):
    monkeypatch.setattr(line_module, "RETRY", 0.01)
    link = tmp_path / "ttyBOARD"
    ends = []

    def plug():
        ends[:] = os.openpty()
        tty.setraw(ends[1])
        link.symlink_to(os.ttyname(ends[1]))
        return SerialLine(ends[0], owned=False)

    def unplug():
        link.unlink()
        for fd in ends:
            os.close(fd)

    with running_agent(PySerialServer(str(link)), "memory") as agent:
        wait_for(agent.said.getvalue, "waiting for device")
        assert f"device: {link}, errno: 2, it is not there: plug the board" in agent.said.getvalue()
        client = XrceClient(plug(), 0xA1)
        wait_for(agent.said.getvalue, "running...")
        assert client.open() == 0
        writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
        client.read(reader)
        for turn in range(1, 4):
            unplug()
            wait_for(agent.said.getvalue, "device lost", turn)
            client.line = plug()
            client.write(writer, bytes([turn]) * 20)  # if lost, the stream sends it again
            assert client.sample(reader) == bytes([turn]) * 20
    unplug()


def test_a_device_that_another_program_has_open(host, terminal):
    device = os.ttyname(terminal[1])
    first = opened(host, device)
    second = PySerialServer(device)
    second.open(host)
    host.until(lambda: "open device error" in host.said())
    assert "in use by another program" in host.said()
    first.close()
    host.until(lambda: not host.writing)
    host.fire()
    host.until(lambda: second.line.stream is not None)
    second.close()


def test_a_device_by_a_file_with_its_name(host, tmp_path, terminal):
    file = tmp_path / "name"
    server = PySerialServer(str(file), is_file=True)
    server.open(host)
    assert "the file with the name of the device does not exist" in host.said()
    file.write_text("nonsense://\n")
    host.fire()
    host.until(lambda: "nonsense" in host.said().split("\n")[-1])
    file.write_text(os.ttyname(terminal[1]) + "\n")
    host.fire()
    host.until(lambda: server.line.stream is not None)
    server.close()


def test_closing_while_the_device_opens(host, monkeypatch):
    """A port that opens slowly is closed after it has opened."""
    begun, go = threading.Event(), threading.Event()
    ports = []

    class Slow:
        def open(self):
            begun.set()
            go.wait(SECONDS)

        def reset_input_buffer(self):
            pass

        baudrate, in_waiting = 115200, 0

        def read(self, size):
            return b""

        def close(self):
            ports.append("closed")

    monkeypatch.setattr(module, "_made", lambda *_: Slow())
    monkeypatch.setattr(module, "_JOIN_SECONDS", 0.0)
    server = PySerialServer("slow")
    server.open(host)
    assert begun.wait(SECONDS)
    thread = server._port._reader
    server.close()
    go.set()
    thread.join(SECONDS)
    assert ports == ["closed"]


class Port:
    """A port that accepts no bytes until ``room`` is set."""

    baudrate = 115200
    write_timeout = 0.005

    def __init__(self):
        self.room, self.fails = threading.Event(), None
        self.incoming, self.written = b"", bytearray()

    def open(self):
        pass

    close = reset_input_buffer = open

    @property
    def in_waiting(self):
        return len(self.incoming)

    def read(self, size):
        if self.fails:
            raise self.fails
        data, self.incoming = self.incoming[:size], self.incoming[size:]
        if not data:
            self.room.wait(0.01)
        return data

    def write(self, data):
        from serial import SerialTimeoutException

        if not self.room.wait(self.write_timeout):
            raise SerialTimeoutException("Write timeout")
        self.written += data
        return len(data)


def test_a_line_that_takes_nothing_loses_messages_and_nothing_waits(host, monkeypatch):
    port = Port()
    port.write_timeout = SECONDS  # what times out is dropped, and would make room
    monkeypatch.setattr(module, "_made", lambda *_: port)
    server = opened(host, "port")
    for _ in range(2000):
        server.send(1, bytes(500))
    line = server.line
    assert line.dropped > 0 and not line.unsent
    assert line.stream.backlog() <= line_module.MAX_UNSENT + 1100
    assert "messages lost" in host.said()
    port.room.set()
    host.until(lambda: line.stream.backlog() == 0, "the room")
    server.send(1, b"now")
    host.until(lambda: bytes(port.written).endswith(framed(b"now", 0, 1)))
    server.close()


def test_received_messages_are_handled_before_the_end_of_the_line(host, monkeypatch):
    port = Port()
    port.incoming = framed(b"x" * 1000, 1) * 50
    monkeypatch.setattr(module, "_made", lambda *_: port)
    server = opened(host, "port")
    host.until(lambda: not port.incoming)
    port.fails = ValueError("a fault of pyserial's own")
    host.until(lambda: "device lost" in host.said())
    assert len(host.messages) == 50
    assert "a fault of pyserial's own; waiting for it to come back" in host.said()
    server.close()


def test_a_flood_is_not_kept(monkeypatch):
    """Messages that are not handled stay in the system's buffer."""
    monkeypatch.setattr(module, "_MAX_INBOX", 10_000)
    port = Port()
    port.incoming = bytes(1_000_000)
    stream = module.ThreadedPort(lambda: port)
    host = BareHost()
    host.watch(stream.fileno(), lambda: None)
    total = 0
    while total < 1_000_000:
        host.turn(SECONDS)
        assert len(stream._inbox) <= 10_000 + 4096
        try:
            total += len(stream.read(4096))
        except BlockingIOError:
            pass
    host.unwatch(stream.fileno())
    stream.close()
    host.close()


def test_modem_lines_are_set_before_opening(monkeypatch):
    port = module._made("loop://", 9600, False, True)
    assert port.dtr is False and port.rts is True and not port.is_open
    assert module._made("/dev/ttyNONE", 9600, None, None).exclusive is True


@pytest.mark.parametrize(
    ("device", "baud", "why"),
    [
        ("nonsense://x", 115200, "nonsense.*pyserial has socket://"),
        ("loop://", 0, "baud rate 0 does not exist"),
        ("loop://", -9600, "baud rate -9600 does not exist"),
    ],
)
def test_invalid_devices_are_refused(device, baud, why):
    for make in (PySerialServer, PySerialPort):
        with pytest.raises(TransportError, match=why):
            make(device, baud)


@pytest.mark.parametrize("module_name", [None, type(os)("serial")])
def test_without_pyserial(monkeypatch, module_name):
    monkeypatch.setitem(sys.modules, "serial", module_name)
    with pytest.raises(TransportError, match="COM3 needs pyserial: python -m pip install pyserial"):
        PySerialServer("COM3")


def test_reasons():
    text = "could not open port 'COM9': FileNotFoundError(2, 'The system cannot find', None, 2)"
    assert reason("COM9", OSError(text))[0] == errno.ENOENT
    text = "could not open port 'COM9': PermissionError(13, 'Access is denied.', None, 5)"
    assert reason("COM9", OSError(text))[0] == errno.EACCES
    assert reason("x", OSError(errno.ENOENT, ""))[1].startswith("errno: 2, it is not there")
    assert reason("x", ValueError()) == (0, "ValueError (see that what offers the line runs)")


# --- a board's end -----------------------------------------------------------------------


def test_the_ports_of_a_board(terminal):
    port = device_port("loop://")
    assert isinstance(port, PySerialPort)
    port = PySerialPort(os.ttyname(terminal[1]))
    with pytest.raises(OSError, match="is not open"):
        port.read(1)
    board = StreamTransport(port)
    board.open()
    board.send(b"to the agent")
    agent = SerialLine(terminal[0], 0, owned=False)
    assert agent._read() == [b"to the agent"]
    assert board.receive(0) is None
    for text in (b"first", b"second"):
        agent.send_raw(framed(text, 0, 1))
        assert board.receive(int(SECONDS * 1000)) == text
    board.close()
    board.close()  # close() is idempotent


def test_the_port_of_a_board_on_a_line_that_accepts_no_bytes(terminal):
    port = PySerialPort(os.ttyname(terminal[1]))
    port.open()
    for _ in range(100):
        assert port.write(bytes(1000)) == 1000  # never blocks for long
    port.close()


def test_the_port_of_a_board_that_does_not_open():
    with pytest.raises(OSError, match="errno: 2, it is not there: plug the board in"):
        PySerialPort("/dev/ttyNONE0").open()
