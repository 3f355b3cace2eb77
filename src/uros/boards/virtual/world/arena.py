"""The room that a rover drives in: four walls, and coloured boxes on the floor.

Lengths are in metres. The middle of the floor is (0, 0); x points east and y north (REP 103). Boxes
and walls are parallel to the axes. Positions, sizes and colours of the boxes come from the seed;
the rectangle from x = -0.25 to 1.15 and from y = -1.15 to 1.15 is always free, so that squares of
one metre can be driven from the middle to either side.
"""

from __future__ import annotations

import math
import random
from typing import Final, NamedTuple

SIZE: Final = 3.0
WALL: Final = 0.6  # height

_COLOURS: Final = (
    (196, 44, 40),
    (38, 92, 180),
    (236, 186, 36),
    (46, 140, 72),
    (142, 70, 160),
    (230, 122, 30),
)
# The approximate centres of the boxes.
_PLACES: Final = ((-1.0, 0.85), (-0.8, -0.75), (-1.15, -0.05), (1.36, 1.34), (1.36, -1.34))


class Box(NamedTuple):
    """A box on the floor, from (x0, y0) to (x1, y1), with its height and RGB colour."""

    x0: float
    y0: float
    x1: float
    y1: float
    height: float
    colour: tuple[int, int, int]

    def distance(self, x: float, y: float) -> float:
        """Return the distance from a point to the nearest side; 0 inside."""
        return math.hypot(max(self.x0 - x, 0.0, x - self.x1), max(self.y0 - y, 0.0, y - self.y1))


class RayHit(NamedTuple):
    """Where a ray hits a box or a wall.

    Attributes:
        distance: The distance, in multiples of the length of the ray's direction vector.
        box: The box, or None for a wall.
        side: Its side: "n", "e", "s" or "w", as seen from the middle of the room or of the box.
        along: The distance in metres from the side's left end, as seen by the viewer.
    """

    distance: float
    box: Box | None
    side: str
    along: float


class Arena:
    """A square room.

    Args:
        seed: The seed of the boxes.
        size: The length of its sides in metres.
        boxes: The boxes; by default those of the seed.
    """

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

    def is_free(self, x: float, y: float, radius: float) -> bool:
        """Return whether a round body has room there without touching a wall or a box."""
        half = self.size / 2 - radius
        if abs(x) > half or abs(y) > half:
            return False
        return all(box.distance(x, y) >= radius for box in self.boxes)

    def cast_ray(self, x: float, y: float, dx: float, dy: float) -> list[RayHit]:
        """Cast a ray from a point inside the room.

        Args:
            x: Where it starts, in metres.
            y: Where it starts, in metres.
            dx: Its direction vector.
            dy: Its direction vector.

        Returns:
            The hits, the farthest first: a wall, then each box in front of it once. A box that
            the ray starts in is not hit.
        """
        half = self.size / 2
        distance, side, along = math.inf, "e", 0.0
        if dx:
            distance = ((half if dx > 0 else -half) - x) / dx
            at = y + distance * dy
            side, along = ("e", half - at) if dx > 0 else ("w", at + half)
        if dy:
            y_distance = ((half if dy > 0 else -half) - y) / dy
            if y_distance < distance:
                distance = y_distance
                at = x + distance * dx
                side, along = ("n", at + half) if dy > 0 else ("s", half - at)
        hits = [RayHit(distance, None, side, along)]
        for box in self.boxes:
            hit = _meet(box, x, y, dx, dy)
            if hit is not None and hit.distance < distance:
                hits.append(hit)
        hits.sort(key=lambda hit: -hit.distance)
        return hits

    def range(self, x: float, y: float, theta: float) -> float:
        """Return the distance to the nearest box or wall in a direction (rad), in metres."""
        return self.cast_ray(x, y, math.cos(theta), math.sin(theta))[-1].distance


def _meet(box: Box, x: float, y: float, dx: float, dy: float) -> RayHit | None:
    """Return where a ray enters a box; None where it does not, or starts inside."""
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
    return RayHit(enter, box, side, along)
