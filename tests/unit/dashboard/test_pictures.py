"""Pictures from outside: formats that are shown, and errors of those that are rejected."""

import base64
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.dashboard import pictures
from uros.dashboard.pictures import PictureError, look, picture
from uros.interfaces import load

CompressedImage = load("sensor_msgs/msg/CompressedImage")
Image = load("sensor_msgs/msg/Image")

# 16×8 of one colour, written by Pillow.
JPEG = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABsSFBcUERsXFhceHBsgKEIrKCUlKFE6PTBCYFVlZF9VXVtqeJmBanGQc1td"
    "hbWGkJ6jq62rZ4C8ybqmx5moq6T/2wBDARweHigjKE4rK06kbl1upKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSkpKSk"
    "pKSkpKSkpKSkpKSkpKSkpKSkpKT/wAARCAAIABADASIAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAAAAT/xAAUEAEA"
    "AAAAAAAAAAAAAAAAAAAA/8QAFQEBAQAAAAAAAAAAAAAAAAAABAX/xAAUEQEAAAAAAAAAAAAAAAAAAAAA/9oADAMBAAIR"
    "AxEAPwCIANXf/9k="
)
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAABAAAAAICAIAAAB/FOjAAAAAF0lEQVR42mM8ocHFQApgYiARjGogBgAAi3EBCj6MV8AA"
    "AAAASUVORK5CYII="
)


def refused(call, *arguments):
    with pytest.raises(PictureError) as caught:
        call(*arguments)
    return str(caught.value)


def test_the_picture_of_a_camera():
    message = CompressedImage(format="anything", data=JPEG)
    message.header.stamp.sec, message.header.stamp.nanosec = 5, 7
    message.header.frame_id = "myframe"
    shown = picture(message)
    assert (shown.kind, shown.mime, shown.suffix) == ("jpeg", "image/jpeg", ".jpg")
    assert (shown.width, shown.height, shown.stamp_ns) == (16, 8, 5_000_000_007)
    assert (shown.data, shown.frame_id, shown.was) == (JPEG, "myframe", "jpeg")


def test_the_octets_decide_the_format_of_a_picture():
    shown = picture(CompressedImage(format="jpeg", data=PNG))
    assert (shown.kind, shown.mime, shown.width, shown.height) == ("png", "image/png", 16, 8)


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", "it is empty"),
        (b"<svg onload=alert(1)>", "begins with 3c 73 76 67, which is neither JPEG nor PNG"),
        (b"GIF89a", "neither"),
        (JPEG[:-2], "its JPEG has no end"),
        (JPEG[:150], "its JPEG says no size"),
        (JPEG[:4], "its JPEG says no size"),
        (PNG[:-8], "its PNG has no end"),
        (PNG[:20], "its PNG says no size"),
        (PNG.replace(struct.pack(">II", 16, 8), struct.pack(">II", 16, 0)), "it is 16×0"),
        (PNG.replace(struct.pack(">II", 16, 8), struct.pack(">II", 9000, 8)), "it is 9000×8"),
        (PNG.replace(struct.pack(">II", 16, 8), struct.pack(">II", 8000, 8000)), "32 million"),
        (JPEG.replace(b"\x08\x00\x08\x00\x10", b"\x08\xff\xff\xff\xff"), "it is 65535×65535"),
        (JPEG + bytes(pictures.MAX_OCTETS), "more than 16 MiB"),
    ],
    ids=lambda value: value if isinstance(value, str) else str(len(value)),
)  # fmt: skip
def test_pictures_that_are_rejected(data, error):
    assert error in refused(look, data)


def test_the_buffer_of_a_camera_may_be_longer_than_its_picture():
    assert look(JPEG + bytes(9000)) == ("jpeg", 16, 8)


def test_the_end_of_a_thumbnail_is_not_the_end_of_the_picture():
    thumbnail = b"\xff\xe1" + struct.pack(">H", 2 + len(JPEG)) + JPEG
    assert look(JPEG[:2] + thumbnail + JPEG[2:]) == ("jpeg", 16, 8)
    assert "no end" in refused(look, JPEG[:2] + thumbnail + JPEG[2:-2])


@given(st.binary(max_size=300), st.sampled_from((b"", JPEG[:3], PNG[:8], JPEG[:150], PNG[:16])))
def test_any_octets(octets, head):
    try:
        kind, width, height = look(head + octets)
    except PictureError:
        return
    assert kind in ("jpeg", "png")
    assert 0 < width * height <= pictures.MAX_PIXELS


# --- raw images ----------------------------------------------------------------------------


def unpacked(data):
    """Decode a PNG without filters: width, height, bits, colour type, rows."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, body, names = 8, b"", []
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        name, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        (check,) = struct.unpack_from(">I", data, at + 8 + length)
        assert check == zlib.crc32(name + content)
        names.append(name)
        if name == b"IHDR":
            width, height, bits, colour = struct.unpack_from(">IIBB", content)
        elif name == b"IDAT":
            body += content
        at += 12 + length
    assert names == [b"IHDR", b"IDAT", b"IEND"]
    lines = zlib.decompress(body)
    row = len(lines) // height
    assert all(lines[y * row] == 0 for y in range(height))
    return width, height, bits, colour, [lines[y * row + 1 : (y + 1) * row] for y in range(height)]


@pytest.mark.parametrize(
    ("encoding", "octets", "big", "wanted"),
    [
        ("rgb8", "010203 040506 0708", False, (8, 2, ["010203040506"])),
        ("bgr8", "010203 040506", False, (8, 2, ["030201060504"])),
        ("8UC3", "010203 040506", False, (8, 2, ["030201060504"])),
        ("rgba8", "01020304 05060708", False, (8, 6, ["0102030405060708"])),
        ("bgra8", "01020304 05060708", False, (8, 6, ["0302010407060508"])),
        ("mono8", "0102", False, (8, 0, ["0102"])),
        ("8UC1", "0102", False, (8, 0, ["0102"])),
        ("mono16", "0102 0304", False, (16, 0, ["02010403"])),
        ("mono16", "0102 0304", True, (16, 0, ["01020304"])),
    ],
)
def test_encodings(encoding, octets, big, wanted):
    data = bytes.fromhex(octets)
    image = Image(height=1, width=2, encoding=encoding, step=len(data), is_bigendian=big, data=data)
    shown = picture(image)
    assert (shown.kind, shown.width, shown.height, shown.was) == ("png", 2, 1, encoding)
    width, height, bits, colour, rows = unpacked(shown.data)
    assert (width, height) == (2, 1)
    assert (bits, colour, [row.hex() for row in rows]) == wanted
    assert look(shown.data) == ("png", 2, 1)


def test_rows_with_padding():
    data = bytes.fromhex("010203 ffff 040506 ffff 070809")
    image = Image(height=3, width=1, encoding="bgr8", step=5, data=data)
    assert [row.hex() for row in unpacked(picture(image).data)[4]] == ["030201", "060504", "090807"]


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"encoding": "bayer_rggb8"}, "its encoding is 'bayer_rggb8'; shown are rgb8, bgr8"),
        ({"width": 0}, "it is 0×2: it has no pixels"),
        ({"width": 60000}, "it says it is 60000×2"),
        ({"step": 5}, "its rows have 5 octets, and 2 pixels need 6"),
        ({"data": bytes(11)}, "it has 11 octets, and 2 rows need 12"),
        ({"height": 3}, "3 rows need 18"),
    ],
)
def test_raw_images_that_are_rejected(change, error):
    fields = {"height": 2, "width": 2, "encoding": "rgb8", "step": 6, "data": bytes(12), **change}
    assert error in refused(picture, Image(**fields))
