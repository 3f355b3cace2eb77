"""The USB device and its port, on real pseudo-terminals."""

import errno
import os
import select
import sys
import threading
import tty

import pytest

from uros.boards.virtual.hardware.clock import BoardClock, ManualClock
from uros.boards.virtual.hardware.usb import (
    ATTACHED,
    CONFIGURATION_DESCRIPTOR,
    CONFIGURED,
    DETACHED,
    DEVICE_DESCRIPTOR,
    ENUMERATION_US,
    RECEIVE_BUFFER,
    STRINGS,
    SUSPENDED,
    UsbCdc,
)
from uros.boards.virtual.hardware.usb_descriptors import PACKET

SECONDS = 20.0  # the longest wait for an event that must come


class Program:
    """A program on the host that has the port open."""

    def __init__(self, usb, flushes=True):
        self.fd = os.open(usb.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        if flushes:
            tty.setraw(self.fd)

    def read(self, size=4096):
        try:
            return os.read(self.fd, size)
        except BlockingIOError:
            return b""

    def receive(self, size):
        """Wait for exactly ``size`` bytes, and return them."""
        out = b""
        while len(out) < size:
            assert select.select([self.fd], [], [], SECONDS)[0]
            out += os.read(self.fd, size - len(out))
        return out

    def write(self, data):
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def hung_up(self):
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        return any(events & select.POLLHUP for _, events in poll.poll(0))

    def close(self):
        os.close(self.fd)


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def usb(clock, tmp_path):
    usb = UsbCdc(clock, tmp_path / "ttyACM0")
    yield usb
    usb.close()


def switch_on(usb):
    usb.enable(DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR, STRINGS)


@pytest.fixture
def on(usb, clock):
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == CONFIGURED
    return usb


@pytest.fixture
def program(on):
    program = Program(on)
    yield program
    program.close()


def take(usb, size):
    """Wait for ``size`` bytes on the board, and return them."""
    out = b""
    while len(out) < size:
        assert usb.any() or usb.wait(SECONDS)
        out += usb.read(size - len(out))
    return out


# Enumeration.


def test_the_device_is_configured_after_enumeration(usb, clock):
    assert usb.state == DETACHED
    switch_on(usb)
    assert usb.state == ATTACHED
    clock.advance(ENUMERATION_US - 1)
    assert usb.state == ATTACHED and not usb.path.is_symlink() and usb.identity is None
    clock.advance(1)
    assert usb.state == CONFIGURED
    assert usb.identity.product_name == "RA6M5 Sensor Node"
    assert usb.path.resolve().is_char_device()


def test_without_mounted_pseudo_terminals_the_error_has_the_remedy(usb, clock, monkeypatch):
    """Linux has no such device in a chroot without /dev/pts."""

    def openpty():
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(os, "openpty", openpty)
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == ATTACHED and "mount --bind /dev/pts" in usb.error


def test_wrong_descriptors_are_not_configured(usb, clock):
    usb.enable(DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR[:-1], STRINGS)
    clock.advance(10 * ENUMERATION_US)
    assert usb.state == ATTACHED
    assert usb.error == "configuration descriptor: it says 67 bytes and has 66"
    assert not usb.path.is_symlink()
    assert usb.write(b"x") == 0 and usb.read(1) == b""
    switch_on(usb)
    assert usb.error == ""
    clock.advance(ENUMERATION_US)
    assert usb.state == CONFIGURED


def test_enabled_without_a_cable(usb, clock):
    usb.unplug()
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == DETACHED
    usb.plug()
    assert usb.state == ATTACHED
    clock.advance(ENUMERATION_US)
    assert usb.state == CONFIGURED


def test_disabled(on, program):
    on.disable()
    assert on.state == DETACHED and program.hung_up() and not on.path.is_symlink()


def test_enabling_again_enumerates_again(on, program, clock):
    switch_on(on)
    assert on.state == ATTACHED and program.hung_up()
    clock.advance(ENUMERATION_US)
    assert on.state == CONFIGURED


def test_a_missing_folder_is_reported(clock, tmp_path):
    folder = tmp_path / "missing"
    with pytest.raises(FileNotFoundError, match="missing: create it"):
        UsbCdc(clock, folder / "line")
    folder.mkdir()
    usb = UsbCdc(clock, folder / "line")
    folder.rmdir()
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == ATTACHED and "missing" in usb.error
    usb.close()


def test_a_file_is_not_replaced(clock, tmp_path):
    path = tmp_path / "notes"
    path.write_text("mine")
    with pytest.raises(FileExistsError, match="notes"):
        UsbCdc(clock, path)
    assert path.read_text() == "mine"


def test_a_link_left_behind_is_replaced(clock, tmp_path):
    path = tmp_path / "line"
    path.symlink_to(tmp_path / "gone")
    usb = UsbCdc(clock, path)
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == CONFIGURED and path.resolve().is_char_device()
    path.unlink()
    path.symlink_to("/dev/null")  # another program's link by now
    usb.close()
    assert os.readlink(path) == "/dev/null"


def test_by_default_the_link_is_in_a_temporary_folder(clock):
    usb = UsbCdc(clock, name="node")
    folder = usb.path.parent
    assert usb.path.name == "node" and folder.is_dir()
    usb.close()
    usb.close()
    assert not folder.exists()


# Data.


@pytest.mark.skipif(sys.platform != "linux", reason="not on this platform: only Linux tells")
def test_the_port_is_open_while_a_program_has_it_open(on):
    assert not on.is_open()
    for _ in range(3):
        program = Program(on)
        assert on.is_open()
        program.close()
        assert not on.is_open()


def test_every_byte_passes_both_ways(on, program):
    data = bytes(range(256))
    assert on.write(data) == 256
    assert program.receive(256) == data
    assert program.write(data) == 256
    assert take(on, 256) == data


def test_the_line_is_raw_before_a_program_sets_it(on):
    fd = os.open(on.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        os.write(fd, b"a\r\n\x03\x04")
        assert take(on, 5) == b"a\r\n\x03\x04"
        on.write(b"\n")
        assert os.read(fd, 10) == b"\n"
    finally:
        os.close(fd)


def test_a_read_returns_what_has_arrived(on, program):
    assert on.read(10) == b"" and on.any() == 0
    program.write(b"hello")
    assert on.wait(SECONDS)
    take(on, 1)
    assert on.any() == 4
    assert on.read(2) == b"el" and on.read(10) == b"lo" and on.any() == 0


def test_unread_data_is_held_back_and_not_lost(on, program):
    sent = 0
    pattern = bytes(range(251))
    stream = pattern * 1000
    while count := program.write(stream[sent : sent + 1000]):
        sent += count
        assert on.any() <= RECEIVE_BUFFER
        assert sent < 200_000, "nothing holds the program back"
    assert RECEIVE_BUFFER - PACKET < on.any() <= RECEIVE_BUFFER
    assert take(on, sent) == stream[:sent]
    assert program.write(b"more") == 4
    assert take(on, 4) == b"more"


def test_a_packet_is_received_when_the_largest_one_fits(on, program):
    program.write(b"x" * (RECEIVE_BUFFER - PACKET + 1))
    while on.any() < RECEIVE_BUFFER - PACKET + 1:
        assert on.wait(SECONDS)
    program.write(b"y")
    assert on.any() == RECEIVE_BUFFER - PACKET + 1
    on.read(1)
    assert take(on, RECEIVE_BUFFER - PACKET + 1).endswith(b"xy")


def test_writes_do_not_wait_for_a_program_that_does_not_read(on, program):
    sent = 0
    pattern = bytes(range(251))
    stream = pattern * 1000
    while count := on.write(stream[sent : sent + 1000]):
        sent += count
        assert sent < 200_000
    assert on.write(b"x") == 0
    assert program.receive(sent) == stream[:sent]
    assert on.write(b"more") == 4
    assert program.receive(4) == b"more"


def test_without_a_program_nothing_is_sent(on):
    assert on.write(b"stale") == 0
    program = Program(on)
    assert program.read() == b""
    assert on.write(b"fresh") == 5
    assert program.receive(5) == b"fresh"
    program.close()
    assert on.write(b"stale") == 0


def test_data_that_a_program_left_unread_is_discarded(on):
    program = Program(on)
    assert on.is_open()
    assert on.write(b"stale" * 100) == 500
    program.close()
    assert not on.is_open()
    program = Program(on, flushes=False)
    assert program.read() == b""
    assert on.write(b"fresh") == 5
    assert program.receive(5) == b"fresh"
    program.close()


def test_data_that_a_program_sent_before_it_closed_arrives(on):
    program = Program(on)
    program.write(b"last words")
    program.close()
    assert take(on, 10) == b"last words"


# The cable.


def test_unplugging_hangs_up(on, program):
    program.write(b"in flight")
    assert on.wait(SECONDS) and on.any()
    on.unplug()
    assert on.state == DETACHED and not on.plugged
    assert program.hung_up()
    with pytest.raises(OSError) as caught:
        os.write(program.fd, b"x")
    assert caught.value.errno == errno.EIO
    assert not on.path.is_symlink()
    assert (on.any(), on.read(10), on.write(b"x"), on.is_open()) == (0, b"", 0, False)
    on.unplug()


def test_plugging_in_again_is_a_new_line_under_the_same_name(on, program, clock):
    path = on.path
    on.unplug()
    on.plug()
    assert on.state == ATTACHED
    clock.advance(ENUMERATION_US)
    assert on.state == CONFIGURED and on.path == path
    second = Program(on)
    assert on.write(b"again") == 5
    assert second.receive(5) == b"again"
    second.write(b"yes")
    assert take(on, 3) == b"yes"
    second.close()


def test_plugging_in_twice_has_no_effect(on, program):
    on.plug()
    assert on.state == CONFIGURED and not program.hung_up()


def test_suspended_data_waits(on, program):
    on.suspend()
    on.suspend()
    assert on.state == SUSPENDED and on.is_open() and not program.hung_up()
    assert on.write(b"x") == 0
    program.write(b"waiting")
    assert on.any() == 0 and on.read(10) == b""
    on.resume()
    assert on.state == CONFIGURED
    assert take(on, 7) == b"waiting"
    assert on.write(b"x") == 1


def test_suspending_an_unconfigured_device_has_no_effect(usb, clock):
    usb.suspend()
    switch_on(usb)
    usb.suspend()
    clock.advance(ENUMERATION_US)
    assert usb.state == CONFIGURED


def test_a_device_that_is_plugged_in_again_is_not_suspended(on, clock):
    on.suspend()
    on.unplug()
    on.plug()
    clock.advance(ENUMERATION_US)
    assert on.state == CONFIGURED and not on.suspended


# Waiting.


def settle(usb):
    """Consume all changes up to now."""
    while usb.wait(0):
        pass


def test_a_wait_without_an_event_lasts_its_timeout(on, clock):
    for program in (None, Program(on)):
        on.is_open()
        settle(on)
        before = clock.world_us()
        assert on.wait(1.5) is False
        assert clock.world_us() - before == 1_500_000
        if program:
            program.close()


def test_a_wait_ends_enumeration(usb, clock):
    switch_on(usb)
    settle(usb)
    assert usb.wait(10) is True
    assert usb.state == CONFIGURED
    assert clock.world_us() == pytest.approx(ENUMERATION_US, abs=1)


@pytest.mark.parametrize("action", ["unplug", "suspend", "close_program", "disable"])
def test_a_wait_ends_at_a_change(on, action):
    program = Program(on)
    on.is_open()
    settle(on)
    if action == "close_program":
        program.close()
    else:
        getattr(on, action)()
    assert on.wait(SECONDS) is True
    assert on.wait(0) is False
    if action != "close_program":
        program.close()


def test_a_suspended_line_is_not_waited_on(on, program, clock):
    on.suspend()
    settle(on)
    program.write(b"x")
    assert on.wait(1) is False
    on.resume()
    assert on.wait(0) is True
    assert on.read(1) == b"x"


class Counting(BoardClock):
    """A real clock that counts waits, and sets ``waiting`` when one begins."""

    def __init__(self):
        super().__init__()
        self.waits = 0
        self.waiting = threading.Event()

    def select(self, fds, seconds):
        self.waits += 1
        self.waiting.set()
        return super().select(fds, seconds)


@pytest.fixture
def live(tmp_path):
    clock = Counting()
    usb = UsbCdc(clock, tmp_path / "live")
    switch_on(usb)
    while usb.state != CONFIGURED:
        usb.wait(1)
    program = Program(usb)
    usb.is_open()
    settle(usb)
    clock.waits = 0
    clock.waiting.clear()
    yield usb, program, clock
    program.close()
    usb.close()


@pytest.mark.parametrize("action", ["write", "close_program", "unplug", "suspend", "close"])
def test_a_wait_is_ended_from_outside_and_does_not_spin(live, action):
    usb, program, clock = live
    result = []
    thread = threading.Thread(target=lambda: result.append(usb.wait(SECONDS)))
    thread.start()
    assert clock.waiting.wait(SECONDS)
    if action == "write":
        program.write(b"x")
    elif action == "close_program":
        os.close(program.fd)
    else:
        getattr(usb, action)()
    thread.join(SECONDS)
    assert result == [True]
    assert clock.waits <= 3
    if action == "close_program":
        program.fd = os.open(os.devnull, os.O_RDONLY)


def test_a_closed_port_does_not_spin_and_its_first_byte_ends_a_wait(live):
    usb, program, clock = live
    program.close()
    usb.is_open()
    settle(usb)
    assert usb.wait(0.05) is False
    assert clock.waits <= 4
    clock.waiting.clear()
    result = []
    thread = threading.Thread(target=lambda: result.append(usb.wait(SECONDS)))
    thread.start()
    assert clock.waiting.wait(SECONDS)
    program.fd = Program(usb).fd
    program.write(b"x")
    thread.join(SECONDS)
    assert result == [True]
    assert take(usb, 1) == b"x"


def test_a_closed_device_stays_detached(usb, clock):
    switch_on(usb)
    usb.close()
    usb.plug()
    switch_on(usb)
    clock.advance(ENUMERATION_US)
    assert usb.state == DETACHED
    assert usb.wait(1) is True


def test_no_descriptor_leaks(clock, tmp_path):
    def descriptors():
        return len(os.listdir("/dev/fd"))

    before = descriptors()
    usb = UsbCdc(clock, tmp_path / "line")
    for _ in range(5):
        switch_on(usb)
        clock.advance(ENUMERATION_US)
        assert usb.state == CONFIGURED
        usb.unplug()
        usb.plug()
        clock.advance(ENUMERATION_US)
        assert usb.state == CONFIGURED
    usb.close()
    assert descriptors() == before
