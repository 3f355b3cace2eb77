"""The arena: what a ray hits, and which places are free."""

import math

import pytest

from uros.boards.virtual.world.arena import Arena, Box

RED = (200, 40, 40)
BOX = Box(0.5, -0.2, 0.8, 0.2, 0.3, RED)


def test_the_walls_are_at_half_the_size() -> None:
    arena = Arena(size=3.0, boxes=[])
    assert arena.range(0, 0, 0) == pytest.approx(1.5)
    assert arena.range(0.5, 0.2, math.pi / 2) == pytest.approx(1.3)
    assert arena.range(0.5, 0.2, math.pi) == pytest.approx(2.0)
    assert arena.range(0, 0, math.pi / 4) == pytest.approx(1.5 * math.sqrt(2))
    sides = [arena.cast_ray(0, 0, dx, dy)[0].side for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    assert sides == ["e", "n", "w", "s"]


def test_along_grows_to_the_right_of_the_viewer() -> None:
    arena = Arena(size=3.0, boxes=[BOX])
    for heading in (0.0, math.pi / 2, math.pi, -math.pi / 2):
        left = arena.cast_ray(0, 0, math.cos(heading + 0.1), math.sin(heading + 0.1))[0]
        right = arena.cast_ray(0, 0, math.cos(heading - 0.1), math.sin(heading - 0.1))[0]
        assert 0 <= left.along < right.along <= 3
    # And on a box, from each side of it.
    for x, y in ((0, 0), (1.3, 0), (0.65, 1), (0.65, -1)):
        heading = math.atan2(-y, 0.65 - x)
        left = arena.cast_ray(x, y, math.cos(heading + 0.05), math.sin(heading + 0.05))[-1]
        right = arena.cast_ray(x, y, math.cos(heading - 0.05), math.sin(heading - 0.05))[-1]
        assert left.box is right.box is BOX
        assert 0 <= left.along < right.along <= 0.41


def test_a_box_is_hit_before_the_wall() -> None:
    arena = Arena(size=3.0, boxes=[BOX])
    wall, box = arena.cast_ray(0, 0, 1, 0)
    assert (wall.box, wall.distance) == (None, 1.5)
    assert (box.box, box.distance, box.side) == (BOX, 0.5, "w")
    assert len(arena.cast_ray(0, 0.3, 1, 0)) == 1
    assert len(arena.cast_ray(1, 0, 1, 0)) == 1, "the box is behind the ray"
    assert len(arena.cast_ray(0, -0.5, 1, 0.2)) == 1, "the ray passes its corner"
    assert arena.range(0.65, -1.0, math.pi / 2) == pytest.approx(0.8)


def test_a_round_body_needs_room_on_all_sides() -> None:
    arena = Arena(size=3.0, boxes=[BOX])
    assert arena.is_free(0, 0, 0.15)
    assert not arena.is_free(1.4, 0, 0.15)
    assert not arena.is_free(0, -1.36, 0.15)
    assert not arena.is_free(0.36, 0, 0.15)
    assert arena.is_free(0.34, 0, 0.15)
    assert not arena.is_free(0.6, 0, 0.15)
    # Near the corner, where the limit is a circle around it.
    assert arena.is_free(0.5 - 0.12, 0.2 + 0.12, 0.15)
    assert not arena.is_free(0.5 - 0.1, 0.2 + 0.1, 0.15)


@pytest.mark.parametrize("seed", range(20))
def test_squares_of_a_metre_are_free_in_every_room(seed: int) -> None:
    arena = Arena(seed)
    for step in range(101):
        at = step / 100
        for x, y in ((at, 0), (1, at), (1, -at), (at, 1), (at, -1), (0, at), (0, -at)):
            assert arena.is_free(x, y, 0.15), (x, y)
    assert len(arena.boxes) == 5
    for box in arena.boxes:
        assert -1.5 < box.x0 < box.x1 < 1.5 and -1.5 < box.y0 < box.y1 < 1.5


def test_rooms_come_from_their_seed() -> None:
    assert Arena(1).boxes == Arena(1).boxes != Arena(2).boxes
