"""Serial lines: noise between frames, devices that are missing, not permitted, taken, unplugged."""

import errno
import fcntl
import os
import random
import subprocess
import sys
import termios
import tty
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.agent import RunningAgent, running_agent
from support.client import XrceClient
from support.lines import SECONDS, SerialLine
from unit.agent.helpers import get_info, message
from unit.transport.faults import TYPE, wait_for

from uros.transport import serial as module
from uros.transport.base import TransportError
from uros.transport.serial import LineServer, SerialServer, check_baud_rate, trouble
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
    one = XrceClient(agent.line(number), 0x5E1A0000 + number)
    assert one.open() == ids.STATUS_OK
    return one


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
    one = board(agent)
    writer, reader = one.writer("n", "rt/a", TYPE), one.reader("n", "rt/a", TYPE)
    one.read(reader)
    for i in range(10):
        one.line.send_raw(junk)
        one.write(writer, bytes([i]) * 30)
        assert one.sample(reader) == bytes([i]) * 30


def test_noise_on_a_line_of_two_boards(agent):
    one, two = board(agent, 0), board(agent, 1)
    for i in range(30):
        one.line.send_raw(noise(i, 100))
        assert two.ping() == one.ping() == 1


def test_messages_of_two_boards_in_one_chunk_have_their_own_sources(agent):
    one, two = board(agent, 0), board(agent, 1)
    both = framed(message([get_info(request=1)], 0, 0, 0x81), 1)
    both += framed(message([get_info(request=2)], 0, 0, 0x81), 2)
    one.line.send_raw(both)
    one.until(lambda: one.infos, "no answer for the first")
    two.until(lambda: two.infos, "no answer for the second")
    assert [it[0] for it in one.infos] == [1] and [it[0] for it in two.infos] == [2]


def test_a_line_without_frames_is_told_about_and_not_for_ever(agent):
    line = agent.line()
    for i in range(40):
        line.send_raw(noise(100 + i, 3000).replace(b"\x7e", b"\0"))
    wait_for(agent.said.getvalue, "wrong baud rate")
    one = board(agent)
    assert one.ping() == 1
    assert 1 <= agent.said.getvalue().count("wrong baud rate") <= 8


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
    one = Device(tmp_path)
    yield one
    one.unplug()


@pytest.fixture
def serial(device):
    """Starts an agent on the device."""
    with ExitStack() as stack:

        def start(path=None, is_file=False):
            running = RunningAgent("pseudoterminal", "memory", None, 4)
            transport = SerialServer(str(path or device.link), is_file=is_file)
            running.transport = transport
            running.server.transports[:] = [transport]
            stack.callback(running.close)
            running.thread.start()
            assert running.server.ready.wait(SECONDS)
            return running

        yield start


def test_a_missing_device_is_waited_for_and_said_once(device, serial):
    agent = serial()
    wait_for(agent.said.getvalue, "waiting for device")
    line = device.plug()
    wait_for(agent.said.getvalue, "running...")
    assert XrceClient(line, 0x51).open() == 0
    said = agent.said.getvalue()
    assert said.count("waiting for device") == 1
    assert f"device: {device.link}, errno: 2, it is not there: plug the board in" in said


def test_unplugged_while_open_and_plugged_in_again(device, serial):
    line = device.plug()
    agent = serial()
    one = XrceClient(line, 0x52)
    assert one.open() == 0
    writer, reader = one.writer("n", "rt/a", TYPE), one.reader("n", "rt/a", TYPE)
    one.read(reader)
    for turn in range(1, 4):
        line.send_raw(b"\x7e\x01\x00")  # half a frame
        device.unplug()
        wait_for(agent.said.getvalue, "device lost", turn)
        one.line = line = device.plug()
        # the board was not reset: it goes on in its session
        one.write(writer, bytes([turn]) * 20)
        assert one.sample(reader) == bytes([turn]) * 20
    assert list(agent.agent.clients) == [0x52]
    assert "waiting for it to come back" in agent.said.getvalue()


