"""Serial lines: noise between frames, devices that are missing, not permitted, taken, unplugged."""

import errno
import fcntl
import os
import random
import subprocess
import sys
import termios
import time
import tty
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS, SerialLine
from unit.agent.helpers import get_info, message
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import TYPE, wait_for

from uros.agent.transports import line as module
from uros.agent.transports import serial as serial_module
from uros.agent.transports.base import TransportError
from uros.agent.transports.serial import PseudoTerminalServer, SerialServer, serial_server
from uros.wire import ids
from uros.wire.framing import frame, frame_size

PING = message([get_info()], 0, 0, 0x80)


def framed(payload, source=1, destination=0):
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, source, destination, out)])


# --- a line that carries more than frames ------------------------------------------------


@pytest.fixture(params=["serial", "pseudoterminal"])
def agent(request):
    with running_agent(request.param, "memory") as running:
        yield running


def board(agent, number=0):
    client = XrceClient(agent.line(number), 0x5E1A0000 + number)
    assert client.open() == ids.STATUS_OK
    return client


def noise(seed, size):
    return random.Random(seed).randbytes(size)


@pytest.mark.parametrize(
    "junk",
    [
        b"hello from printf\r\n" * 20,
        bytes(range(256)),
        b"\x7e" * 50,
        b"\x7d" * 50,
        b"\x7e\x7d" * 50,
        framed(PING)[:-1],
        framed(PING)[:-2] + b"\0\0",
        framed(PING, 1, 9),
        b"\x7e\x01\x00\xff\xff" + bytes(300),
        noise(1, 3000),
    ],
    ids=["text", "all", "flags", "escapes", "both", "cut", "crc", "foreign", "long", "random"],
)
def test_noise_between_frames(agent, junk):
    client = board(agent)
    writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
    client.read(reader)
    for i in range(10):
        client.line.send_raw(junk)
        client.write(writer, bytes([i]) * 30)
        assert client.sample(reader) == bytes([i]) * 30


def test_noise_on_a_line_of_two_boards(agent):
    first, second = board(agent, 0), board(agent, 1)
    for i in range(30):
        first.line.send_raw(noise(i, 100))
        assert second.ping() == first.ping() == 1


def test_messages_of_two_boards_in_one_chunk_have_their_own_sources(agent):
    first, second = board(agent, 0), board(agent, 1)
    chunk = framed(message([get_info(request=1)], 0, 0, 0x81), 1)
    chunk += framed(message([get_info(request=2)], 0, 0, 0x81), 2)
    first.line.send_raw(chunk)
    first.until(lambda: first.infos, "no answer for the first")
    second.until(lambda: second.infos, "no answer for the second")
    assert [info[0] for info in first.infos] == [1] and [info[0] for info in second.infos] == [2]


def test_a_line_without_frames_is_logged_a_limited_number_of_times(agent):
    line = agent.line()
    for i in range(40):
        line.send_raw(noise(100 + i, 3000).replace(b"\x7e", b"\0"))
    wait_for(agent.said.getvalue, "no frames among the bytes")
    client = board(agent)
    assert client.ping() == 1
    assert 1 <= agent.said.getvalue().count("no frames among the bytes") <= 8


# --- a device that comes and goes --------------------------------------------------------


class Device:
    """A pseudo-terminal behind a symbolic link, as udev makes them, to plug and unplug."""

    def __init__(self, folder):
        self.link = folder / "ttyBOARD"
        self.master = self.slave = -1

    def plug(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self.slave))
        return SerialLine(self.master, owned=False)

    def unplug(self):
        self.link.unlink(missing_ok=True)
        for fd in (self.slave, self.master):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


@pytest.fixture
def device(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "RETRY", 0.01)
    new_device = Device(tmp_path)
    yield new_device
    new_device.unplug()


@pytest.fixture
def serial(device):
    """Return a function that starts an agent on the device, or on ``path``, with ``options``."""
    with ExitStack() as stack:

        def start(path=None, **options):
            transport = SerialServer(str(path or device.link), **options)
            return stack.enter_context(running_agent(transport, "memory"))

        yield start


