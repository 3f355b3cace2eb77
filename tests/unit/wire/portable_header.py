"""Message and submessage headers, byte by byte. Also runs on MicroPython."""

from uros.wire.errors import DecodeError
from uros.wire.header import pull_header, pull_subheader, push_header, push_subheader


def test_header_without_key() -> None:
    buf = bytearray(8)
    assert push_header(buf, 0x81, 0x80, 0x1234) == 4
    assert bytes(buf) == b"\x81\x80\x34\x12\x00\x00\x00\x00"
    assert pull_header(buf, 8) == (0x81, 0x80, 0x1234, None, 4)


def test_header_with_key() -> None:
    buf = bytearray(12)
    assert push_header(buf, 0x01, 0x00, 0xFFFF, 0xA1B2C3D4) == 8
    assert bytes(buf) == b"\x01\x00\xff\xff\xa1\xb2\xc3\xd4\x00\x00\x00\x00"
    assert pull_header(buf, 12) == (0x01, 0x00, 0xFFFF, 0xA1B2C3D4, 8)


def test_too_short_for_a_message() -> None:
    for data in (b"", b"\x81\x00\x00", b"\x81\x00\x00\x00\x0b\x01\x00", b"\x01" * 11):
        try:
            pull_header(data, len(data))
        except DecodeError:
            continue
        raise AssertionError(data)


def test_subheader() -> None:
    buf = bytearray(10)
    assert push_subheader(buf, 4, 0x0B, 0x03, 2) == 8
    assert bytes(buf[4:8]) == b"\x0b\x03\x02\x00"
    assert pull_subheader(buf, 4, 10) == (0x0B, 0x03, 8, 10)


def test_subheader_announces_too_much() -> None:
    try:
        pull_subheader(b"\x0b\x01\x05\x00\x00\x00\x00\x00", 0, 8)
    except DecodeError as error:
        assert "announces 5 bytes, 4 are there" in str(error)
    else:
        raise AssertionError("not refused")
