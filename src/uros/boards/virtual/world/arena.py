"""The room that a rover drives in: four walls, and coloured boxes on the floor.

Lengths are in metres. The middle of the floor is (0, 0); x points east and y north. Boxes and walls
are parallel to the axes. What stands where, and which colours it has, comes from the seed; the
square that reaches from x = -0.25 to 1.15 and from y = -1.15 to 1.15 is always free, so that
squares of one metre can be driven from the middle to either side.
"""

from __future__ import annotations

import math
import random
from typing import Final, NamedTuple

SIZE: Final = 3.0
WALL: Final = 0.6  # high

_COLOURS: Final = (
    (196, 44, 40),
    (38, 92, 180),
    (236, 186, 36),
    (46, 140, 72),
    (142, 70, 160),
    (230, 122, 30),
)
# About where boxes stand.
_PLACES: Final = ((-1.0, 0.85), (-0.8, -0.75), (-1.15, -0.05), (1.36, 1.34), (1.36, -1.34))


class Box(NamedTuple):
    """From (x0, y0) to (x1, y1), ``height`` high."""

    x0: float
    y0: float
    x1: float
    y1: float
    height: float
    colour: tuple[int, int, int]

    def distance(self, x: float, y: float) -> float:
        """From a point to its nearest side; 0 inside."""
        return math.hypot(max(self.x0 - x, 0.0, x - self.x1), max(self.y0 - y, 0.0, y - self.y1))


class Hit(NamedTuple):
    """What a ray meets: how far along, in multiples of the ray's own length, on which box (None is
    a wall), on which side ("n", "e", "s", "w", as seen from the middle of the room or of the box),
    and how far from that side's left end as one looks at it.
    """

    far: float
    box: Box | None
    side: str
    along: float


class Arena:
    """A square room with sides of ``size``, with ``boxes`` in it or those of the seed."""

    def __init__(
        self, seed: object = 0, size: float = SIZE, boxes: list[Box] | None = None
    ) -> None:
        self.size = size
        self.seed = seed
        self.boxes = self._furnish() if boxes is None else boxes

    def _furnish(self) -> list[Box]:
        source = random.Random(f"{self.seed}/arena")
        colours = list(_COLOURS)
        source.shuffle(colours)
        boxes = []
        for (x, y), colour in zip(_PLACES, colours, strict=False):
            corner = x > 0
            wide = 0.1 if corner else source.uniform(0.12, 0.25)
            deep = 0.1 if corner else source.uniform(0.12, 0.25)
            if not corner:
                x += source.uniform(-0.1, 0.1)
                y += source.uniform(-0.1, 0.1)
            height = source.uniform(0.2, 0.4)
            boxes.append(
                Box(x - wide / 2, y - deep / 2, x + wide / 2, y + deep / 2, height, colour)
            )
        return boxes

    def free(self, x: float, y: float, radius: float) -> bool:
        """Whether a round thing stands there without touching anything."""
        half = self.size / 2 - radius
        if abs(x) > half or abs(y) > half:
            return False
        return all(box.distance(x, y) >= radius for box in self.boxes)

    def look(self, x: float, y: float, dx: float, dy: float) -> list[Hit]:
        """What a ray from inside of the room meets, the farthest first: a wall, and before it the
        boxes, each once. A box that it begins in is not seen.
        """
        half = self.size / 2
        far, side, along = math.inf, "e", 0.0
        if dx:
            far = ((half if dx > 0 else -half) - x) / dx
            at = y + far * dy
            side, along = ("e", half - at) if dx > 0 else ("w", at + half)
        if dy:
            other = ((half if dy > 0 else -half) - y) / dy
            if other < far:
                far = other
                at = x + far * dx
                side, along = ("n", at + half) if dy > 0 else ("s", half - at)
        hits = [Hit(far, None, side, along)]
        for box in self.boxes:
            hit = _meet(box, x, y, dx, dy)
            if hit is not None and hit.far < far:
                hits.append(hit)
        hits.sort(key=lambda hit: -hit.far)
        return hits

    def range(self, x: float, y: float, theta: float) -> float:
        """How far it is to whatever stands in a direction, in metres."""
        return self.look(x, y, math.cos(theta), math.sin(theta))[-1].far


def _meet(box: Box, x: float, y: float, dx: float, dy: float) -> Hit | None:
    """Where a ray enters a box; None where it does not, or is inside already."""
    enter, leave, side = 0.0, math.inf, ""
    if dx:
        near, away = (box.x0, box.x1) if dx > 0 else (box.x1, box.x0)
        enter_x, leave = (near - x) / dx, (away - x) / dx
        if enter_x > enter:
            enter, side = enter_x, "w" if dx > 0 else "e"
    elif not box.x0 <= x <= box.x1:
        return None
    if dy:
        near, away = (box.y0, box.y1) if dy > 0 else (box.y1, box.y0)
        enter_y = (near - y) / dy
        leave = min(leave, (away - y) / dy)
        if enter_y > enter:
            enter, side = enter_y, "s" if dy > 0 else "n"
    elif not box.y0 <= y <= box.y1:
        return None
    if not side or enter >= leave:
        return None
    if side in "we":
        at = y + enter * dy
        along = box.y1 - at if side == "w" else at - box.y0
    else:
        at = x + enter * dx
        along = at - box.x0 if side == "s" else box.x1 - at
    return Hit(enter, box, side, along)
