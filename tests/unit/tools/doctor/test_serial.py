"""`uros doctor`: faults of serial devices and lines, planted on terminals and a faked UART."""

import errno
import grp
import os
import shlex
import subprocess
import sys
import time
import tty
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.portable import framed

from uros.agent.transports.line_faults import RATES
from uros.agent.transports.terminal import open_device
from uros.tools.doctor import process as doctor_process
from uros.tools.doctor import serial
from uros.tools.doctor.serial import NOISE, SILENCE, SOUND, TEXT, check_device, check_line


@pytest.fixture
def terminal():
    """(master, name) of a pseudo-terminal: the board's end, and the agent's device."""
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    os.close(master)


def only(findings):
    (one,) = findings
    return one


@contextmanager
def holder(device, name="holder.py"):
    """A process that has the device open; it is there when the block begins."""
    code = (
        f"import os, sys; fd = os.open({device!r}, os.O_RDWR); print(1, flush=True); os.read(0, 1)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.communicate()


# --- the device -------------------------------------------------------------------------------


def test_a_healthy_device(terminal):
    assert only(check_device(terminal[1])).state == "ok"


def test_a_missing_device(tmp_path):
    gone = str(tmp_path / "ttyACM0")
    one = only(check_device(gone, known=lambda: []))
    assert one.state == "problem" and "unplugged" in one.what
    assert "ls /dev/ttyACM*" in one.fix
    one = only(check_device(gone, known=lambda: ["/dev/ttyACM1", "/dev/ttyUSB0"]))
    assert "/dev/ttyACM1, /dev/ttyUSB0" in one.what
    assert "--dev /dev/ttyACM1" in one.fix


def test_the_command_for_a_missing_device_names_one_that_works(tmp_path, terminal):
    (tmp_path / "by-id").mkdir()
    named = tmp_path / "by-id" / "usb-Board-if00"
    named.symlink_to(terminal[1])
    known = serial.ports([terminal[1]], str(tmp_path / "by-id"))
    assert known == [str(named)]
    one = only(check_device("/dev/no-such-board", known=lambda: known))
    device = one.fix.split("--dev ")[1]
    assert only(check_device(device)).state == "ok"


def test_a_link_to_a_board_that_was_unplugged(tmp_path):
    link = tmp_path / "my_board"
    link.symlink_to("/dev/ttyACM9")
    one = only(check_device(str(link), known=lambda: []))
    assert one.state == "problem" and "/dev/ttyACM9, which is gone" in one.what


@pytest.mark.parametrize("make, kind", [("touch", "a file"), ("mkdir", "a folder"),
                                        ("mkfifo", "a pipe")])  # fmt: skip
def test_files_that_are_no_devices(tmp_path, make, kind):
    path = tmp_path / "it"
    subprocess.run([make, path], check=True)
    one = only(check_device(str(path), known=lambda: []))
    assert one.state == "problem" and f"is {kind}, not a serial device" in one.what


def test_a_character_device_that_is_no_terminal():
    one = only(check_device("/dev/null", known=lambda: []))
    assert one.state == "problem" and "not a serial device" in one.what
    assert "kill" not in one.fix  # half of all processes hold it


def test_the_terminal_that_the_doctor_runs_in(terminal):
    """Nobody is told to end his own shell."""
    code = (
        "from uros.tools.doctor.serial import check_device\n"
        f"print(check_device({terminal[1]!r}, known=lambda: []))"
    )
    with open(terminal[1], "rb", buffering=0) as stdin:
        said = subprocess.run(
            [sys.executable, "-c", code], stdin=stdin, capture_output=True, text=True, check=True
        ).stdout
    assert "this terminal" in said and "kill" not in said


def test_invalid_names_and_remote_lines():
    assert only(check_device("a\0b", known=lambda: [])).state == "problem"
    assert only(check_device("socket://10.0.0.1:4000")).state == "unknown"


def as_nobody(device, groups):
    """What a user without rights finds out about the device: in a child, by its exit's words."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            os.setgroups(groups)
            os.setgid(65534)
            os.setuid(65534)
            one = check_device(device, known=lambda: [])[-1]
            os.write(writing, "\n".join([one.state, one.what, one.fix]).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading) as said:
        told = said.read()
    os.waitpid(pid, 0)
    return told.split("\n")


@pytest.mark.skipif(os.getuid() != 0, reason="not on this platform: takes root to be nobody")
def test_no_permission_by_the_group(terminal):
    gid = grp.getgrnam("dialout").gr_gid
    os.chown(terminal[1], 0, gid)
    os.chmod(terminal[1], 0o660)
    state, what, fix = as_nobody(terminal[1], [])
    assert state == "problem" and "its group is dialout" in what
    assert fix == "sudo usermod -aG dialout $USER, then log out and in again"
    # What that command does to the next session:
    assert as_nobody(terminal[1], [gid])[0] == "ok"


@pytest.mark.skipif(os.getuid() != 0, reason="not on this platform: takes root to be nobody")
def test_no_permission_for_anybody(terminal):
    os.chmod(terminal[1], 0o600)
    state, what, fix = as_nobody(terminal[1], [])
    assert state == "problem" and terminal[1] in what
    subprocess.run(shlex.split(fix.removeprefix("sudo ")), check=True)
    assert as_nobody(terminal[1], [])[0] == "ok"


def test_a_busy_device(terminal):
    with holder(terminal[1]) as process:
        one = check_device(terminal[1])[-1]
        assert one.state == "problem" and one.check == "busy"
        assert f"(pid {process.pid})" in one.what
        assert one.fix == f"kill {process.pid}"
        subprocess.run(shlex.split(one.fix), check=True)
        process.wait(10)
        assert check_device(terminal[1])[-1].state == "ok"


def test_a_device_of_a_uros_agent(terminal):
    with holder(terminal[1]) as process:
        one = check_device(terminal[1], {process.pid})[-1]
        assert one.state == "note" and "served by a uros agent" in one.what


def test_a_busy_device_whose_holder_is_hidden(terminal, monkeypatch):
    """Another user's agent: its lock is felt, its descriptors are not seen."""
    monkeypatch.setattr(doctor_process, "holders_of_file", lambda path: [])
    fd = open_device(terminal[1], 115200)
    try:
        one = check_device(terminal[1])[-1]
    finally:
        os.close(fd)
    assert one.state == "problem" and "in use by another program" in one.what
    assert f"fuser -v {terminal[1]}" in one.fix
    assert check_device(terminal[1])[-1].state == "ok"


def test_modem_manager(terminal, monkeypatch, tmp_path):
    manager = doctor_process.Process(77, "ModemManager")
    monkeypatch.setattr(doctor_process, "running", lambda name: manager)
    monkeypatch.setattr(os.path, "realpath", lambda path: "/dev/ttyACM3")
    monkeypatch.setattr(doctor_process, "holders_of_file", lambda path: [])
    hint, rest = check_device(terminal[1])
    assert hint.state == "note" and "systemctl disable --now ModemManager" in hint.fix
    assert rest.state == "ok"
    monkeypatch.setattr(doctor_process, "holders_of_file", lambda path: [manager])
    one = only(check_device(terminal[1]))
    assert one.state == "problem" and one.fix == "sudo systemctl disable --now ModemManager"


def test_brltty_where_the_board_should_be(monkeypatch):
    monkeypatch.setattr(doctor_process, "running", lambda name: doctor_process.Process(5, name))
    one = only(check_device("/dev/ttyUSB99", known=lambda: []))
    assert "brltty" in one.what and "sudo apt remove brltty" in one.fix


# --- processes ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command, ours, foreign",
    [
        (["/usr/bin/python3", "/home/me/uros/bin/uros", "agent", "udp4"], True, False),
        (["/usr/bin/python3", "-m", "uros", "agent", "udp4"], True, False),
        (["/usr/bin/python3", "/home/me/uros/bin/uros", "topic", "hz"], False, False),
        (["/usr/bin/python3", "/home/me/uros/bin/MicroXRCEAgent", "udp4"], True, False),
        (["/opt/bin/MicroXRCEAgent", "udp4", "-p", "8888"], False, True),
        (["/opt/lib/micro_ros_agent/micro_ros_agent", "udp4"], False, True),
        (["minicom", "-D", "/dev/ttyACM0"], False, False),
        ([], False, False),
    ],
)
def test_the_owner_of_a_process(command, ours, foreign):
    name = os.path.basename(command[0]) if command else "?"
    one = doctor_process.Process(5, name, tuple(command))
    assert (one.is_uros_agent, one.is_foreign_agent) == (ours, foreign)