def test_a_missing_device_is_awaited_and_logged_once(device, serial):
    agent = serial()
    wait_for(agent.said.getvalue, "waiting for device")
    line = device.plug()
    wait_for(agent.said.getvalue, "running...")
    assert XrceClient(line, 0x51).open() == 0
    log = agent.said.getvalue()
    assert log.count("waiting for device") == 1
    assert f"device: {device.link}, errno: 2, it is not there: plug the board in" in log


def test_unplugged_while_open_and_plugged_in_again(device, serial):
    line = device.plug()
    agent = serial()
    client = XrceClient(line, 0x52)
    assert client.open() == 0
    writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
    client.read(reader)
    for turn in range(1, 4):
        line.send_raw(b"\x7e\x01\x00")  # half a frame
        device.unplug()
        wait_for(agent.said.getvalue, "device lost", turn)
        client.line = line = device.plug()
        # the board was not reset: it goes on in its session
        client.write(writer, bytes([turn]) * 20)
        assert client.sample(reader) == bytes([turn]) * 20
    assert list(agent.agent.clients) == [0x52]
    assert "waiting for it to come back" in agent.said.getvalue()


def test_unplugged_while_messages_wait_to_be_sent(device, serial):
    line = device.plug()
    agent = serial()
    client = XrceClient(line, 0x53)
    assert client.open() == 0
    os.set_blocking(device.master, False)
    try:
        while not agent.transport.line.unsent:  # no one reads the answers
            line.send(message([get_info()], 0, 0, 0x81))
    except BlockingIOError:
        pass  # the agent's buffer is full too
    device.unplug()
    wait_for(agent.said.getvalue, "device lost")
    client.line = device.plug()
    wait_for(agent.said.getvalue, "running...", 2)
    assert client.ping() == 1


def test_a_board_that_comes_back_with_a_new_session(device, serial):
    agent = serial()
    for turn in range(3):
        client = XrceClient(device.plug(), 0x54)
        wait_for(agent.said.getvalue, "running...", turn + 1)
        assert client.open() == 0
        if not turn:
            client.writer("n", "rt/a", TYPE)
        device.unplug()
        wait_for(agent.said.getvalue, "device lost", turn + 1)
    assert len(agent.agent.clients) == 1


def test_a_device_by_a_file_with_its_name(device, serial, tmp_path):
    line = device.plug()
    file = tmp_path / "name"
    file.write_text(f"{device.link}\n")
    agent = serial(file, is_file=True)
    assert XrceClient(line, 0x55).open() == 0
    assert f"dev: {device.link}, baudrate: 115200" in agent.said.getvalue()


@pytest.mark.parametrize("content", [b"\xff\xfe\0", b"", b"\n"])
def test_a_file_without_a_device_name(serial, tmp_path, content):
    file = tmp_path / "name"
    file.write_bytes(content)
    agent = serial(file, is_file=True)
    wait_for(agent.said.getvalue, f"device: {file}, errno: ")


@pytest.mark.parametrize("kind", ["endless", "pipe"])
def test_a_file_that_never_ends_or_never_begins(serial, tmp_path, kind):
    """The thread of the agent neither waits for the file nor reads all of it."""
    file = tmp_path / "name"
    os.mkfifo(file) if kind == "pipe" else file.symlink_to("/dev/zero")
    agent = serial(file, is_file=True)
    wait_for(agent.said.getvalue, f"device: {file}, errno: ")
    # A `pipe` is read again and again; a further read must not block either.
    agent.stop()
    assert not agent.thread.is_alive()


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_path_that_is_no_serial_device(serial, tmp_path, kind):
    path = tmp_path / "thing"
    path.mkdir() if kind == "folder" else path.write_text("")
    agent = serial(path)
    wait_for(agent.said.getvalue, "this is not a serial device")


