"""The serial transport of boards, over ports of every kind. Also runs on MicroPython."""

from support.board import pattern
from support.portable import framed

from uros.ticks import ticks_diff, ticks_ms
from uros.transport.serial import StreamTransport
from uros.wire.framing import Deframer


class Port:
    """A port: it reads ``incoming`` in at most ``chunk`` octets, and accepts ``room`` octets."""

    def __init__(self, incoming=b"", chunk=1000, room=1 << 20):
        self.incoming = incoming
        self.chunk = chunk
        self.room = room
        self.written = b""
        self.reads = 0

    def read(self, size):
        self.reads += 1
        size = min(size, self.chunk)
        out, self.incoming = self.incoming[:size], self.incoming[size:]
        return out or None

    def write(self, octets):
        count = min(len(octets), self.room)
        self.room -= count
        self.written += bytes(octets[:count])
        return count or None


def received(transport):
    """Return all received messages."""
    out = []
    while True:
        message = transport.receive(5000 if transport.port.incoming else 0)
        if message is None:
            return out
        out.append(message)


def test_messages_are_sent_and_received_in_frames() -> None:
    messages = [pattern(size, size) for size in (8, 100, 256, 512)] + [b"\x7e\x7d\x7e" * 30]
    line = b"".join([framed(message, 0, 3) for message in messages])
    for chunk in (1, 7, 1000):
        port = Port(line, chunk)
        transport = StreamTransport(port, 3)
        transport.open()
        assert received(transport) == messages
        for message in messages:
            transport.send(message)
        assert port.written == b"".join([framed(message, 3, 0) for message in messages])
        assert transport.dropped == 0 and transport.deframer.crc_errors == 0


def test_foreign_frames_noise_and_damaged_frames_are_skipped() -> None:
    good, foreign = framed(b"goodgood", 0, 1), framed(b"otherone", 0, 2)
    broken = bytearray(good)
    broken[-1] ^= 1
    port = Port(b"Booting~\x7e" + foreign + bytes(broken) + good + b"\x7e\x7e" + good[:9])
    transport = StreamTransport(port)
    transport.open()
    assert received(transport) == [b"goodgood"]
    assert transport.deframer.crc_errors == 1


def test_the_rest_of_a_frame_is_sent_first_and_messages_meanwhile_are_dropped() -> None:
    port = Port(room=10)
    transport = StreamTransport(port)
    transport.open()
    transport.send(pattern(40))
    assert len(port.written) == 10
    transport.send(pattern(50))
    transport.send(pattern(60))
    assert transport.dropped == 2
    for _ in range(9):
        port.room = 5
        assert transport.receive(0) is None
    transport.send(pattern(70, 1))
    port.room = 1000
    transport.receive(0)
    assert Deframer(0).feed(port.written) == [pattern(40), pattern(70, 1)]
    assert transport.dropped == 2


def test_a_port_that_accepts_nothing_loses_the_message() -> None:
    """No reader: the message would be outdated later."""
    port = Port(room=0)
    transport = StreamTransport(port)
    transport.open()
    for _ in range(3):
        transport.send(pattern(40))
    assert transport.dropped == 3
    port.room = 1000
    transport.receive(0)
    transport.send(pattern(50))
    assert Deframer(0).feed(port.written) == [pattern(50)]


def test_a_received_frame_of_many_chunks_is_read_without_waiting() -> None:
    """A frame of many chunks is received with a timeout of 0."""
    line = framed(b"\x7e" * 512, 0, 1)
    transport = StreamTransport(Port(line, 100))
    transport.open()
    assert transport.receive(0) == b"\x7e" * 512


def test_a_message_over_the_mtu_is_not_sent() -> None:
    port = Port()
    transport = StreamTransport(port, mtu=64)
    transport.send(bytes(65))
    assert port.written == b"" and transport.dropped == 1
    transport.send(b"\x7e" * 64)
    assert len(Deframer(0).feed(port.written)) == 1


def test_open_drops_partial_frames() -> None:
    frame = framed(pattern(30), 0, 1)
    port = Port(frame + frame + frame[:20])
    transport = StreamTransport(port)
    transport.open()
    assert transport.receive(0) == pattern(30)
    port.room = 7
    transport.send(pattern(30))
    transport.close()
    port.incoming = frame[20:] + framed(b"freshone", 0, 1)
    port.room = 1000
    written = len(port.written)
    transport.open()
    assert received(transport) == [b"freshone"]
    transport.send(b"freshtoo")
    assert port.written[written:] == framed(b"freshtoo", 1, 0)


def test_open_and_close_call_those_of_the_port() -> None:
    calls = []

    class Opening(Port):
        def open(self):
            calls.append("open")
            if len(calls) == 1:
                raise OSError(2, "not there")

        def close(self):
            calls.append("close")

    transport = StreamTransport(Opening())
    try:
        transport.open()
    except OSError as error:
        assert "not there" in str(error)
    else:
        raise AssertionError("not raised")
    transport.open()
    transport.close()
    assert calls == ["open", "open", "close"]


def took(transport, timeout_ms):
    """Return the milliseconds of a receive without a message."""
    before = ticks_ms()
    assert transport.receive(timeout_ms) is None
    return ticks_diff(ticks_ms(), before)


def test_receive_returns_at_its_timeout() -> None:
    transport = StreamTransport(Port())
    transport.open()
    for timeout in (0, 1, 7, 30):
        assert timeout <= took(transport, timeout) < timeout + 1000


def test_receive_returns_at_its_timeout_despite_continuous_noise() -> None:
    """The peer prints text without end."""

    class Noisy(Port):
        def read(self, size):
            return b"printf"

    transport = StreamTransport(Noisy())
    transport.open()
    assert 20 <= took(transport, 20) < 1020
    assert took(transport, 0) < 1000


def test_receive_calls_wait_of_the_port() -> None:
    waits = []

    class Waiting(Port):
        def wait(self, timeout_ms):
            waits.append(timeout_ms)
            if len(waits) in (2, 7):
                self.incoming = framed(b"whatever", 0, 1)

    port = Waiting()
    transport = StreamTransport(port)
    transport.open()
    assert transport.receive(5000) == b"whatever"
    assert len(waits) == 2 and 2000 < waits[1] <= waits[0] <= 5000
    # A port has no wait for writing: unsent bytes are retried every millisecond.
    port.room = 3
    transport.send(pattern(20))
    assert transport.receive(5000) == b"whatever"
    assert waits[2:] == [1] * 5


def test_a_port_that_fails_raises() -> None:
    class Gone(Port):
        def read(self, size):
            raise OSError(5, "gone")

        write = read

    transport = StreamTransport(Gone())
    for call in (lambda: transport.receive(0), lambda: transport.send(b"12345678")):
        try:
            call()
        except OSError:
            continue
        raise AssertionError("not raised")
