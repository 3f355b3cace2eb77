"""Where objects are in a picture, against the geometry of a pinhole camera."""

import builtins
import math

import pytest
from PIL.Image import Image

from uros.boards.virtual.world import renderer as scene_module
from uros.boards.virtual.world.arena import WALL, Arena, Box
from uros.boards.virtual.world.renderer import HEIGHT, VIEW, NoPillow, Scene

RED = (250, 10, 10)
WIDTH, TALL = 320, 240
FOCAL = WIDTH / 2 / math.tan(VIEW / 2)


def is_red(pixel: object) -> bool:
    red, green, blue = pixel  # type: ignore[misc]
    return red > 90 and green < red * 0.75 and blue < red * 0.75 and green < red - 60


def reds(scene: Scene, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> list[tuple[int, int]]:
    picture = scene.draw(x, y, theta, WIDTH, TALL)
    return [
        (column, row)
        for column in range(WIDTH)
        for row in range(TALL)
        if is_red(picture.getpixel((column, row)))
    ]


def bare(*boxes: Box, ball: bool = False) -> Scene:
    """A room whose walls have no letters and stripes."""
    scene = Scene(Arena(size=3.0, boxes=list(boxes)), ball=ball)
    scene._prepare()
    for side in scene._walls:
        scene._walls[side].paste((200, 200, 200), (0, 0, *scene._walls[side].size))
    return scene


def test_a_box_has_the_place_of_the_pinhole_projection() -> None:
    # Its near side is 1 m away, 0.2 m wide, 0.1 m to the left, 0.3 m high.
    scene = bare(Box(1.0, 0.0, 1.2, 0.2, 0.3, RED))
    pixels = reds(scene)
    columns = [column for column, _ in pixels]
    rows = [row for _, row in pixels]
    assert min(columns) == pytest.approx(WIDTH / 2 - 0.2 * FOCAL, abs=2)
    # Its south side is edge-on: its right end is in the middle of the picture.
    assert max(columns) == pytest.approx(WIDTH / 2, abs=2)
    assert min(rows) == pytest.approx(TALL / 2 - (0.3 - HEIGHT) * FOCAL, abs=2)
    assert max(rows) == pytest.approx(TALL / 2 + HEIGHT * FOCAL, abs=2)


def test_turning_to_the_left_moves_objects_to_the_right() -> None:
    scene = bare(Box(1.0, -0.1, 1.2, 0.1, 0.3, RED))

    def middle(theta: float) -> float:
        columns = [column for column, _ in reds(scene, theta=theta)]
        return (min(columns) + max(columns)) / 2

    assert middle(0.2) - middle(0.0) == pytest.approx(math.tan(0.2) * FOCAL, abs=8)
    assert middle(-0.2) < middle(0.0)


def test_nearer_objects_are_larger() -> None:
    scene = bare(Box(1.0, -0.1, 1.2, 0.1, 0.2, RED))
    assert len(reds(scene, 0.5)) > 3 * len(reds(scene))


def test_objects_behind_the_camera_are_not_drawn() -> None:
    scene = bare(Box(-1.2, -0.1, -1.0, 0.1, 0.2, RED))
    assert not reds(scene)
    assert reds(scene, theta=math.pi)


def test_a_wall_ends_at_its_height() -> None:
    scene = Scene(Arena(size=3.0, boxes=[]))
    picture = scene.draw(0, 0, 0, WIDTH, TALL)
    top = TALL / 2 - (WALL - HEIGHT) * FOCAL / 1.5
    sky = picture.getpixel((5, round(top) - 3))
    wall = picture.getpixel((5, round(top) + 3))
    assert sky == (226, 226, 220) != wall


def test_the_floor_has_the_place_of_the_pinhole_projection() -> None:
    scene = bare()
    assert scene._floor is not None
    # A square of 0.2 m, its middle 0.8 m ahead of the camera and 0.3 m to its right.
    for x, y, theta in ((0.0, 0.0, 0.0), (0.4, -0.2, 2.0), (-0.3, 0.5, -1.2)):
        scene._floor.paste((168, 150, 128), (0, 0, *scene._floor.size))
        spot_x = x + 0.8 * math.cos(theta) + 0.3 * math.sin(theta)
        spot_y = y + 0.8 * math.sin(theta) - 0.3 * math.cos(theta)
        left, top = round((spot_x + 1.4) * 100), round((1.4 - spot_y) * 100)
        scene._floor.paste((250, 10, 10), (left, top, left + 20, top + 20))
        picture = scene.draw(x, y, theta, WIDTH, TALL)
        column = WIDTH / 2 + 0.3 / 0.8 * FOCAL
        row = TALL / 2 + HEIGHT / 0.8 * FOCAL
        assert is_red(picture.getpixel((round(column), round(row))))
        middle = _middle(picture)
        assert middle[0] == pytest.approx(column, abs=6)
        assert middle[1] == pytest.approx(row, abs=3)
        # With an odd number of rows everything is half a row further down.
        odd = _middle(scene.draw(x, y, theta, WIDTH, TALL + 1))
        assert odd[0] == pytest.approx(middle[0], abs=2)
        assert odd[1] == pytest.approx(middle[1] + 0.5, abs=0.7)


def _middle(picture: Image) -> tuple[float, float]:
    """Return the centre of the red spot on the floor."""
    spot = [
        (column, row)
        for column in range(picture.width)
        for row in range(picture.height // 2, picture.height)
        if is_red(picture.getpixel((column, row)))
    ]
    return sum(point[0] for point in spot) / len(spot), sum(point[1] for point in spot) / len(spot)


def test_a_ball_rolls_around_and_hides_what_is_behind_it() -> None:
    scene = bare(ball=True)
    places = set()
    for t_us in range(0, 7_000_000, 1_000_000):
        picture = scene.draw(-1.2, 0, 0, WIDTH, TALL, t_us)
        ball_x, ball_y = scene.ball_at(t_us)
        column = round(WIDTH / 2 - ball_y / (ball_x + 1.2) * FOCAL)
        row = round(TALL / 2 + (HEIGHT - 0.08) / (ball_x + 1.2) * FOCAL)
        assert is_red(picture.getpixel((column, row)))
        places.add(column)
    assert len(places) == 7
    assert scene.ball_at(0) == scene.ball_at(7_000_000)


def test_pictures_can_be_drawn_from_anywhere_and_in_any_size() -> None:
    scene = Scene(Arena(3), ball=True)
    for x, y in ((0, 0), (1.5, 1.5), (-1.5, 0), (-1.0, 0.85), (0.45, 0.0)):
        for theta in (0.0, 1.0, math.pi, -7.5):
            for size in ((16, 16), (33, 17), (160, 120)):
                assert scene.draw(x, y, theta, *size).size == size


def test_without_pillow_the_error_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def fake(name: str, *arguments: object) -> object:
        if name.startswith("PIL"):
            raise ImportError("no PIL")
        return real(name, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", fake)
    with pytest.raises(NoPillow, match="pip install pillow"):
        scene_module.pillow()