def test_a_process_that_has_ended():
    assert doctor_process.process(2**22 + 1).name == "?"
    assert doctor_process.environment(2**22 + 1) is None
    assert doctor_process.running("no-such-program") is None


# --- the line -----------------------------------------------------------------------------------


def wait(milliseconds):
    """Time passes on a line on which nothing comes."""
    time.sleep(milliseconds / 1000)


class Uart:
    """A line on which a board sends at ``rate``; at any other, bytes come out mangled."""

    def __init__(self, data, rate, refuses=(), gone=False):
        self.data, self.rate = data, rate
        self.refuses, self.gone = refuses, gone
        self.rates = []
        self.closed = False

    def open(self, rate):
        if rate in self.refuses:
            raise OSError(errno.EINVAL, "the device does not do this rate")
        self.rates.append(rate)
        self.left = self.data

    def read(self, timeout_ms):
        if self.gone:
            raise OSError(errno.EIO, "the line has ended")
        if not self.left:
            wait(timeout_ms)
            return b""
        data, self.left = self.left, b""
        if self.rates[-1] == self.rate:
            return data
        step = 3 if self.rates[-1] > self.rate else 2
        return bytes((byte * 171 ^ 0xA5) & 0xFF for byte in data[::step])

    def close(self):
        self.closed = True