def test_a_device_that_another_agent_has_open(device, serial):
    device.plug()
    with open(device.link, "rb", buffering=0) as other_file:
        fcntl.flock(other_file, fcntl.LOCK_EX)
        agent = serial()
        wait_for(agent.said.getvalue, "in use by another program, perhaps a second agent")
        assert f"fuser -v {device.link}" in agent.said.getvalue()
    wait_for(agent.said.getvalue, "running...")


def test_two_agents_on_one_device(device, serial):
    line = device.plug()
    first = serial()
    wait_for(first.said.getvalue, "running...")
    client = XrceClient(line, 0x56)
    assert client.open() == 0
    second = serial()
    wait_for(second.said.getvalue, "open device error")
    assert client.ping() == 1


def test_the_line_is_set_up_raw(device, serial):
    device.plug()
    attributes = termios.tcgetattr(device.slave)
    attributes[3] |= termios.ECHO | termios.ICANON
    attributes[2] |= termios.PARENB
    termios.tcsetattr(device.slave, termios.TCSANOW, attributes)
    agent = serial()
    wait_for(agent.said.getvalue, "running...")
    attributes = termios.tcgetattr(device.slave)
    assert not attributes[3] & (termios.ECHO | termios.ICANON)
    assert attributes[4] == attributes[5] == termios.B115200


# --- not permitted -----------------------------------------------------------------------

AS_NOBODY = """
import io, os, sys
from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.server import Server
from uros.middleware.memory import create
from uros.agent.transports.serial import SerialServer

class Said(io.StringIO):
    def write(self, text):
        sys.stderr.write(text)
        if "errno: 13" in text:
            server.stop()
        return len(text)

server = Server(Agent(create(), Log(4, Said())), [SerialServer(sys.argv[1])])
# Only now: nobody may not read where Python and uros live, on many machines.
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
server.run()
"""


@pytest.mark.skipif(os.getuid() != 0, reason="not on this platform: only root can become another")
def test_errno_13_names_the_remedy(tmp_path):
    master, slave = os.openpty()
    try:
        device = os.ttyname(slave)
        os.chmod(device, 0o600)
        source = str(Path(module.__file__).parents[2])
        done = subprocess.run(
            [sys.executable, "-c", AS_NOBODY, device],
            env={**os.environ, "PYTHONPATH": source, "PYTHONDONTWRITEBYTECODE": "1"},
            cwd="/", stderr=subprocess.PIPE, text=True, timeout=SECONDS * 3,
        )  # fmt: skip
    finally:
        os.close(master)
        os.close(slave)
    assert done.returncode == 0, done.stderr
    assert "open device error" in done.stderr
    assert f"device: {device}, errno: 13, not permitted:" in done.stderr
    assert "sudo usermod -aG dialout $USER, then log in again" in done.stderr
    assert f"sudo chmod a+rw {device}" in done.stderr


# --- options -----------------------------------------------------------------------------


@pytest.mark.parametrize("make", [lambda baud: SerialServer("/dev/x", baud), PseudoTerminalServer])
@pytest.mark.parametrize("rate", [0, -1, 10**9])
def test_an_invalid_baud_rate_is_refused(make, rate):
    with pytest.raises(TransportError, match=f"baud rate {rate} does not exist: 1 to"):
        make(rate)


def test_a_custom_rate_and_modem_lines_that_a_line_lacks(device, serial):
    line = device.plug()
    agent = serial(baud=250_000, dtr=True, rts=False)
    assert XrceClient(line, 0x57).open() == 0
    assert (
        f"dev: {device.link}, baudrate: 250000, dtr and rts as they are: this line has none"
        in agent.said.getvalue()
    )


