"""Reliable messages on a serial line that is busy. Also runs on MicroPython."""

from support.board import pattern

from uros.transport.serial import StreamTransport
from uros.wire.framing import Deframer

WINDOW = 16
HEARTBEAT = bytes((0x81, 0, 0, 0, 11, 1, 5, 0, 0, 0, 15, 0, 0x80))


class Port:
    """A port that accepts ``room`` octets; None: without limit."""

    def __init__(self, room):
        self.room = room
        self.written = b""

    def read(self, size):
        return None

    def write(self, octets):
        count = len(octets)
        if self.room is not None:
            count = min(count, self.room)
            self.room -= count
        self.written += bytes(octets[:count])
        return count or None


def reliable(number, size=100):
    """Return a message of a session's reliable stream, with one submessage."""
    head = bytes((0x81, 0x80, number & 0xFF, number >> 8, 13, 1, (size - 8) & 0xFF, size - 8 >> 8))
    return bytearray(head + pattern(size - 8, number))


def busy(room=0, mtu=512):
    transport = StreamTransport(Port(room), mtu=mtu)
    transport.open()
    return transport


def arrived(transport):
    return Deframer(0).feed(transport.port.written)


def test_a_queued_window_is_sent_in_order() -> None:
    for room in (0, 1, 50, 300):
        for step in (1, 7, 256):
            transport = busy(room)
            messages = [reliable(i, 60 + i) for i in range(WINDOW)]
            for message in messages:
                transport.send(message, len(message))
            for _ in range(4000 // step):
                transport.port.room = step
                transport.receive(0)
            assert arrived(transport) == messages
            assert transport.dropped == 0


def test_one_write_window_takes_the_end_of_a_frame_and_the_next_frame() -> None:
    transport = busy(10)
    for i in range(3):
        transport.send(reliable(i), 100)
    transport.port.room = 250
    transport.receive(0)
    assert transport.port.room == 0


def test_only_the_message_of_a_longer_buffer_is_sent() -> None:
    """Buffers of a session may be longer than their message."""
    transport = busy(1)
    first, second = reliable(0, 40), reliable(1, 41)
    transport.send(first + bytes(20), 40)
    transport.send(second + bytes(20), 41)
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [first, second]


def test_a_message_resent_while_queued_is_sent_once() -> None:
    transport = busy(1)
    messages = [reliable(i) for i in range(5)]
    for message in messages + messages[2:]:
        transport.send(message, len(message))
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == messages
    assert transport.dropped == 0


def test_short_messages_are_sent_before_queued_ones() -> None:
    transport = busy(1)
    messages = [reliable(i) for i in range(3)]
    for message in messages:
        transport.send(message, len(message))
    transport.send(HEARTBEAT)
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [messages[0], HEARTBEAT] + messages[1:]


def test_the_queue_of_short_messages_is_limited() -> None:
    transport = busy(1, mtu=64)
    transport.send(b"\x7e" * 64)
    for _ in range(20):
        transport.send(HEARTBEAT)
    assert transport.dropped == 20
    transport = busy(1)
    transport.send(reliable(0))
    for _ in range(200):
        transport.send(HEARTBEAT)
    transport.port.room = None
    transport.receive(0)
    messages = arrived(transport)
    assert messages[0] == reliable(0) and set(messages[1:]) == {HEARTBEAT}
    assert len(messages) + transport.dropped == 201 and transport.dropped > 100


def test_messages_beyond_a_window_are_dropped_and_counted() -> None:
    transport = busy(1)
    for i in range(WINDOW + 4):
        transport.send(reliable(i), 100)
    assert transport.dropped == 3  # one is framed already
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [reliable(i) for i in range(WINDOW + 1)]


def test_messages_of_several_submessages_are_not_queued() -> None:
    """The transport reads the length of a queued message from its only submessage."""
    transport = busy(1)
    transport.send(reliable(0), 100)
    transport.send(reliable(1, 90) + b"\x0b\1\0\0", 94)
    assert transport.dropped == 1


def test_a_reliable_message_over_the_mtu_is_not_sent() -> None:
    transport = busy(None, mtu=64)
    transport.send(reliable(0, 65), 65)
    assert transport.dropped == 1 and arrived(transport) == []
    transport.send(reliable(1, 64), 64)
    assert arrived(transport) == [reliable(1, 64)]


def test_open_drops_queued_messages() -> None:
    transport = busy(3)
    for i in range(5):
        transport.send(reliable(i), 100)
    transport.close()
    transport.port.room = None
    transport.open()
    transport.receive(0)
    transport.send(reliable(9), 100)
    assert arrived(transport) == [reliable(9)]
