"""Messages described by letters. Also runs on MicroPython."""

from support.portable import SINGLE_FLOATS

from uros.client.dynamic_messages import Shape, ShapedService

# Each type of field, with the padding of CDR.
LETTERS = "?BiIqQds[B][?][d][s][[i]][sq]"
# A number whose double has no zero octets, and one that is exact where floats have 32 bits.
LARGE, LARGE_OCTETS = (1.5, "000000000000f83f") if SINGLE_FLOATS else (1e300, "9c7500883ce4377e")
VALUES = [
    True, 200, -2, 4000000000, -(2**63), 2**64 - 1, -0.5, "grün", b"\x01\x02", [True, False],
    [0.25, LARGE], ["", "a"], [[[1]], [[]]], [["b", -1]],
]  # fmt: skip
OCTETS = (
    "01c80000 feffffff 00286bee 00000000 0000000000000080 ffffffffffffffff"
    "000000000000e0bf 06000000 6772c3bc6e00 0000 02000000 0102 0000 02000000 0100 0000"
    "02000000 000000000000d03f" + LARGE_OCTETS + "02000000 01000000 00 000000 02000000"
    "6100 0000 02000000 01000000 01000000 00000000 01000000 02000000 6200 0000"
    "ffffffffffffffff"
)


def octets_of(message, offset=0, start=0):
    buf = bytearray(b"\xaa" * (offset + message.cdr_size() + 8))
    end = message.pack_into(buf, offset, start)
    assert bytes(buf[end:]) == b"\xaa" * (len(buf) - end)
    return bytes(buf[offset:end])


def test_every_letter_is_encoded_and_decoded() -> None:
    shape = Shape("test_msgs/msg/All", LETTERS)
    octets = octets_of(shape(VALUES))
    assert octets == bytes.fromhex(OCTETS.replace(" ", "")), octets.hex()
    assert shape(VALUES).cdr_size() == len(octets)
    message, end = shape.unpack_from(octets, 0, 0, len(octets))
    assert end == len(octets)
    assert message.values == VALUES, message.values


def test_a_message_is_aligned_from_its_own_start() -> None:
    shape = Shape("test_msgs/msg/All", LETTERS)
    octets = octets_of(shape(VALUES), 3, 3)
    assert octets == octets_of(shape(VALUES))
    buf = b"xxx" + octets
    assert shape.unpack_from(buf, 3, 3, len(buf))[0].values == VALUES


def test_big_endian_is_read() -> None:
    shape = Shape("test_msgs/msg/Some", "Bqd[sI]")
    octets = bytes.fromhex(
        "07aaaaaaaaaaaaaa fffffffffffffffe 3fe0000000000000 00000001 00000002 4100 aaaa 00000005"
        .replace(" ", "")
    )  # fmt: skip
    assert shape.unpack_from(octets, 0, 0, len(octets), False)[0].values == [
        7, -2, 0.5, [["A", 5]],
    ]  # fmt: skip


def test_truncated_bytes_and_false_lengths_are_refused() -> None:
    shape = Shape("test_msgs/msg/All", LETTERS)
    octets = octets_of(shape(VALUES))
    for end in range(len(octets)):
        try:
            shape.unpack_from(octets, 0, 0, end)
        except ValueError:
            continue
        raise AssertionError(end)
    for letters in ("s", "[B]", "[s]", "[d]", "[sq]"):
        for count in (5, 0x7FFFFFFF, 0xFFFFFFFF):
            lie = count.to_bytes(4, "little") + bytes(4)
            try:
                Shape("test_msgs/msg/Lie", letters).unpack_from(lie, 0, 0, len(lie))
            except ValueError:
                continue
            raise AssertionError((letters, count))


def test_a_string_ends_with_its_nul_or_without() -> None:
    shape = Shape("test_msgs/msg/Text", "s")
    for octets in (b"\x02\0\0\0a\0", b"\x01\0\0\0a", b"\x03\0\0\0a\0b"):
        assert shape.unpack_from(octets, 0, 0, len(octets))[0].values == ["a"]
    empty = bytes(4)
    assert shape.unpack_from(empty, 0, 0, 4)[0].values == [""]


def test_trailing_bytes_count_as_part_of_a_message() -> None:
    shape = Shape("test_msgs/msg/All", LETTERS)
    octets = octets_of(shape(VALUES)) + bytes(72)
    message, end = shape.unpack_from(octets, 0, 0, len(octets))
    assert message.values == VALUES and end == len(octets)


def test_names() -> None:
    service = ShapedService("test_msgs/srv/Ask", "i", "?s")
    assert service.Request._TYPE == "test_msgs/srv/Ask_Request"
    assert service.Response._DDS_TYPE == "test_msgs::srv::dds_::Ask_Response_"
    assert service.Response([True, "x"])._TYPE == service.Response._TYPE
