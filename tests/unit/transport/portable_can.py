"""The CAN FD transport of boards. Also runs on MicroPython."""

from support.board import pattern

from uros.ticks import ticks_diff, ticks_ms
from uros.transport.can import CanTransport, can_frame


class Bus:
    """A port; ``incoming`` are the received frames, ``room`` is the number of frames it sends."""

    def __init__(self, incoming=(), room=1 << 20):
        self.incoming = list(incoming)
        self.room = room
        self.sent = []

    def send(self, can_id, data):
        if not self.room:
            return False
        self.room -= 1
        self.sent.append((can_id, bytes(data)))

    def recv(self):
        return self.incoming.pop(0) if self.incoming else None


def test_a_message_is_padded_to_a_frame() -> None:
    # By hand, after uxr_write_can_data_platform of eProsima's client: the length, the message, and
    # the padding of the controller, since a CAN FD frame has one of 16 lengths.
    assert can_frame(bytes.fromhex("80000000")) == bytes.fromhex("0480000000")
    assert can_frame(b"1234567") == b"\x071234567"
    assert can_frame(b"12345678") == b"\x0812345678\0\0\0"
    assert can_frame(bytes(63)) == b"\x3f" + bytes(63)
    lengths = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
    for size in range(64):
        message = pattern(size, size)
        data = can_frame(message)
        assert data[0] == size and data[1 : size + 1] == message
        assert not any(data[size + 1 :])
        assert len(data) == min([length for length in lengths if length > size])


def test_messages_are_sent_and_received_over_can() -> None:
    messages = [pattern(size, size) for size in range(1, 64)]
    bus = Bus()
    transport = CanTransport(bus, 0x1ABCDEF0)
    transport.open()
    for message in messages:
        transport.send(memoryview(message))
    assert [datagram[0] for datagram in bus.sent] == [0x1ABCDEF0] * 63
    bus.incoming = bus.sent
    for message in messages:
        assert transport.receive(1000) == message
    assert transport.receive(0) is None
    transport.close()
    assert transport.dropped == transport.malformed == 0 and transport.mtu == 63


def test_foreign_and_malformed_frames_are_skipped() -> None:
    bad = [b"", b"\0", b"\1", b"\0abc", b"\4abc", b"\xffabc", b"\x40" + bytes(63)]
    for first in bad:
        bus = Bus([(1, first), (2, b"\3abc"), (1, b"\4good\0\0\0"), (0x80000001, b"\1x")])
        transport = CanTransport(bus)
        assert transport.receive(1000) == b"good"
        assert transport.receive(0) is None
        assert transport.malformed == 1


def test_foreign_frames_do_not_block_receive() -> None:
    bus = Bus([(2, b"\1x")] * 1000)
    transport = CanTransport(bus)
    start = ticks_ms()
    while len(bus.incoming) and ticks_diff(ticks_ms(), start) < 5000:
        assert transport.receive(0) is None
    assert not bus.incoming


def test_messages_without_room_or_too_long_are_dropped_and_counted() -> None:
    bus = Bus(room=1)
    transport = CanTransport(bus)
    for octets in (bytes(64), b"abc", b"def", b"ghi"):
        transport.send(octets)
    assert bus.sent == [(1, b"\3abc")] and transport.dropped == 3


def test_open_wait_and_close_of_the_port_are_called() -> None:
    class Port(Bus):
        calls = []

        def open(self):
            self.calls.append("open")

        def close(self):
            self.calls.append("close")

        def wait(self, timeout_ms):
            self.calls.append("wait")
            assert 0 < timeout_ms <= 5000
            self.incoming.append((1, b"\2ab"))

    transport = CanTransport(Port())
    transport.open()
    assert transport.receive(5000) == b"ab"
    transport.close()
    assert Port.calls == ["open", "wait", "close"]


def test_invalid_can_ids_are_refused() -> None:
    for wrong in (-1, 0x20000000):
        try:
            CanTransport(Bus(), wrong)
        except ValueError as error:
            assert "29 bits" in str(error)
        else:
            raise AssertionError("not refused")
