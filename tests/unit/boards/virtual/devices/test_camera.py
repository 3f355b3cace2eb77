"""The camera: pictures, noise and faults."""

import io
import math
import subprocess
import sys

import pytest
from PIL import Image

from uros.boards.virtual.devices.camera import LARGE, Camera
from uros.boards.virtual.world.arena import Arena
from uros.boards.virtual.world.renderer import Scene


def opened(data: bytes) -> Image.Image:
    picture = Image.open(io.BytesIO(data))
    picture.load()
    return picture


def test_qvga_from_anywhere_fits_into_the_documents_buffer() -> None:
    place = [0.0, 0.0, 0.0]
    camera = Camera("camera", Scene(Arena(4)), lambda: (place[0], place[1], place[2]))
    for x, y in ((0, 0), (0.9, 0.9), (-1.2, 0.4), (1.3, 0)):
        for turn in range(8):
            place[:] = [x, y, turn * math.pi / 4]
            data = camera.capture()
            assert data[:2] == b"\xff\xd8" and data[-2:] == b"\xff\xd9"
            assert 4000 < len(data) < LARGE
            assert opened(data).size == (320, 240)


def test_other_sizes_and_qualities() -> None:
    camera = Camera()
    assert opened(camera.capture(160, 120)).size == (160, 120)
    assert opened(camera.capture(640, 480)).size == (640, 480)
    sizes = [len(camera.capture(quality=quality)) for quality in (10, 40, 70, 95)]
    assert sizes == sorted(sizes)
    for wrong in ((0, 240), (320, 10_000)):
        with pytest.raises(ValueError, match="pixels"):
            camera.capture(*wrong)
    for quality in (0, 96):
        with pytest.raises(ValueError, match="quality"):
            camera.capture(quality=quality)


def test_the_ball_moves_before_a_camera_at_rest() -> None:
    camera = Camera()
    first = opened(camera.capture())
    camera.advance(2_000_000)
    second = opened(camera.capture())
    changed = sum(
        sum(abs(a - b) for a, b in zip(before, after, strict=True)) > 150
        for before, after in zip(_pixels(first), _pixels(second), strict=True)
    )
    assert changed > 100


def _pixels(picture: Image.Image) -> list[tuple[int, int, int]]:
    data = picture.tobytes()
    return list(zip(data[::3], data[1::3], data[2::3], strict=True))


def test_its_noise_comes_from_the_seed() -> None:
    camera, same, different = Camera(seed=1), Camera(seed=1), Camera(seed=2)
    pictures = [camera.capture(), camera.capture()]
    assert pictures[0] != pictures[1]
    assert pictures == [same.capture(), same.capture()]
    assert different.capture() != pictures[0]


def test_a_failed_camera_returns_no_picture() -> None:
    camera = Camera()
    camera.fault("failed")
    assert camera.capture() == b""
    camera.heal()
    assert camera.capture()


def test_the_fault_large_gives_pictures_above_the_limit() -> None:
    camera = Camera()
    camera.fault("large")
    data = camera.capture()
    assert len(data) > LARGE and opened(data).size == (320, 240)
    tiny = camera.capture(32, 32, 10)
    assert len(tiny) > LARGE


def test_the_fault_torn_gives_truncated_pictures() -> None:
    camera = Camera()
    camera.fault("torn")
    data = camera.capture()
    assert data[:2] == b"\xff\xd8" and data[-2:] != b"\xff\xd9"
    with pytest.raises(OSError, match="truncated"):
        opened(data)


def test_the_fault_dark_gives_dark_pictures() -> None:
    camera = Camera()
    bright = opened(camera.capture()).convert("L")
    camera.fault("dark")
    dark = opened(camera.capture()).convert("L")
    assert sum(dark.tobytes()) < 0.1 * sum(bright.tobytes())


def test_the_visible_state() -> None:
    camera = Camera()
    assert camera.shows() == "no picture yet"
    data = camera.capture()
    assert camera.shows() == f"1 pictures, {len(data)} octets"


def test_pillow_is_loaded_with_the_first_picture_only() -> None:
    program = (
        "import sys\nfrom uros.boards.virtual.devices.camera import Camera\ncamera = Camera()\n"
        "assert 'PIL' not in sys.modules\ncamera.capture()\nassert 'PIL' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
