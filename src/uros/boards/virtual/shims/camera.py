"""The interface of micropython-camera-API's ``camera``, on a board with a camera."""

import struct

import _board  # type: ignore[import-not-found]


class PixelFormat:
    """The pixel formats."""

    JPEG = 4


class FrameSize:
    """The frame sizes."""

    QQVGA = 1
    QVGA = 5
    VGA = 8


class GrabMode:
    """The modes of grabbing frames."""

    WHEN_EMPTY = 0
    LATEST = 1


_SIZES = {FrameSize.QQVGA: (160, 120), FrameSize.QVGA: (320, 240), FrameSize.VGA: (640, 480)}


class Camera:
    """Takes JPEG pictures. Arguments for pins and clock are ignored: the board has its own."""

    def __init__(
        self, *, frame_size: int = FrameSize.QVGA, pixel_format: int = PixelFormat.JPEG,
        jpeg_quality: int = 85, fb_count: int = 1, grab_mode: int = GrabMode.WHEN_EMPTY,
        init: bool = True, **pins: object,
    ) -> None:  # fmt: skip
        if pixel_format != PixelFormat.JPEG:
            raise ValueError("this camera makes JPEG pictures only")
        if frame_size not in _SIZES:
            raise ValueError("this camera does not support the frame size")
        self._settings = struct.pack("<HHB", *_SIZES[frame_size], jpeg_quality)
        if init:
            self.init()

    def init(self) -> None:
        """Initialise the camera; raise OSError where there is none."""
        _board.call(_board.CAMERA, struct.pack("<HHB", 0, 0, 0))

    def deinit(self) -> None:
        """Release the camera; does nothing here."""

    def capture(self) -> "memoryview | None":
        """Return a picture, None where it failed."""
        picture = _board.call(_board.CAMERA, self._settings)
        return memoryview(picture) if picture else None

    def free_buffer(self) -> None:
        """Free the buffer of the last picture; does nothing here."""