def test_unplugged_while_there_is_something_to_send(device, serial):
    line = device.plug()
    agent = serial()
    one = XrceClient(line, 0x53)
    assert one.open() == 0
    os.set_blocking(device.master, False)
    try:
        while not agent.transport._unsent:  # nobody reads the answers
            line.send(message([get_info()], 0, 0, 0x81))
    except BlockingIOError:
        pass  # the agent's end is full too
    device.unplug()
    wait_for(agent.said.getvalue, "device lost")
    one.line = device.plug()
    wait_for(agent.said.getvalue, "running...", 2)
    assert one.ping() == 1


def test_a_board_that_comes_back_with_a_new_session(device, serial):
    agent = serial()
    for turn in range(3):
        one = XrceClient(device.plug(), 0x54)
        wait_for(agent.said.getvalue, "running...", turn + 1)
        assert one.open() == 0
        if not turn:
            one.writer("n", "rt/a", TYPE)
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
def test_a_file_that_holds_no_name(serial, tmp_path, content):
    file = tmp_path / "name"
    file.write_bytes(content)
    agent = serial(file, is_file=True)
    wait_for(agent.said.getvalue, f"device: {file}, errno: ")


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_is_no_serial_device(serial, tmp_path, kind):
    path = tmp_path / "thing"
    path.mkdir() if kind == "folder" else path.write_text("")
    agent = serial(path)
    wait_for(agent.said.getvalue, "this is not a serial device")


def test_a_device_that_another_agent_has(device, serial):
    device.plug()
    with open(device.link, "rb", buffering=0) as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        agent = serial()
        wait_for(agent.said.getvalue, "in use by another program, perhaps a second agent")
        assert f"fuser -v {device.link}" in agent.said.getvalue()
    wait_for(agent.said.getvalue, "running...")


def test_two_agents_on_one_device(device, serial):
    line = device.plug()
    first = serial()
    wait_for(first.said.getvalue, "running...")
    one = XrceClient(line, 0x56)
    assert one.open() == 0
    second = serial()
    wait_for(second.said.getvalue, "open device error")
    assert one.ping() == 1


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
from uros.transport.serial import SerialServer

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
def test_errno_13_says_what_to_do(tmp_path):
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


def test_what_each_trouble_says():
    assert trouble("/dev/x", errno.EACCES).startswith("errno: 13, not permitted")
    assert trouble("/dev/x", errno.EIO) == f"errno: {errno.EIO}, {os.strerror(errno.EIO)}"


# --- baud rates --------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [12345, 0, -1, 115201])
def test_a_baud_rate_that_does_not_exist(rate):
    with pytest.raises(TransportError) as caught:
        SerialServer("/dev/null", rate)
    assert f"baud rate {rate} does not exist here; there are " in str(caught.value)
    assert "115200" in str(caught.value)


def test_baud_rates():
    assert check_baud_rate(115200) == termios.B115200


# --- a line that takes nothing -----------------------------------------------------------


class Host:
    def __init__(self):
        self.writing = None

    def watch(self, fileno, ready, writing=False):
        self.writing = writing

    def unwatch(self, fileno):
        self.writing = None


def test_a_line_that_takes_nothing_loses_messages_and_never_half_of_one():
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)

    class Line(LineServer):
        def open(self, host):
            self._host = host

        def address(self, peer):
            return ""

    server = Line()
    server.fd = slave
    host = Host()
    server.open(host)
    reader = SerialLine(master)
    os.set_blocking(master, False)
    try:
        message_ = bytes(range(256)) * 2
        for number in range(2000):
            server.send(1, number.to_bytes(4, "big") + message_)
        assert host.writing
        assert len(server._unsent) <= module.MAX_UNSENT + 2 * len(message_)
        got = []
        while server._unsent:
            got += reader._read()
            server._push()
        while True:
            try:
                got += reader._read()
            except BlockingIOError:
                break
        assert host.writing is False
        numbers = [int.from_bytes(it[:4], "big") for it in got]
        assert numbers == sorted(set(numbers)) and numbers[0] == 0
        assert all(it[4:] == message_ for it in got)
        server.send(1, b"next")
        assert reader._read() == [b"next"]
    finally:
        server.close()
        reader.close()
