"""Frames over a stream socket: counters, warnings that do not flood, messages that do not fit."""

import os
import random
import socket

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.lines import SerialLine
from support.portable import framed
from unit.agent.transports.bare_host import BareHost

from uros.agent.transports import line as module
from uros.agent.transports.base import ServerTransport
from uros.agent.transports.line import FileStream, Line, LineServer, SocketStream
from uros.agent.transports.serial import PseudoTerminalServer

BAD = framed(b"abcdef", 1)[:-2] + b"\0\0"  # a whole frame with a wrong CRC


class OneLine(ServerTransport):
    name = "TestAgent"

    def __init__(self):
        super().__init__()
        self.why = []
        self.line = Line(self, "/dev/test", lambda source: source, self.why.append)

    def open(self, host):
        self.host = host

    def send(self, peer, datagram):
        self.line.send(peer, datagram)

    def address(self, peer):
        return str(peer)

    def close(self):
        self.line.close()


class Pair:
    """A line and the board's end of the connection."""

    def __init__(self):
        self.host = BareHost()
        self.server = OneLine()
        self.line = self.server.line
        self.server.open(self.host)
        self.plug()

    def plug(self):
        ours, self.board = socket.socketpair()
        ours.setblocking(False)
        self.stream = Counted(SocketStream(ours))
        self.line.open(self.host, self.stream)

    def feed(self, data):
        """Send data; wait until the line has read all of it."""
        expected_count = self.stream.count + len(data)
        self.board.sendall(data)
        self.host.until(lambda: self.stream.count >= expected_count, "what was sent")

    def close(self):
        self.server.close()
        self.board.close()
        self.host.close()


class Counted:
    """A stream that counts what was read from it."""

    def __init__(self, stream):
        self._stream = stream
        self.count = 0

    def read(self, size):
        data = self._stream.read(size)
        self.count += len(data)
        return data

    def __getattr__(self, name):
        return getattr(self._stream, name)


@pytest.fixture
def pair():
    new_pair = Pair()
    yield new_pair
    new_pair.close()


def test_frames_have_their_sources_and_are_counted(pair):
    pair.feed(framed(b"one", 1) + b"printf\n" + framed(b"two", 7) + framed(b"other", 1, 9))
    assert pair.host.messages == [(1, b"one"), (7, b"two")]
    line = pair.line
    assert (line.frames, line.crc_errors, line.foreign, line.skipped) == (2, 0, 1, 7)
    assert pair.host.notes == []


def test_counters_go_on_when_the_line_comes_back_and_half_a_frame_does_not(pair):
    pair.feed(framed(b"one", 1) + BAD + b"xyz" + framed(b"half", 1)[:-3])
    pair.board.close()
    pair.host.until(lambda: pair.server.why, "the end")
    assert pair.server.why == ["end of file"] and pair.line.stream is None
    pair.plug()
    pair.feed(framed(b"half", 1)[-3:] + framed(b"two", 1))
    assert [message[1] for message in pair.host.messages] == [b"one", b"two"]
    line = pair.line
    assert (line.frames, line.crc_errors) == (2, 1)
    assert line.skipped == len(BAD) + 3 + 3


def test_bad_frames_are_logged_at_once_and_then_rarely(pair):
    pair.feed(framed(b"good", 1) * 3 + BAD)
    assert pair.host.warnings() == [
        "TestAgent | bad frames | device: /dev/test, CRC errors: 1 of 4 frames"
        " (noise, or a wrong baud rate?)"
    ]
    pair.feed((framed(b"good", 1) * 7 + BAD * 3) * 4)
    assert len(pair.host.warnings()) == 1
    assert [call[0] for call in pair.host.calls] == [module.QUIET]
    pair.host.fire()
    assert pair.host.warnings()[1:] == [
        "TestAgent | bad frames | device: /dev/test, CRC errors: 12 of 40 frames"
        " (noise, or a wrong baud rate?)"
    ]
    pair.host.fire()  # frames are valid
    assert pair.host.calls == [] and len(pair.host.warnings()) == 2
    pair.feed(BAD)  # and invalid again
    assert len(pair.host.warnings()) == 3
    assert pair.line.crc_errors == 14


def test_bytes_without_frames_are_logged_until_frames_arrive(pair):
    for _ in range(20):
        pair.feed(b"a" * 300)
    assert len(pair.host.warnings()) == 3  # after 512, 1024 and 2048 more
    assert "no frames among the bytes" in pair.host.warnings()[0]
    assert (
        f"device: /dev/test, skipped: 600, crc_errors: 0 (text, such as '{'a' * 40}': the board's"
        " console, or firmware without micro-ROS on this port)"
    ) in pair.host.warnings()[0]
    for _ in range(20):
        pair.feed(b"a" * 300 + framed(b"x", 1))
    assert len(pair.host.warnings()) == 3


NOISE = bytes(range(128, 168))


def test_noise_without_a_frame_is_logged_soon_with_rates_to_try(pair):
    pair.line.baud = 115200
    pair.feed(NOISE[:20])
    assert [call[0] for call in pair.host.calls] == [module.FIRST_LOOK]
    assert pair.host.warnings() == []
    pair.feed(NOISE[20:])
    pair.host.fire()
    assert pair.host.warnings() == [
        "TestAgent | no frames among the bytes | device: /dev/test, skipped: 40, crc_errors: 0"
        " (the board's rate is probably not 115200 baud: try --baudrate 921600, 9600, 57600 or"
        " 460800; or stop this agent, and 'uros doctor --dev /dev/test' finds the rate)"
    ]
    pair.feed(NOISE)
    assert pair.host.calls == [] and len(pair.host.warnings()) == 1


