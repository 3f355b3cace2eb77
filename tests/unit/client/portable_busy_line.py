"""Reliable messages and a line that has no room for them now. Also runs on MicroPython."""

from support.board import pattern

from uros.transport.serial import StreamTransport
from uros.wire.framing import Deframer

WINDOW = 16
HEARTBEAT = bytes((0x81, 0, 0, 0, 11, 1, 5, 0, 0, 0, 15, 0, 0x80))


class Port:
    """A line that takes ``room`` octets; None: whatever it gets."""

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
    """A message of a session's reliable stream, with one submessage."""
    head = bytes((0x81, 0x80, number & 0xFF, number >> 8, 13, 1, (size - 8) & 0xFF, size - 8 >> 8))
    return bytearray(head + pattern(size - 8, number))


def busy(room=0, mtu=512):
    transport = StreamTransport(Port(room), mtu=mtu)
    transport.open()
    return transport


def arrived(transport):
    return Deframer(0).feed(transport.port.written)


def test_a_window_waits_for_the_line_and_goes_out_in_order() -> None:
    for room in (0, 1, 50, 300):
        for step in (1, 7, 256):
            transport = busy(room)
            messages = [reliable(i, 60 + i) for i in range(WINDOW)]
            for it in messages:
                transport.send(it, len(it))
            for _ in range(4000 // step):
                transport.port.room = step
                transport.receive(0)
            assert arrived(transport) == messages
            assert transport.dropped == 0


def test_the_end_of_a_message_and_the_beginning_of_the_next_fill_the_same_room() -> None:
    transport = busy(10)
    for i in range(3):
        transport.send(reliable(i), 100)
    transport.port.room = 250
    transport.receive(0)
    assert transport.port.room == 0


def test_only_as_much_of_a_buffer_is_sent_as_is_the_message() -> None:
    """Sessions have buffers that are longer."""
    transport = busy(1)
    first, second = reliable(0, 40), reliable(1, 41)
    transport.send(first + bytes(20), 40)
    transport.send(second + bytes(20), 41)
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [first, second]


def test_what_the_agent_asks_for_while_it_waits_goes_out_once() -> None:
    transport = busy(1)
    messages = [reliable(i) for i in range(5)]
    for it in messages + messages[2:]:
        transport.send(it, len(it))
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == messages
    assert transport.dropped == 0


def test_short_messages_go_before_those_that_wait() -> None:
    transport = busy(1)
    messages = [reliable(i) for i in range(3)]
    for it in messages:
        transport.send(it, len(it))
    transport.send(HEARTBEAT)
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [messages[0], HEARTBEAT] + messages[1:]


def test_short_messages_have_room_for_some_and_no_more() -> None:
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
    there = arrived(transport)
    assert there[0] == reliable(0) and set(there[1:]) == {HEARTBEAT}
    assert len(there) + transport.dropped == 201 and transport.dropped > 100


def test_more_than_a_window_is_lost_and_counted() -> None:
    transport = busy(1)
    for i in range(WINDOW + 4):
        transport.send(reliable(i), 100)
    assert transport.dropped == 3  # one is in its frame already
    transport.port.room = None
    transport.receive(0)
    assert arrived(transport) == [reliable(i) for i in range(WINDOW + 1)]


def test_what_is_not_one_submessage_does_not_wait() -> None:
    """Its length is nowhere to be read: the buffer may be longer."""
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


def test_opening_forgets_those_that_wait() -> None:
    transport = busy(3)
    for i in range(5):
        transport.send(reliable(i), 100)
    transport.close()
    transport.port.room = None
    transport.open()
    transport.receive(0)
    transport.send(reliable(9), 100)
    assert arrived(transport) == [reliable(9)]
