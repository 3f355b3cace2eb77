"""A camera that takes JPEG pictures of the room that it stands in, as an OV2640 does."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Final

from ..hardware.parts import Part
from ..world.renderer import Scene, pillow

if TYPE_CHECKING:
    from PIL.Image import Image

# What a picture of the documents may have.
LARGE: Final = 20_000
_WIDEST: Final = 1600  # of an OV2640
_SLOW_START_US: Final = 700_000
_NOISE: Final = 5.0  # the deviation of a pixel's brightness, of 255


class Camera(Part):
    """``where()`` is its true pose: x, y in metres, theta in radians; one that stands in a room
    needs none. On a rover it is ``lambda: (rover.x, rover.y, rover.theta)``.

    ``seed`` makes its noise: the same pictures in the same order have the same octets.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "failed": "takes no picture",
        "large": "its pictures are over 20,000 octets",
        "torn": "its pictures end in the middle",
        "dark": "hardly any light falls in",
        "slow": "its start takes 0.7 s",
    }

    def __init__(
        self,
        name: str = "camera",
        scene: Scene | None = None,
        where: Callable[[], tuple[float, float, float]] | None = None,
        seed: object = 0,
    ) -> None:
        super().__init__(name)
        self.scene = scene if scene is not None else Scene(ball=True)
        self.where = where if where is not None else lambda: (-1.25, 0.35, -0.25)
        self.count = 0  # of pictures taken
        self.last = b""
        self._seed = seed
        self._t_us = 0
        self._grain: Image | None = None

    @property
    def start_us(self) -> int:
        """How long its driver takes to start it."""
        return _SLOW_START_US if "slow" in self.faults else 0

    def advance(self, t_us: int) -> None:
        self._t_us = t_us

    def shows(self) -> str:
        if not self.count:
            return "no picture yet"
        return f"{self.count} pictures, {len(self.last)} octets"

    def capture(self, width: int = 320, height: int = 240, quality: int = 80) -> bytes:
        """A JPEG picture of what is in front of it now, of ``quality`` 1 to 95; b"" where that
        failed. Raises ValueError for a size that no OV2640 has, NoPillow.
        """
        if not (16 <= width <= _WIDEST and 16 <= height <= _WIDEST):
            raise ValueError(f"a picture has 16 to {_WIDEST} pixels a side, not {width} x {height}")
        if not 1 <= quality <= 95:
            raise ValueError(f"quality is 1 to 95, not {quality}")
        if "failed" in self.faults:
            self.last = b""
            return b""
        picture = self.scene.draw(*self.where(), width, height, self._t_us)
        source = random.Random(f"{self._seed}/camera/{self.count}")
        self.count += 1
        large = "large" in self.faults
        light = 0.06 if "dark" in self.faults else 1.0
        picture = self._expose(picture, source, light, 40.0 if large else _NOISE)
        data = _jpeg(picture, quality)
        while large and len(data) <= LARGE:
            if quality >= 95:
                # So small a picture has no more: an OV2640's buffer is sent with what is behind.
                data += bytes(LARGE + 1 - len(data))
                break
            quality = min(quality + 5, 95)
            data = _jpeg(picture, quality)
        if "torn" in self.faults:
            data = data[: len(data) * source.randrange(30, 80) // 100]
        self.last = data
        return data

    def _expose(self, picture: Image, source: random.Random, light: float, noise: float) -> Image:
        """With the sensor's noise, which is there in the dark too."""
        image_module, _, _ = pillow()
        from PIL import ImageChops

        if light != 1.0:
            picture = picture.point([int(it * light) for it in range(256)] * 3)
        width, height = picture.size
        if self._grain is None or self._grain.size != (width + 64, height + 64):
            # Made once, and laid elsewhere each time: Gaussian, by the sum of four octets.
            grain = random.Random(f"{self._seed}/grain")
            size = (width + 64) * (height + 64)
            rows = [grain.randbytes(size) for _ in range(4)]
            # Four uniform octets have a deviation of 148 together: 32 is left of it here.
            mean = bytes(
                min(max(128 + (a + b + c + d - 510) * 32 // 148, 0), 255)
                for a, b, c, d in zip(*rows, strict=True)
            )
            self._grain = image_module.frombytes("L", (width + 64, height + 64), mean)
        left, top = source.randrange(64), source.randrange(64)
        cut = self._grain.crop((left, top, left + width, top + height))
        grey = image_module.merge("RGB", (cut, cut, cut))
        scale = noise / 32
        grey = grey.point([int(128 + (it - 128) * scale) for it in range(256)] * 3)
        return ImageChops.add(picture, grey, 1.0, -128)


def _jpeg(picture: Image, quality: int) -> bytes:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality)
    return file.getvalue()
