"""``camera`` as the images of micropython-camera-API have it, on a board with a camera."""

import struct

import _board  # type: ignore[import-not-found]


class PixelFormat:
    JPEG = 4


class FrameSize:
    QQVGA = 1
    QVGA = 5
    VGA = 8


class GrabMode:
    WHEN_EMPTY = 0
    LATEST = 1


_SIZES = {FrameSize.QQVGA: (160, 120), FrameSize.QVGA: (320, 240), FrameSize.VGA: (640, 480)}


class Camera:
    """Takes JPEG pictures. Pins and clock are the board's own, whatever is given."""

    def __init__(
        self, *, frame_size: int = FrameSize.QVGA, pixel_format: int = PixelFormat.JPEG,
        jpeg_quality: int = 85, fb_count: int = 1, grab_mode: int = GrabMode.WHEN_EMPTY,
        init: bool = True, **pins: object,
    ) -> None:  # fmt: skip
        if pixel_format != PixelFormat.JPEG:
            raise ValueError("this camera makes JPEG")
        if frame_size not in _SIZES:
            raise ValueError("this camera makes no such size")
        self._settings = struct.pack("<HHB", *_SIZES[frame_size], jpeg_quality)
        if init:
            self.init()

    def init(self) -> None:
        """Raises OSError where there is no camera."""
        _board.call(_board.CAMERA, struct.pack("<HHB", 0, 0, 0))

    def deinit(self) -> None:
        pass

    def capture(self) -> "memoryview | None":
        """A picture, None if none could be taken."""
        picture = _board.call(_board.CAMERA, self._settings)
        return memoryview(picture) if picture else None

    def free_buffer(self) -> None:
        """The buffer of the last picture is free again."""
