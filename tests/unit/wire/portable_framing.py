"""Frames on serial lines and lengths on TCP, byte by byte. Also runs on MicroPython.

"recorded" frames are cut from tests/captures/serial_ping.jsonl and serial_publish.jsonl.
"""

from support.portable import framed, refused

from uros.wire.errors import EncodeError
from uros.wire.framing import Deframer, LengthDeframer, crc16, frame, frame_size

# recorded: client 1 to agent 0
PING = bytes.fromhex("7e010010008000000002010800000afffd02000000cf12")
PING_PAYLOAD = bytes.fromhex("8000000002010800000afffd02000000")
# recorded: agent 0 to client 1; its CRC has a 7E in it
PONG = bytes.fromhex(
    "7e000124008100000006011c00000afffd0001010d585243450100010f00010d0001000000000000009b7d5e"
)
PONG_PAYLOAD = bytes.fromhex(
    "8100000006011c00000afffd0001010d585243450100010f00010d000100000000000000"
)
# recorded: two messages of the agent in one chunk
TWO = bytes.fromhex(
    "7e00010e008180000005010600000a001100002bee7e00010e008180010005010600000b001200001bed"
)


def counters(deframer):
    return deframer.skipped, deframer.crc_errors, deframer.foreign


def test_crc() -> None:
    assert crc16(b"123456789", 0, 9) == 0xBB3D  # the check value of CRC-16/ARC
    assert crc16(b"", 0, 0) == 0
    assert crc16(b"x123456789x", 1, 10) == 0xBB3D
    assert crc16(b"6789", 0, 4, crc16(b"12345", 0, 5)) == 0xBB3D
    assert crc16(bytearray(b"123456789"), 0, 9) == crc16(memoryview(b"123456789"), 0, 9)


def test_recorded_frames() -> None:
    assert framed(PING_PAYLOAD) == PING
    assert framed(PONG_PAYLOAD, 0, 1) == PONG
    agent = Deframer(0)
    assert agent.feed(PING) == [PING_PAYLOAD]
    assert agent.source == 1
    client = Deframer(1)
    assert client.feed(PONG) == [PONG_PAYLOAD]
    assert client.source == 0
    assert [len(message) for message in client.feed(TWO)] == [14, 14]
    assert counters(agent) == counters(client) == (0, 0, 0)


def test_every_chunking_of_recorded_frames() -> None:
    stream = PONG + TWO
    for size in range(1, len(stream)):
        client = Deframer(1)
        out = []
        for at in range(0, len(stream), size):
            out.extend(client.feed(memoryview(stream)[at : at + size]))
        assert len(out) == 3 and out[0] == PONG_PAYLOAD
        assert counters(client) == (0, 0, 0)


def test_everything_that_must_be_escaped_is() -> None:
    for payload in (b"\x7e", b"\x7d", b"\x7e\x7d" * 40, b"\x5e\x5d", bytes(range(256)), b""):
        for source, destination in ((1, 0), (0x7E, 0x7D), (0x7D, 0x7E)):
            wire = framed(payload, source, destination)
            assert 0x7E not in wire[1:]
            deframer = Deframer(destination)
            assert deframer.feed(wire) == [payload]
            assert deframer.source == source
            assert counters(deframer) == (0, 0, 0)


def test_lengths_that_must_be_escaped() -> None:
    for size in (0x7D, 0x7E, 0x7D00, 0x7E7E, 0xFFFF):
        payload = bytes(size)
        assert Deframer(0).feed(framed(payload)) == [payload]


def test_worst_case_size() -> None:
    payload = b"\x7e" * 0x7D
    assert len(framed(payload, 0x7E, 0x7D)) <= frame_size(payload)


def test_payloads_that_do_not_fit_a_frame() -> None:
    out = bytearray(200000)
    refused(EncodeError, frame, bytes(0x10000), 0, 0, out)
    for source, destination in ((256, 0), (-1, 0), (0, 256), (0, -1)):
        refused(EncodeError, frame, b"x", source, destination, out)
    refused(EncodeError, frame, b"x", 0, 0, bytearray(frame_size(b"x") - 1))


