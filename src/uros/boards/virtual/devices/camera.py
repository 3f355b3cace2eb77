"""An OV2640 camera: JPEG pictures of the room around it."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Final

from ..hardware.parts import Part
from ..world.renderer import Scene, pillow

if TYPE_CHECKING:
    from PIL.Image import Image

LARGE: Final = 20_000  # octets: the largest picture that the documented programs take
_WIDEST: Final = 1600  # pixels of an OV2640
_SLOW_START_US: Final = 700_000
_NOISE: Final = 5.0  # standard deviation of a pixel's brightness, of 255


class Camera(Part):
    """A camera in a scene.

    Attributes:
        scene: What it takes pictures of.
        pose: Returns its true pose.
        count: How many pictures were taken.
        last: The octets of the last picture, b"" when it failed.

    Args:
        name: The part's name.
        scene: What it takes pictures of; by default an arena with a rolling ball.
        pose: Returns its true pose in the arena: x and y in metres (east and north), theta in
            radians counter-clockwise from east (REP 103). By default it stands still.
        seed: The seed of its noise: the same pictures in the same order have the same octets.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "failed": "takes no picture",
        "large": "its pictures are over 20,000 octets",
        "torn": "its pictures are cut off in the middle",
        "dark": "there is hardly any light",
        "slow": "its initialisation takes 0.7 s",
    }

    def __init__(
        self,
        name: str = "camera",
        scene: Scene | None = None,
        pose: Callable[[], tuple[float, float, float]] | None = None,
        seed: object = 0,
    ) -> None:
        super().__init__(name)
        self.scene = scene if scene is not None else Scene(ball=True)
        self.pose = pose if pose is not None else lambda: (-1.25, 0.35, -0.25)
        self.count = 0
        self.last = b""
        self._seed = seed
        self._t_us = 0
        self._grain: Image | None = None

    @property
    def start_us(self) -> int:
        """How long its driver takes to initialise it, in µs."""
        return _SLOW_START_US if "slow" in self.faults else 0

    def advance(self, t_us: int) -> None:
        """Advance to the time ``t_us`` in µs since power-on."""
        self._t_us = t_us

    def shows(self) -> str:
        """Return how many pictures were taken and the size of the last one."""
        if not self.count:
            return "no picture yet"
        return f"{self.count} pictures, {len(self.last)} octets"

    def capture(self, width: int = 320, height: int = 240, quality: int = 80) -> bytes:
        """Take a picture.

        Args:
            width: Its width in pixels, 16 to 1600.
            height: Its height in pixels, 16 to 1600.
            quality: The JPEG quality, 1 to 95.

        Returns:
            The JPEG file, b"" with the fault "failed".

        Raises:
            ValueError: An OV2640 has no such size or quality.
            NoPillow: Pillow is not installed.
        """
        if not (16 <= width <= _WIDEST and 16 <= height <= _WIDEST):
            raise ValueError(f"a picture has 16 to {_WIDEST} pixels a side, not {width} x {height}")
        if not 1 <= quality <= 95:
            raise ValueError(f"quality is 1 to 95, not {quality}")
        if "failed" in self.faults:
            self.last = b""
            return b""
        picture = self.scene.draw(*self.pose(), width, height, self._t_us)
        noise_source = random.Random(f"{self._seed}/camera/{self.count}")
        self.count += 1
        large = "large" in self.faults
        light = 0.06 if "dark" in self.faults else 1.0
        picture = self._expose(picture, noise_source, light, 40.0 if large else _NOISE)
        data = _jpeg(picture, quality)
        while large and len(data) <= LARGE:
            if quality >= 95:
                # JPEG makes so small a picture no larger: pad it, as an OV2640 that sends more of
                # its buffer than the picture.
                data += bytes(LARGE + 1 - len(data))
                break
            quality = min(quality + 5, 95)
            data = _jpeg(picture, quality)
        if "torn" in self.faults:
            data = data[: len(data) * noise_source.randrange(30, 80) // 100]
        self.last = data
        return data

    def _expose(
        self, picture: Image, noise_source: random.Random, light: float, noise: float
    ) -> Image:
        """Scale the brightness by ``light`` and add noise, which does not depend on the light."""
        image_module, _, _ = pillow()
        from PIL import ImageChops

        if light != 1.0:
            picture = picture.point([int(value * light) for value in range(256)] * 3)
        width, height = picture.size
        if self._grain is None or self._grain.size != (width + 64, height + 64):
            # Made once, and shifted for each picture: Gaussian, as the sum of four octets.
            grain = random.Random(f"{self._seed}/grain")
            size = (width + 64) * (height + 64)
            rows = [grain.randbytes(size) for _ in range(4)]
            # The sum of four uniform octets has a standard deviation of 148, scaled to 32 here.
            mean = bytes(
                min(max(128 + (a + b + c + d - 510) * 32 // 148, 0), 255)
                for a, b, c, d in zip(*rows, strict=True)
            )
            self._grain = image_module.frombytes("L", (width + 64, height + 64), mean)
        left, top = noise_source.randrange(64), noise_source.randrange(64)
        cut = self._grain.crop((left, top, left + width, top + height))
        grey = image_module.merge("RGB", (cut, cut, cut))
        scale = noise / 32
        grey = grey.point([int(128 + (value - 128) * scale) for value in range(256)] * 3)
        return ImageChops.add(picture, grey, 1.0, -128)


def _jpeg(picture: Image, quality: int) -> bytes:
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality)
    return file.getvalue()