def test_modem_lines_are_set_and_a_device_that_refuses_is_awaited(device, serial, monkeypatch):
    calls = []

    def lines(fd, dtr, rts):
        calls.append((dtr, rts))
        if len(calls) == 1:
            raise OSError(errno.EIO, "gone again")
        return ""

    monkeypatch.setattr(serial_module, "set_modem_lines", lines)
    line = device.plug()
    agent = serial(dtr=False)
    wait_for(agent.said.getvalue, "running...")
    assert XrceClient(line, 0x58).open() == 0
    assert calls == [(False, None)] * 2
    assert "open device error" in agent.said.getvalue()


def test_bytes_from_before_the_agent_opened_the_device_are_dropped(device, serial):
    line = device.plug()
    line.send(message([get_info(request=1)], 0, 0, 0x80))
    line.send_raw(framed(PING)[:-3])
    agent = serial()
    wait_for(agent.said.getvalue, "running...")
    line.send(message([get_info(request=2)], 0, 0, 0x80))
    answer = line.receive(time.monotonic() + SECONDS)
    assert answer[8:10] == b"\x00\x02"
    assert agent.transport.line.skipped == 0


def test_counters_of_a_line(agent):
    client = board(agent)
    line = agent.transport.line
    before = line.frames
    client.line.send_raw(framed(PING)[:-2] + b"\0\0")
    client.line.send_raw(framed(PING, 1, 9))
    assert client.ping() == 1
    assert (line.crc_errors, line.foreign, line.frames) == (1, 1, before + 1)
    wait_for(agent.said.getvalue, "CRC errors: 1 of ")
    wait_for(agent.said.getvalue, "frames (noise, or a wrong baud rate?)")


def test_a_name_that_no_device_can_have(serial):
    agent = serial("/dev/\0x")
    wait_for(agent.said.getvalue, "open device error")


def test_a_system_without_pseudo_terminals(monkeypatch):
    monkeypatch.delattr(os, "openpty")
    with pytest.raises(TransportError, match="no pseudo-terminals: use udp4, tcp4 or serial"):
        PseudoTerminalServer()


def test_without_mounted_pseudo_terminals_the_error_has_the_remedy(monkeypatch):
    """Linux has no such device in a chroot without /dev/pts."""

    def openpty():
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(os, "openpty", openpty)
    host, server = BareHost(), PseudoTerminalServer()
    server.open(host)
    assert "mount --bind /dev/pts" in host.said()
    server.close()
    host.close()


def test_the_server_class_for_each_device():
    kinds = {
        "/dev/ttyUSB0": "SerialServer",
        "socket://127.0.0.1:3333": "SocketLineServer",
        "loop://": "PySerialServer",
        "rfc2217://127.0.0.1:2217": "PySerialServer",
    }
    for name, kind in kinds.items():
        assert type(serial_server(name)).__name__ == kind
    assert isinstance(serial_server("socket://x", is_file=True), SerialServer)


WITHOUT_TERMIOS = """
import sys
import serial  # its own import of termios, on this system
for name in ("termios", "tty", "pty", "fcntl"):
    sys.modules[name] = None  # as on Windows
import select
del select.poll
import uros.agent.transports.serial, uros.agent.transports.multiserial, uros.agent.transports.rfcomm
import uros.agent.transports.portable_serial
from uros.agent.transports.base import TransportError
from uros.transport.serial_host import device_port
from uros.agent.transports.serial import PseudoTerminalServer, SerialServer, serial_server

print(type(serial_server("loop://")).__name__)
print(type(device_port("loop://")).__name__)
import os
os.openpty = None
del os.openpty
for make in (PseudoTerminalServer, lambda: SerialServer("COM3")):
    try:
        make()
    except TransportError as error:
        print(error.strerror)
"""


def test_a_system_without_termios():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TERMIOS],
        env={**os.environ, "PYTHONPATH": str(Path(module.__file__).parents[2])},
        capture_output=True, text=True, timeout=SECONDS * 3,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "PySerialServer",
        "PySerialPort",
        "this system has no pseudo-terminals: use udp4, tcp4 or serial (on Windows a pair of"
        " virtual COM ports does the same)",
        "this system has no termios: use serial_server, and install pyserial",
    ]
