"""Primitive values, byte by byte, with their limits. Also runs on MicroPython.

The vectors are written by hand from the rules of CDR: a value is aligned to its own size, a
string counts its closing NUL.
"""

from support.portable import refused

from uros.wire.cdr import MAX_STRING, Reader, Writer
from uros.wire.errors import DecodeError, EncodeError, LimitError

LITTLE = (
    b"\x07"
    b"\x00"
    b"\x34\x12"  # u8, pad, u16
    b"\x01"
    b"\x00\x00\x00"
    b"\xef\xbe\xad\xde"  # boolean, pad, u32
    b"\xfe\xff"
    b"\xab\xcd"  # i16, two octets
    b"\x00\x00\x00\x80"  # i32
    b"\x03\x00\x00\x00hi\x00"  # string
    b"\x12\x34"  # an id, never aligned
    b"\x00\x00\x00"
    b"\x02\x00\x00\x00\x01\x02"  # pad, sequence
)
BIG = (
    b"\x07"
    b"\x00"
    b"\x12\x34"
    b"\x01"
    b"\x00\x00\x00"
    b"\xde\xad\xbe\xef"
    b"\xff\xfe"
    b"\xab\xcd"
    b"\x80\x00\x00\x00"
    b"\x00\x00\x00\x03hi\x00"
    b"\x12\x34"
    b"\x00\x00\x00"
    b"\x00\x00\x00\x02\x01\x02"
)


def read_all(r):
    return (
        r.u8(), r.u16(), r.boolean(), r.u32(), r.i16(), r.octets(2), r.i32(), r.string(),
        r.be16(), r.sequence(),
    )  # fmt: skip


def write_all(w):
    w.u8(7)
    w.u16(0x1234)
    w.boolean(True)
    w.u32(0xDEADBEEF)
    w.i16(-2)
    w.octets(b"\xab\xcd")
    w.i32(-0x80000000)
    w.string("hi")
    w.be16(0x1234)
    w.sequence(b"\x01\x02")


VALUES = (7, 0x1234, True, 0xDEADBEEF, -2, b"\xab\xcd", -0x80000000, "hi", 0x1234, b"\x01\x02")


def test_reads_both_byte_orders() -> None:
    for data, little in ((LITTLE, True), (BIG, False)):
        for buf in (data, bytearray(data), memoryview(data)):
            r = Reader(buf, 0, len(data), little)
            assert read_all(r) == VALUES
            assert r.remaining() == 0


def test_alignment_counts_from_the_start_of_the_payload() -> None:
    for shift in range(1, 9):
        r = Reader(b"\xff" * shift + LITTLE + b"\xff", shift, shift + len(LITTLE))
        assert read_all(r) == VALUES


def test_write_gives_the_bytes_that_read_takes() -> None:
    for shift in range(9):
        w = Writer(bytearray(b"\xee" * 60), shift)
        write_all(w)
        assert bytes(w.buf[shift : w.offset]) == LITTLE
        assert bytes(w.buf[w.offset :]) == b"\xee" * (60 - w.offset)


def test_the_ends_of_every_range() -> None:
    w = Writer(bytearray(64))
    w.i16(0x7FFF)
    w.i16(-0x8000)
    w.i32(0x7FFFFFFF)
    w.i32(-0x80000000)
    w.u32(0xFFFFFFFF)
    w.u16(0xFFFF)
    w.u8(0xFF)
    r = Reader(w.buf, 0, w.offset)
    assert (r.i16(), r.i16()) == (0x7FFF, -0x8000)
    assert (r.i32(), r.i32()) == (0x7FFFFFFF, -0x80000000)
    assert (r.u32(), r.u16(), r.u8()) == (0xFFFFFFFF, 0xFFFF, 0xFF)


def test_a_value_that_does_not_fit_its_field() -> None:
    w = Writer(bytearray(64))
    for write, values in (
        (w.u8, (-1, 256)),
        (w.u16, (-1, 0x10000)),
        (w.be16, (-1, 0x10000)),
        (w.u32, (-1, 0x100000000)),
        (w.i16, (-0x8001, 0x8000)),
        (w.i32, (-0x80000001, 0x80000000)),
    ):
        for value in values:
            refused(EncodeError, write, value)
    refused(EncodeError, w.array, b"abc", 4)
    refused(EncodeError, w.array, b"abcde", 4)
    assert w.offset == 0, "nothing may be written of what is refused"


def test_a_string_with_a_nul_is_refused() -> None:
    assert "NUL" in refused(EncodeError, Writer(bytearray(64)).string, "a\x00b")


def test_a_buffer_that_is_too_small() -> None:
    for size in range(len(LITTLE)):
        w = Writer(bytearray(size))
        refused(EncodeError, write_all, w)
        assert len(w.buf) == size, "it may not grow"


def test_truncated_at_every_byte() -> None:
    for size in range(len(LITTLE)):
        r = Reader(LITTLE, 0, size)
        assert "truncated" in refused(DecodeError, read_all, r)
        assert r.offset <= size


def test_a_boolean_is_0_or_1() -> None:
    for octet in (2, 0x80, 0xFF):
        assert "boolean" in refused(DecodeError, Reader(bytes((octet,)), 0, 1).boolean)


def test_a_length_over_the_limit_is_refused_before_the_bytes_are_read() -> None:
    data = b"\xff\xff\xff\xff"
    refused(LimitError, Reader(data, 0, 4).string)
    refused(LimitError, Reader(data, 0, 4).sequence)
    data = b"\x05\x00\x00\x00abcde"
    refused(LimitError, Reader(data, 0, 9).sequence, 4)
    assert Reader(data, 0, 9).sequence(5) == b"abcde"
    data = bytes((MAX_STRING & 0xFF, MAX_STRING >> 8 & 0xFF, MAX_STRING >> 16, 0))
    assert "truncated" in refused(DecodeError, Reader(data, 0, 4).string)


def test_strings_as_peers_send_them() -> None:
    for data, text in (
        (b"\x00\x00\x00\x00", ""),  # without any NUL
        (b"\x01\x00\x00\x00\x00", ""),
        (b"\x02\x00\x00\x00ab", "ab"),  # length without the NUL
        (b"\x04\x00\x00\x00a\x00bc", "a"),
        (b"\x03\x00\x00\x00\xc3\xa9\x00", "\xe9"),
    ):
        assert Reader(data, 0, len(data)).string() == text
    for data in (b"\x02\x00\x00\x00\xff\x00", b"\x02\x00\x00\x00\xc3\x00"):
        assert "UTF-8" in refused(DecodeError, Reader(data, 0, len(data)).string)


def test_text_beyond_ascii_counts_in_bytes() -> None:
    w = Writer(bytearray(16))
    w.string("\u20ac")
    assert bytes(w.buf[: w.offset]) == b"\x04\x00\x00\x00\xe2\x82\xac\x00"
