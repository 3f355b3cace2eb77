"""Message and submessage headers, byte by byte. Also runs on MicroPython.

The layouts are written by hand from XRCE 8.3.2 and 8.3.4; where a vector comes from a recorded
conversation, it says so.
"""

from support.portable import refused

from uros.wire import ids
from uros.wire.errors import DecodeError, EncodeError
from uros.wire.header import (
    MessageWriter,
    header_size,
    pull_header,
    pull_subheader,
    push_header,
    push_subheader,
)


def test_header_without_key() -> None:
    buf = bytearray(8)
    assert push_header(buf, 0x81, 0x80, 0x1234) == 4
    assert bytes(buf) == b"\x81\x80\x34\x12\x00\x00\x00\x00"
    assert pull_header(buf, 8) == (0x81, 0x80, 0x1234, None, 4)
    assert header_size(0x81) == header_size(0x80) == header_size(0xFF) == 4


def test_header_with_key() -> None:
    buf = bytearray(12)
    assert push_header(buf, 0x01, 0x00, 0xFFFF, 0xA1B2C3D4) == 8
    assert bytes(buf) == b"\x01\x00\xff\xff\xa1\xb2\xc3\xd4\x00\x00\x00\x00"
    assert pull_header(buf, 12) == (0x01, 0x00, 0xFFFF, 0xA1B2C3D4, 8)
    assert header_size(0x00) == header_size(0x7F) == 8


def test_too_short_for_a_message() -> None:
    for data in (b"", b"\x81\x00\x00", b"\x81\x00\x00\x00\x0b\x01\x00", b"\x01" * 11):
        assert "too few" in refused(DecodeError, pull_header, data, len(data))


def test_headers_that_do_not_fit() -> None:
    buf = bytearray(8)
    for session, stream, sequence, key in (
        (256, 0, 0, 0),
        (-1, 0, 0, 0),
        (0x81, 256, 0, 0),
        (0x81, -1, 0, 0),
        (0x81, 0, 0x10000, 0),
        (0x81, 0, -1, 0),
        (0x01, 0, 0, 1 << 32),
        (0x01, 0, 0, -1),
    ):
        refused(EncodeError, push_header, buf, session, stream, sequence, key)
    refused(EncodeError, push_header, bytearray(3), 0x81, 0, 0)
    refused(EncodeError, push_header, bytearray(7), 0x01, 0, 0, 1)


def test_subheader() -> None:
    buf = bytearray(10)
    assert push_subheader(buf, 4, 0x0B, 0x03, 2) == 8
    assert bytes(buf[4:8]) == b"\x0b\x03\x02\x00"
    assert pull_subheader(buf, 4, 10) == (0x0B, 0x03, 8, 10)


def test_subheaders_that_do_not_fit() -> None:
    buf = bytearray(8)
    for kind, flags, length in ((256, 0, 0), (-1, 0, 0), (0, 256, 0), (0, -1, 0), (0, 0, -1)):
        refused(EncodeError, push_subheader, buf, 0, kind, flags, length)
    refused(EncodeError, push_subheader, buf, 5, 0, 0, 0)


def test_subheader_announces_too_much() -> None:
    data = b"\x0b\x01\x05\x00\x00\x00\x00\x00"
    assert "announces 5 bytes, 4 are there" in refused(DecodeError, pull_subheader, data, 0, 8)
    for end in range(4):
        assert "truncated" in refused(DecodeError, pull_subheader, data, 0, end)


def test_over_64_kb_the_length_field_is_ignored() -> None:
    # 65536 + 5 bytes as a C client sends them, reassembled from fragments.
    whole = bytearray(4 + 65541)
    push_subheader(whole, 0, ids.WRITE_DATA, 1, 65541)
    assert bytes(whole[:4]) == b"\x07\x01\x05\x00"
    assert pull_subheader(whole, 0, len(whole)) == (ids.WRITE_DATA, 1, 4, len(whole))
    whole[2] = whole[3] = 0
    assert pull_subheader(whole, 0, len(whole))[3] == len(whole)


def test_a_message_is_built_as_the_client_builds_it() -> None:
    # READ_DATA and WRITE_DATA in one message: binary_entities.jsonl, client.
    w = MessageWriter(bytearray(64), 0x81, 0x80, 1)
    w.begin(ids.READ_DATA)
    w.octets(bytes.fromhex("0010001680000001ffff000000000000"))
    w.begin(ids.WRITE_DATA)
    w.octets(bytes.fromhex("0011001500000000"))
    assert w.finish() == bytes.fromhex(
        "81800100080110000010001680000001ffff000000000000070108000011001500000000"
    )


def test_submessages_are_aligned_from_the_start_of_the_message() -> None:
    for session, head in ((0x81, b"\x81\x00\x00\x00"), (0x01, b"\x01\x00\x00\x00\x11\x22\x33\x44")):
        for size in range(5):
            w = MessageWriter(bytearray(b"\xee" * 40), session, 0, 0, 0x11223344)
            w.begin(ids.ACKNACK)
            w.octets(b"\xaa" * size)
            w.begin(ids.RESET, 0)
            padded = b"\xaa" * size + bytes(-size & 3)
            expected = head + b"\x0a\x01" + bytes((size, 0)) + padded + b"\x0c\x00\x00\x00"
            assert w.finish() == expected
            assert w.finish() == expected


def test_payloads_are_aligned_from_their_own_start() -> None:
    w = MessageWriter(bytearray(40), 0x81, 0, 0)
    w.begin(ids.GET_INFO)
    w.u8(1)
    w.u32(2)
    w.begin(ids.GET_INFO)
    w.u8(3)
    w.u16(4)
    assert w.finish() == bytes.fromhex("81000000 02010800 01000000 02000000 02010400 03000400")


def test_a_message_that_does_not_fit_its_buffer() -> None:
    w = MessageWriter(bytearray(15), 0x81, 0, 0)
    w.begin(ids.ACKNACK)
    w.octets(b"12345")
    assert "does not fit" in refused(EncodeError, w.begin, ids.RESET)
    assert len(w.buf) == 15
    refused(EncodeError, MessageWriter, bytearray(3), 0x81, 0, 0)