def test_text_between_frames() -> None:
    agent = Deframer(0)
    text = b"boot: ok\r\n"
    assert agent.feed(text + PING + text + PING + text) == [PING_PAYLOAD] * 2
    assert counters(agent) == (3 * len(text), 0, 0)


def test_text_with_flags_and_escapes_in_it() -> None:
    agent = Deframer(0)
    text = b"~/config~~ }~}~"
    assert agent.feed(text + PING) == [PING_PAYLOAD]
    assert counters(agent) == (len(text), 0, 0)


def test_frames_truncated_anywhere() -> None:
    for size in range(len(PONG)):
        client = Deframer(1)
        assert client.feed(PONG[:size]) == []
        assert client.feed(PONG) == [PONG_PAYLOAD]
        assert client.source == 0
        assert counters(client) == (size, 0, 0)


def test_a_frame_with_a_wrong_crc() -> None:
    broken = bytearray(PING)
    broken[9] ^= 1
    agent = Deframer(0)
    assert agent.feed(broken) == []
    assert counters(agent) == (len(PING), 1, 0)
    assert agent.feed(PING) == [PING_PAYLOAD]
    assert counters(agent) == (len(PING), 1, 0)


def test_a_frame_for_another_address() -> None:
    agent = Deframer(0)
    assert agent.feed(framed(b"hello", 2, 3) + PING) == [PING_PAYLOAD]
    assert counters(agent) == (0, 0, 1)
    assert agent.source == 1


def test_a_frame_that_lost_a_byte_loses_no_other_frame() -> None:
    for at in range(1, len(PING)):
        agent = Deframer(0)
        out = agent.feed(PING[:at] + PING[at + 1 :] + PING + PING)
        assert out == [PING_PAYLOAD] * 2, at
        # without its destination, the frame may look like one for another address
        assert agent.skipped == len(PING) - 1


def test_an_announced_length_that_never_comes() -> None:
    for size, crc_errors in ((100, 0), (0xFFFF + 1, 0), (0xFFFF + 2, 1), (70000, 1)):
        agent = Deframer(0)
        start = b"\x7e\x01\x00\xff\xff"
        assert agent.feed(start + b"\x01" * size) == []
        assert agent.feed(PING) == [PING_PAYLOAD]
        assert counters(agent) == (len(start) + size, crc_errors, 0)


def test_escapes_and_flags_alone() -> None:
    agent = Deframer(0)
    agent.feed(b"\x7e" * 1000)
    agent.feed(b"\x7d" * 1000)
    agent.feed(b"\x7e\x7d" * 1000)
    assert agent.feed(PING) == [PING_PAYLOAD]
    assert agent.source == 1
    assert agent.skipped == 4000


def test_payloads_of_frames_are_handed_over() -> None:
    agent = Deframer(0)
    first, second = agent.feed(PING + framed(b"other"))
    assert (first, second) == (PING_PAYLOAD, b"other")
    assert isinstance(first, bytes)


# recorded: tcp_publish, CREATE_CLIENT and its answer, each with the length before it
TCP = bytes.fromhex(
    "18008000000000011000585243450100010faaaabbbb8100fc0113008100000004010b000000585243450100010f00"
)


def test_lengths_before_messages() -> None:
    for size in range(1, len(TCP) + 1):
        deframer = LengthDeframer()
        out = []
        for at in range(0, len(TCP), size):
            out.extend(deframer.feed(memoryview(TCP)[at : at + size]))
        assert out == [TCP[2:26], TCP[28:]]


def test_empty_and_largest_messages_on_tcp() -> None:
    deframer = LengthDeframer()
    assert deframer.feed(b"\x00\x00\x00\x00\x01\x00a\x00\x00") == [b"a"]
    assert deframer.feed(b"\xff\xff" + bytes(65534)) == []
    assert deframer.feed(b"z\x01\x00") == [bytes(65534) + b"z"]
    assert deframer.feed(b"b") == [b"b"]