FRAMES = b"".join(framed(bytes([0x80, 0, 0, 0, n]) * 4, 1) for n in range(8))


def look(uart, baud=115200, **options):
    said = []
    one = check_line("/dev/ttyX", uart, baud, 0.01, said.append, **options)
    assert uart.closed
    return one, said


def test_a_healthy_line():
    one, said = look(Uart(FRAMES, 115200))
    assert one.state == "ok" and "sound XRCE frames" in one.what
    assert said == ["listening on /dev/ttyX at 115200 baud for 0.01 s"]


@pytest.mark.parametrize("rate", [rate for rate in RATES if rate != 115200])
def test_the_wrong_baud_rate(rate):
    uart = Uart(FRAMES, rate)
    one, said = look(uart)
    assert one.state == "problem" and f"sends at {rate} baud, not at 115200" in one.what
    assert one.fix == f"uros agent serial --dev /dev/ttyX --baudrate {rate}"
    assert said[-1] == f"no frames; trying {rate} baud"
    # The command's own rate is right.
    assert look(Uart(FRAMES, rate), int(one.fix.split()[-1]))[0].state == "ok"


def test_an_unusual_rate():
    one, _ = look(Uart(FRAMES, 250001, refuses=(1500000, 2000000)))
    assert one.state == "problem" and "nor at the usual rates" in one.what
    assert "1500000" in one.what and "2000000" in one.what
    assert "--baudrate N" in one.fix


def test_only_text():
    one, _ = look(Uart(b"I (512) wifi: connected, ip 192.168.4.2\r\n" * 4, 115200))
    assert one.state == "problem" and "only text" in one.what and "wifi: connected" in one.what
    one, _ = look(Uart(b"ets Jun  8 2016 00:22:57\r\nrst:0x1 (POWERON_RESET)\r\n", 9600))
    assert "only text" in one.what and "9600 baud" in one.what


def test_text_between_frames_is_no_fault():
    assert look(Uart(b"boot: ok\r\n" + FRAMES + b"sent\r\n", 115200))[0].state == "ok"


def test_silence():
    one, _ = look(Uart(b"", 115200))
    assert one.state == "problem" and "nothing came" in one.what
    assert "reset button" in one.fix and "uros doctor --dev /dev/ttyX" in one.fix


def test_a_line_with_many_broken_frames():
    broken = bytearray(FRAMES)
    size = len(FRAMES) // 8
    for at in range(0, len(broken), 2 * size):
        broken[at + 6] ^= 1
    one, _ = look(Uart(bytes(broken), 115200))
    assert one.state == "problem" and "are broken" in one.what and "cable" in one.fix


def test_a_line_that_is_unplugged_meanwhile():
    one, _ = look(Uart(FRAMES, 115200, gone=True))
    assert one.state == "unknown" and "the line has ended" in one.what
    assert look(Uart(b"", 1, refuses=(115200,)))[0].state == "unknown"


def test_a_board_on_a_pseudo_terminal(terminal):
    os.write(terminal[0], b"old news")  # dropped by the opening
    line = serial.DeviceLine(terminal[1])
    line.open(115200)
    os.write(terminal[0], FRAMES)
    heard = b""
    while len(heard) < len(FRAMES):
        heard += line.read(2000)
    assert heard == FRAMES
    line.open(250000)  # the same descriptor, another rate
    os.write(terminal[0], b"text")
    assert line.read(2000) == b"text"
    assert line.read(1) == b""
    line.close()
    line.close()


def test_a_device_that_cannot_be_opened_says_why():
    with pytest.raises(OSError, match="not a serial device"):
        serial.DeviceLine("/dev/null").open(115200)


@given(st.binary(max_size=300))
def test_any_octets_are_classified(data):
    heard = serial.judge(data)
    assert heard.kind in (SOUND, TEXT, NOISE, SILENCE) and heard.size == len(data)
    assert (heard.kind == SILENCE) == (not data)