def test_noise_before_the_first_frame_is_no_wrong_rate(pair):
    pair.feed(NOISE)
    pair.feed(framed(b"one", 1))
    pair.host.fire()
    pair.feed(NOISE)
    assert pair.host.warnings() == [] and pair.host.calls == []


def test_a_few_bytes_and_text_at_the_start_of_a_board_are_no_noise(pair):
    pair.feed(NOISE[:3])  # of a cable that is plugged in
    pair.host.fire()
    pair.feed(b"rst:0x1 (POWERON_RESET),boot:0x13\r\n")
    pair.host.fire()
    assert pair.host.warnings() == [] and pair.host.calls == []


def test_noise_of_a_stream_that_is_gone_is_not_logged(pair):
    pair.feed(NOISE)
    pair.board.close()
    pair.plug()
    pair.host.fire()
    assert pair.host.warnings() == []
    pair.feed(NOISE)
    pair.host.fire()
    assert len(pair.host.warnings()) == 1
    assert "(another program than a micro-ROS client?)" in pair.host.warnings()[0]


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from([BAD, framed(b"ok", 3)]))))
def test_any_bytes_are_counted_and_raise_no_error(pieces):
    pair = Pair()
    try:
        for piece in pieces:
            if piece:
                pair.feed(piece)
        pair.feed(framed(b"last", 2))
        assert pair.host.messages[-1] == (2, b"last")
        line = pair.line
        assert line.frames == len(pair.host.messages)
        assert line.skipped >= line.crc_errors * len(BAD) or line.crc_errors
        assert line.skipped <= sum(map(len, pieces))
    finally:
        pair.close()


def test_a_line_that_accepts_no_bytes_loses_whole_messages_and_logs_it(pair):
    payload = random.Random(1).randbytes(512)
    for number in range(3000):
        pair.server.send(1, number.to_bytes(4, "big") + payload)
    line = pair.line
    assert line.dropped > 0 and pair.host.writing[line.stream.fileno()]
    assert len(line.unsent) <= module.MAX_UNSENT + 2 * len(payload) + 20
    assert len(pair.host.warnings()) == 1
    assert "did not take 1 messages" in pair.host.warnings()[0]
    pair.host.fire()
    assert f"did not take {line.dropped - 1} messages" in pair.host.warnings()[1]

    reader = SerialLine(pair.board.fileno(), owned=False)
    os.set_blocking(reader.fd, False)
    messages = []

    def drained():
        try:
            messages.extend(reader._read())
        except BlockingIOError:
            pass
        return not line.unsent

    pair.host.until(drained, "the room")
    while len(messages) < 3000 - line.dropped:
        messages.extend(reader._read())
    numbers = [int.from_bytes(message[:4], "big") for message in messages]
    assert numbers == sorted(set(numbers)) and numbers[0] == 0
    assert all(message[4:] == payload for message in messages)
    assert pair.host.writing[line.stream.fileno()] is False
    pair.server.send(1, b"next")
    assert reader._read() == [b"next"]


def test_waiting_messages_are_dropped_with_the_line(pair):
    for _ in range(500):
        pair.server.send(1, bytes(1000))
    assert pair.line.unsent
    pair.board.close()
    pair.host.until(lambda: pair.server.why, "the end")
    assert not pair.line.unsent
    pair.server.send(1, b"into the void")  # no connection: lost without an error
    pair.plug()
    pair.server.send(1, b"new")
    assert SerialLine(pair.board.fileno(), owned=False)._read() == [b"new"]


def test_the_host_may_close_the_line_while_a_frame_is_handled(pair):
    pair.host.answer = lambda transport, peer, message: transport.close()
    pair.board.sendall(framed(b"one", 1) + framed(b"two", 1))
    pair.host.until(lambda: pair.line.stream is None)
    assert pair.host.messages[0] == (1, b"one")


class Late(LineServer):
    def _begin(self, host):
        pass


def test_a_stream_that_opens_after_the_end_is_closed():
    server = Late("/dev/late")
    server.open(BareHost())
    server.close()
    agent_end, board_end = socket.socketpair()
    server._opened(SocketStream(agent_end), "")
    assert agent_end.fileno() == -1
    board_end.close()
    server._failed(2, "late", "too late")
    assert server._host.notes == [] and server._host.calls == []


def test_a_descriptor_as_a_stream():
    agent_end, board_end = os.openpty()
    os.set_blocking(agent_end, False)
    stream = FileStream(agent_end)
    with pytest.raises(BlockingIOError):
        stream.read(10)
    assert stream.write(bytearray(b"x")) == 1 and stream.backlog() == 0
    stream.close()
    os.close(board_end)


def test_a_line_that_cannot_be_reopened_is_retried(monkeypatch):
    """Any error of reopening, such as exhausted descriptors, is retried."""
    host, server = BareHost(), PseudoTerminalServer()
    server.open(host)
    real, errors = os.openpty, [OSError(24, "Too many open files"), RuntimeError("a driver's")]

    def fails():
        raise errors[0]

    monkeypatch.setattr(os, "openpty", fails)
    server.line.close()
    server._lost("unplugged")
    for _ in range(2):
        host.fire()
        assert len(host.calls) == 1  # once more
        errors.append(errors.pop(0))
    assert "Too many open files" in host.said() and "a driver's" in host.said()
    monkeypatch.setattr(os, "openpty", real)
    host.fire()
    assert host.said().count("running...") == 2
    server.close()
    host.close()
