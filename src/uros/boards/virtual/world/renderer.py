"""Draws what a camera in an arena sees; needs Pillow (extra ``board``).

Walls and boxes are drawn column by column, each from a strip of its texture; the floor is one
plane in perspective. Each wall has its letter, N, E, S or W, beside chequered fields and stripes,
so that pictures show where the camera points and that it moves.
"""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING, Any, Final

from .arena import WALL, Arena, Box

if TYPE_CHECKING:
    from PIL.Image import Image

HEIGHT: Final = 0.1  # of the camera above the floor, m
VIEW: Final = math.radians(62)  # the horizontal field of view

_TEXELS: Final = 160  # per metre of a wall
_FLOOR: Final = 100  # texels per metre of the floor
_NEAR: Final = 0.02  # m: the smallest depth
_BALL: Final = 0.08  # radius of the ball, m
_BALL_PATH: Final = 0.45  # radius of the circle that it rolls, m
_BALL_SECONDS: Final = 7.0  # for one revolution

_WALLS: Final = {
    "n": ((176, 196, 214), (40, 70, 120), "N"),
    "e": ((222, 206, 170), (150, 60, 40), "E"),
    "s": ((190, 206, 182), (40, 100, 60), "S"),
    "w": ((214, 190, 200), (110, 50, 110), "W"),
}
# The brightness of each side of a box: the light comes from the south-west.
_LIGHT: Final = {"n": 0.6, "e": 0.75, "s": 1.0, "w": 0.9}


class NoPillow(ImportError):
    """Pillow is not installed."""


def pillow() -> Any:
    """Return PIL's Image, ImageDraw and ImageFont, imported with the first picture.

    Raises:
        NoPillow: Pillow is not installed.
    """
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise NoPillow(
            "pictures need Pillow, which is not installed: python -m pip install pillow"
        ) from error
    return Image, ImageDraw, ImageFont


