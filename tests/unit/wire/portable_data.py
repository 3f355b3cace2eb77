"""READ_DATA and the identity of a request, byte by byte, both ways. Also runs on MicroPython.

"recorded": cut from the conversations in tests/captures, by the name of the file.
"by hand": written from the order and sizes of the fields in XRCE 8.3.5 and the C sources.
"""

from support.portable import pair, reader, refused

from uros.wire import data, ids
from uros.wire.cdr import Writer
from uros.wire.errors import DecodeError, EncodeError
from uros.wire.session import pull_request, push_request


def read_data(octets, *values):
    pair(octets, data.push_read_data, data.pull_read_data, values)


def test_read_data() -> None:
    read_data(  # recorded: binary_entities
        "0010 0016 80 00 00 01 ffff 0000 0000 0000",
        16, 0x16, 0x80, ids.FORMAT_DATA, None, (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0),
    )  # fmt: skip
    # by hand
    read_data("0010 0016 01 00 00 00", 16, 0x16, 1, 0, None, None)
    read_data("0010 0016 80 00 00 01 0000 0000 0000 0000", 16, 0x16, 0x80, 0, None, (0, 0, 0, 0))
    read_data(
        "0001 0026 81 02 01 00 04000000 783e3300 01 00 0500 0a00 e803 6400",
        1, 0x26, 0x81, ids.FORMAT_SAMPLE, "x>3", (5, 10, 1000, 100),
    )  # fmt: skip


def test_read_data_asks_for_one_sample_without_more() -> None:
    w = Writer(bytearray(8))
    data.push_read_data(w, 16, 0x16, 1)
    assert bytes(w.buf) == bytes.fromhex("0010 0016 01 00 00 00")


def test_read_data_that_does_not_fit() -> None:
    for values in (
        (65536, 0, 0),
        (0, 65536, 0),
        (0, 0, 256),
        (0, 0, 0, 256),
        (0, 0, 0, 0, None, (65536, 0, 0, 0)),
        (0, 0, 0, 0, None, (0, 0, 0, -1)),
    ):
        refused(EncodeError, data.push_read_data, Writer(bytearray(64)), *values)


def test_read_data_big_endian() -> None:
    octets = bytes.fromhex("0010 0016 80 00 00 01 0001 0002 0003 0004")
    assert data.pull_read_data(reader(octets, False))[-1] == (1, 2, 3, 4)


def test_write_data_and_data_are_a_request_and_the_sample() -> None:
    octets = bytes.fromhex("0011 0015 00000000")  # recorded: binary_entities, both directions
    r = reader(octets)
    assert pull_request(r) == (17, 0x15)
    assert r.remaining() == 4
    w = Writer(bytearray(8))
    push_request(w, 17, 0x15)
    assert w.offset == data.REQUEST_SIZE
    assert bytes(w.buf) == octets


GUID = b"\x01\x0f\x02\x03\x04\x05\x06\x07\x08\x09\x0a\x0b\x00\x00\x04\x03"


def test_sample_identity() -> None:
    buf = bytearray(b"\xee" * 30)
    data.push_sample_identity(buf, 2, GUID, 0x0102030405060708)
    # by hand: the high word first, each word little endian
    expected = GUID + b"\x04\x03\x02\x01\x08\x07\x06\x05"
    assert bytes(buf) == b"\xee\xee" + expected + b"\xee" * 4
    for kind in (bytes, bytearray, memoryview):
        assert data.pull_sample_identity(kind(buf), 2, 26) == (GUID, 0x0102030405060708)
    big = GUID + b"\x01\x02\x03\x04\x05\x06\x07\x08"
    assert data.pull_sample_identity(big, 0, 24, False) == (GUID, 0x0102030405060708)


def test_sample_identity_with_numbers_at_the_ends() -> None:
    buf = bytearray(24)
    for sequence in (0, 1, (1 << 32) - 1, 1 << 32, (1 << 63) - 1, (1 << 64) - 1):
        data.push_sample_identity(buf, 0, GUID, sequence)
        assert data.pull_sample_identity(buf, 0, 24) == (GUID, sequence)
    data.push_sample_identity(buf, 0, GUID, -2)
    assert data.pull_sample_identity(buf, 0, 24) == (GUID, (1 << 64) - 2)


def test_sample_identity_truncated_and_unfit() -> None:
    buf = bytearray(24)
    for end in range(24):
        refused(DecodeError, data.pull_sample_identity, buf, 0, end)
    refused(DecodeError, data.pull_sample_identity, buf, 1, 24)
    refused(EncodeError, data.push_sample_identity, buf, 1, GUID, 0)
    refused(EncodeError, data.push_sample_identity, buf, 0, GUID[:15], 0)
    refused(EncodeError, data.push_sample_identity, buf, 0, GUID, 1 << 64)
    refused(EncodeError, data.push_sample_identity, buf, 0, GUID, -(1 << 63) - 1)
    assert buf == bytearray(24)
