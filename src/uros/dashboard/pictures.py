"""Checks image messages and converts them to files that a browser shows.

The first octets of a picture decide its format; ``format`` of a CompressedImage is ignored. Raw
images are converted to PNG.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

# The most pixels of a side and of a picture, because a browser may decompress a few kilobytes into
# gigabytes.
MAX_SIDE: Final = 8192
MAX_PIXELS: Final = 32_000_000
# The most octets of a picture, because each waiting browser holds a copy.
MAX_OCTETS: Final = 16 << 20

COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
RAW: Final = "sensor_msgs/msg/Image"
TYPES: Final = (COMPRESSED, RAW)

_PNG: Final = b"\x89PNG\r\n\x1a\n"
_JPEG: Final = b"\xff\xd8\xff"
_MIME: Final = {"jpeg": "image/jpeg", "png": "image/png"}
_SUFFIX: Final = {"jpeg": ".jpg", "png": ".png"}
# encoding → (bytes a pixel, PNG colour type, bits, whether red and blue are swapped)
_ENCODINGS: Final = {
    "rgb8": (3, 2, 8, False),
    "bgr8": (3, 2, 8, True),
    "8UC3": (3, 2, 8, True),
    "rgba8": (4, 6, 8, False),
    "bgra8": (4, 6, 8, True),
    "mono8": (1, 0, 8, False),
    "8UC1": (1, 0, 8, False),
    "mono16": (2, 0, 16, False),
}


class PictureError(ValueError):
    """A picture cannot be shown; the text has the reason."""


class Picture(NamedTuple):
    """A picture that a browser can show; ``stamp_ns`` is 0 if its header has no time."""

    kind: str  # "jpeg" or "png"
    data: bytes
    width: int
    height: int
    stamp_ns: int
    frame_id: str
    was: str  # the format received, such as "jpeg" or "bgr8"

    @property
    def mime(self) -> str:
        """The MIME type."""
        return _MIME[self.kind]

    @property
    def suffix(self) -> str:
        """The suffix of a file name."""
        return _SUFFIX[self.kind]


def picture(message: Any) -> Picture:
    """Make a picture of a CompressedImage or an Image; raises PictureError."""
    header = message.header
    stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    if message._TYPE == COMPRESSED:
        data = bytes(message.data)
        kind, width, height = look(data)
        was = kind
    else:
        kind, data = "png", png(message)
        width, height, was = message.width, message.height, message.encoding
    return Picture(kind, data, width, height, stamp, header.frame_id, was)


def look(data: bytes) -> tuple[str, int, int]:
    """Return the format of a file by its content, its width and height; raises PictureError."""
    if not data:
        raise PictureError("it is empty: the camera has taken nothing")
    if len(data) > MAX_OCTETS:
        raise PictureError(f"it has {len(data)} octets, more than {MAX_OCTETS >> 20} MiB")
    if data.startswith(_JPEG):
        kind, (width, height) = "jpeg", _jpeg_size(data)
    elif data.startswith(_PNG):
        kind, (width, height) = "png", _png_size(data)
    else:
        raise PictureError(f"it begins with {data[:4].hex(' ')}, which is neither JPEG nor PNG")
    _check_size(width, height)
    return kind, width, height


def _check_size(width: int, height: int) -> None:
    if not width or not height:
        raise PictureError(f"it is {width}×{height}: it has no pixels")
    if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
        raise PictureError(
            f"it says it is {width}×{height}: at most {MAX_SIDE} a side and"
            f" {MAX_PIXELS // 1_000_000} million pixels are shown"
        )


# --- JPEG, ITU-T T.81 annex B ---------------------------------------------------------


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Return width and height; raises PictureError for a truncated picture."""
    size, scan = None, len(data)
    for marker, at, length in _segments(data):
        if marker == 0xDA:
            scan = at
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # a start of frame
            if length < 7:
                break
            height, width = struct.unpack_from(">HH", data, at + 1)
            size = width, height
    if size is None:
        raise PictureError("its JPEG says no size: it is broken")
    # Bytes after the end are ignored: cameras pad their buffers.
    if data.find(b"\xff\xd9", scan) < 0:
        raise PictureError("its JPEG has no end: it was cut off, perhaps by too small a buffer")
    return size


def _segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield ``(marker, offset of its content, its length)`` up to the scan."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill
            at += 1
            continue
        if marker == 0x01 or 0xD0 <= marker <= 0xD8:  # without content
            at += 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        if length < 2 or at + 2 + length > len(data):
            return
        yield marker, at + 4, length - 2
        if marker == 0xDA:
            return
        at += 2 + length


# --- PNG, ISO/IEC 15948 ---------------------------------------------------------------


def _png_size(data: bytes) -> tuple[int, int]:
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise PictureError("its PNG says no size: it is broken")
    if b"IEND" not in data[-4096:]:
        raise PictureError("its PNG has no end: it was cut off")
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def png(image: Any) -> bytes:
    """Convert a raw Image to PNG; raises PictureError."""
    known = _ENCODINGS.get(image.encoding)
    if known is None:
        raise PictureError(
            f"its encoding is {image.encoding[:24]!r}; shown are {', '.join(_ENCODINGS)}"
        )
    octets, colour, bits, swapped = known
    width, height, step = image.width, image.height, image.step
    _check_size(width, height)
    row = width * octets
    if step < row:
        raise PictureError(f"its rows have {step} octets, and {width} pixels need {row}")
    data = memoryview(image.data)
    if len(data) < step * (height - 1) + row:
        raise PictureError(f"it has {len(data)} octets, and {height} rows need {step * height}")
    lines = bytearray((row + 1) * height)  # filter type 0 before each row
    for y in range(height):
        lines[y * (row + 1) + 1 : (y + 1) * (row + 1)] = data[y * step : y * step + row]
    if swapped:
        _swap_red_and_blue(lines, row, octets)
    elif bits == 16 and not image.is_bigendian:
        for y in range(height):
            begin, end = y * (row + 1) + 1, (y + 1) * (row + 1)
            lines[begin:end:2], lines[begin + 1 : end : 2] = (
                lines[begin + 1 : end : 2],
                lines[begin:end:2],
            )
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    body = zlib.compress(lines, 1)
    return _PNG + _chunk(b"IHDR", head) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def _swap_red_and_blue(lines: bytearray, row: int, octets: int) -> None:
    for begin in range(1, len(lines), row + 1):
        end = begin + row
        blue = lines[begin:end:octets]
        lines[begin:end:octets] = lines[begin + 2 : end : octets]
        lines[begin + 2 : end : octets] = blue


def _chunk(name: bytes, content: bytes) -> bytes:
    check = zlib.crc32(content, zlib.crc32(name))
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)