class Scene:
    """What a camera sees: an arena.

    Args:
        arena: The room; by default the arena of seed 0.
        ball: Whether a red ball rolls around its middle, so that the pictures of a camera at rest
            differ.
    """

    def __init__(self, arena: Arena | None = None, *, ball: bool = False) -> None:
        self.arena = arena if arena is not None else Arena()
        self.ball = ball
        self._walls: dict[str, Image] = {}
        self._boxes: dict[tuple[Box, str], Image] = {}
        self._floor: Image | None = None

    def ball_at(self, t_us: int) -> tuple[float, float]:
        """Return the position of the ball at ``t_us`` in µs since power-on, in metres."""
        turn = math.tau * (t_us % int(_BALL_SECONDS * 1e6)) / (_BALL_SECONDS * 1e6)
        return _BALL_PATH * math.cos(turn), _BALL_PATH * math.sin(turn)

    def draw(
        self, x: float, y: float, theta: float, width: int, height: int, t_us: int = 0
    ) -> Image:
        """Draw the picture that an ideal camera takes.

        Args:
            x: The camera's position in metres, to the east.
            y: The camera's position in metres, to the north.
            theta: The camera's yaw in rad, counter-clockwise from east (REP 103).
            width: The width of the picture in pixels.
            height: The height of the picture in pixels.
            t_us: The time in µs since power-on, which moves the ball.

        Raises:
            NoPillow: Pillow is not installed.
        """
        image_module, draw_module, _ = pillow()
        picture = image_module.new("RGB", (width, height), (226, 226, 220))
        self._prepare()
        focal = width / 2 / math.tan(VIEW / 2)
        self._draw_floor(picture, x, y, theta, focal)
        ball = self._see_ball(x, y, theta, t_us) if self.ball else None
        # All columns behind the ball are drawn before it, the others after it.
        columns: list[tuple[float, int, Image, int, int, int]] = []
        cos, sin = math.cos(theta), math.sin(theta)
        for column in range(width):
            aside = (width / 2 - column - 0.5) / focal
            # Of length 1 along the camera's optical axis, so that the distance is the depth.
            dx, dy = cos - aside * sin, sin + aside * cos
            for hit in self.arena.cast_ray(x, y, dx, dy):
                depth = max(hit.distance, _NEAR)
                if hit.box is None:
                    strip, high = self._walls[hit.side], WALL
                else:
                    strip, high = self._boxes[hit.box, hit.side], hit.box.height
                texel = min(max(int(hit.along * _TEXELS), 0), strip.width - 1)
                top = height / 2 - (high - HEIGHT) * focal / depth
                bottom = height / 2 + HEIGHT * focal / depth
                columns.append((depth, column, strip, texel, round(top), round(bottom)))
        if ball is not None:
            for piece in columns:
                if piece[0] > ball[0]:
                    _paste(picture, piece)
            self._draw_ball(picture, draw_module, ball, focal)
            columns = [piece for piece in columns if piece[0] <= ball[0]]
        for piece in columns:
            _paste(picture, piece)
        return picture  # type: ignore[no-any-return]

    # Textures.

    def _prepare(self) -> None:
        if not self._walls:
            for side in _WALLS:
                self._walls[side] = self._wall(side)
            for box in self.arena.boxes:
                for side in _LIGHT:
                    self._boxes[box, side] = _crate(box, side)
            self._floor = self._tiles()

    def _wall(self, side: str) -> Image:
        image_module, draw_module, font_module = pillow()
        paint, ink, letter = _WALLS[side]
        source = random.Random(f"{self.arena.seed}/{side}")
        wide, high = round(self.arena.size * _TEXELS), round(WALL * _TEXELS)
        image = image_module.new("RGB", (wide, high), paint)
        draw = draw_module.Draw(image)
        # A skirting board, and stripes at both ends.
        draw.rectangle((0, high - 10, wide, high), (90, 74, 60))
        for at in (*range(6, wide // 5, 24), *range(wide - wide // 5, wide, 24)):
            draw.rectangle((at, 8, at + 10, high - 16), ink)
        # A letter on a sheet, and a chequered field on either side, one of them shifted.
        middle = wide // 2 + source.randrange(-20, 20)
        draw.rectangle((middle - 36, 6, middle + 36, high - 14), (248, 248, 244), ink, 3)
        draw.text((middle, high // 2 - 4), letter, ink, font_module.load_default(62), anchor="mm")
        size = 12
        for left in (middle - 110 + source.randrange(-10, 10), middle + 50):
            for row in range(5):
                for column in range(4):
                    if (row + column) & 1:
                        corner = left + column * size, 12 + row * size
                        draw.rectangle((*corner, corner[0] + size - 1, corner[1] + size - 1), ink)
        return image  # type: ignore[no-any-return]

    def _tiles(self) -> Image:
        image_module, draw_module, _ = pillow()
        side = round(self.arena.size * _FLOOR)
        image = image_module.new("RGB", (side, side), (168, 150, 128))
        draw = draw_module.Draw(image)
        source = random.Random(f"{self.arena.seed}/floor")
        tile = _FLOOR // 4
        for column in range(0, side, tile):
            for row in range(0, side, tile):
                shade = source.randrange(-7, 8) + (16 if (column + row) // tile & 1 else -10)
                colour = (168 + shade, 150 + shade, 128 + shade)
                draw.rectangle((column, row, column + tile - 2, row + tile - 2), colour)
        return image  # type: ignore[no-any-return]

    # Drawing.

    def _draw_floor(self, picture: Image, x: float, y: float, theta: float, focal: float) -> None:
        """Draw the floor below the horizon.

        The point on the floor of a pixel is a quotient of linear functions of the pixel's position,
        which are the coefficients of Pillow's perspective transform.
        """
        image_module, _, _ = pillow()
        width, height = picture.size
        # From the row below the horizon on; the horizon itself is far behind the walls.
        horizon = height // 2 + 1
        rows = height - horizon
        cos, sin = math.cos(theta), math.sin(theta)
        half = self.arena.size / 2
        # At u to the right of the optical axis and v below it the depth is HEIGHT * focal / v, and
        # the point HEIGHT / v * (focal * ahead + u * to the right). Pillow adds half a pixel.
        u0, v0 = -width / 2, horizon - height / 2
        # East of the texture's left edge, and south of its top, in texels, times v.
        east = (HEIGHT * sin, x + half, HEIGHT * (focal * cos + u0 * sin) + (x + half) * v0)
        south = (HEIGHT * cos, half - y, HEIGHT * (u0 * cos - focal * sin) + (half - y) * v0)
        # v is the divisor, with its constant part 1.
        terms = [term * _FLOOR / v0 for term in (*east, *south)] + [0.0, 1 / v0]
        assert self._floor is not None
        floor = self._floor.transform(
            (width, rows),
            image_module.Transform.PERSPECTIVE,
            terms,
            image_module.Resampling.BILINEAR,
        )
        picture.paste(floor, (0, horizon))

    def _see_ball(self, x: float, y: float, theta: float, t_us: int) -> tuple[float, float] | None:
        """Return the ball's depth and its offset to the left; None behind the camera."""
        ball_x, ball_y = self.ball_at(t_us)
        cos, sin = math.cos(theta), math.sin(theta)
        depth = (ball_x - x) * cos + (ball_y - y) * sin
        return (depth, (ball_y - y) * cos - (ball_x - x) * sin) if depth > 2 * _BALL else None

    def _draw_ball(
        self, picture: Image, draw_module: Any, ball: tuple[float, float], focal: float
    ) -> None:
        depth, left = ball
        scale = focal / depth
        middle = picture.width / 2 - left * scale
        down = picture.height / 2 + (HEIGHT - _BALL) * scale
        size = _BALL * scale
        draw = draw_module.Draw(picture)
        ground = picture.height / 2 + HEIGHT * scale
        draw.ellipse(
            (middle - size, ground - size / 5, middle + size, ground + size / 5), (96, 84, 70)
        )
        # Shaded in a few rings, lighter towards the light.
        for ring in range(6):
            part = 1 - ring / 6
            shift = (1 - part) * size * 0.4
            colour = (150 + 17 * ring, 20 + 16 * ring, 18 + 16 * ring)
            around = (
                middle - shift - size * part,
                down - shift - size * part,
                middle - shift + size * part,
                down - shift + size * part,
            )
            draw.ellipse(around, colour)


def _crate(box: Box, side: str) -> Image:
    """Draw one side of a box: its colour, a darker frame, a band."""
    image_module, draw_module, _ = pillow()
    wide = box.x1 - box.x0 if side in "ns" else box.y1 - box.y0
    size = max(round(wide * _TEXELS), 4), max(round(box.height * _TEXELS), 4)
    light = _LIGHT[side]
    paint = tuple(int(value * light) for value in box.colour)
    dark = tuple(int(value * light * 0.6) for value in box.colour)
    pale = tuple(int((value + 255) / 2 * light) for value in box.colour)
    image = image_module.new("RGB", size, paint)
    draw = draw_module.Draw(image)
    draw.rectangle((0, size[1] * 0.4, size[0], size[1] * 0.6), pale)
    draw.rectangle((0, 0, size[0] - 1, size[1] - 1), None, dark, 2)
    return image  # type: ignore[no-any-return]


def _paste(picture: Image, piece: tuple[float, int, Image, int, int, int]) -> None:
    """Draw one column of a wall or a box, only the part that is inside the picture."""
    image_module, _, _ = pillow()
    _, column, strip, texel, top, bottom = piece
    if bottom <= top:
        return
    above, below = max(top, 0), min(bottom, picture.height)
    scale = strip.height / (bottom - top)
    source = (texel, (above - top) * scale, texel + 1, (below - top) * scale)
    if below > above:
        resized = strip.resize((1, below - above), image_module.Resampling.BOX, source)
        picture.paste(resized, (column, above))
