"""firmware/spresense_camera: published pictures, and LED2 and LED3 for others."""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

import pytest
from support.paths import ROOT

from uros.client import AGENT_CONNECTED, WAITING_AGENT
from uros.interfaces import load

MAIN = ROOT / "firmware" / "spresense_camera" / "main.py"
LED2, LED3 = 40, 41


class Pin:
    OUT = 1
    levels: dict = {}

    def __init__(self, number, mode=0, value=0):
        self.number = number
        self.levels[number] = value

    def value(self, level):
        self.levels[self.number] = int(level)


class Bench:
    """The program's Pictures with a camera that returns ``picture``, or raises it."""

    def __init__(self, monkeypatch):
        self.picture = None
        self.cameras = []  # the arguments of each Camera
        self.published = []
        self.busy = False
        camera = ModuleType("camera")
        camera.Camera = self.camera
        camera.FrameSize = SimpleNamespace(QVGA=5)
        camera.GrabMode = SimpleNamespace(LATEST=1)
        camera.PixelFormat = SimpleNamespace(JPEG=4)
        machine = ModuleType("machine")
        machine.Pin, machine.UART = Pin, object
        messages = ModuleType("sensor_msgs.msg")
        messages.CompressedImage = load("sensor_msgs/msg/CompressedImage")
        for name, module in (
            ("camera", camera), ("machine", machine), ("sensor_msgs", ModuleType("sensor_msgs")),
            ("sensor_msgs.msg", messages),
        ):  # fmt: skip
            monkeypatch.setitem(sys.modules, name, module)
        spec = importlib.util.spec_from_file_location("spresense_camera_main", MAIN)
        self.main = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.main)
        self.main.publish_stream = self.publish
        self.main.streaming = lambda publisher: self.busy
        self.printed = []
        self.main.print = lambda *words: self.printed.append(" ".join(map(str, words)))
        self.node = SimpleNamespace(
            state=AGENT_CONNECTED,
            clock=SimpleNamespace(stamp=self.stamp),
            create_publisher=lambda *_: "publisher",
            create_timer=lambda *_: None,
        )
        self.pictures = self.main.Pictures(self.node)

    def camera(self, **options):
        self.cameras.append(options)
        if isinstance(self.picture, OSError):
            raise self.picture
        return SimpleNamespace(capture=lambda: self.picture)

    def stamp(self, stamp):
        stamp.sec = 1000 + len(self.published)

    def publish(self, publisher, message, length, source):
        data = b"".join(bytes(chunk) for chunk in source)
        assert (publisher, length) == ("publisher", len(data))
        self.published.append((message.header.stamp.sec, data))
        return True

    def tick(self, picture):
        """Handle a picture; return the number of publications, and LED2 and LED3."""
        self.picture = picture
        before = len(self.published)
        self.pictures.tick()
        return len(self.published) - before, Pin.levels[LED2], Pin.levels[LED3]


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def picture(size):
    """Return octets with the start and end of a JPEG picture, as the driver does."""
    return memoryview(b"\xff\xd8" + bytes(size - 4) + b"\xff\xd9")


def test_pictures_of_up_to_20000_octets_are_published_and_larger_ones_reported(bench):
    assert bench.tick(picture(12_000)) == (1, 0, 0)
    assert bench.tick(picture(20_000)) == (1, 0, 0)
    assert bench.tick(picture(20_001)) == (0, 0, 1)
    assert bench.tick(picture(4)) == (1, 0, 0)
    assert [(sec, len(data)) for sec, data in bench.published] == [
        (1000, 12_000), (1001, 20_000), (1002, 4)
    ]  # fmt: skip
    image = bench.pictures.image
    assert (image.header.frame_id, image.format, len(image.data)) == ("myframe", "jpeg", 0)
    (options,) = bench.cameras
    assert (options["frame_size"], options["pixel_format"]) == (5, 4)


@pytest.mark.parametrize("bad", [None, memoryview(b""), picture(12_000)[:-1], memoryview(b"\xff")])
def test_missing_and_incomplete_pictures_are_reported(bench, bad):
    assert bench.tick(bad) == (0, 1, 0)
    assert bench.tick(picture(20_001)) == (0, 0, 1)
    assert bench.tick(bad) == (0, 1, 0)
    assert bench.tick(picture(100)) == (1, 0, 0)


def test_a_missing_camera_is_reported_and_retried(bench):
    assert bench.tick(OSError(19, "no such device")) == (0, 1, 0)
    assert bench.printed == ["no camera: [Errno 19] no such device"]
    assert bench.tick(picture(100)) == (1, 0, 0)
    assert len(bench.cameras) == 2


def test_no_picture_is_taken_without_an_agent_or_during_a_stream(bench):
    bench.node.state = WAITING_AGENT
    assert bench.tick(picture(100)) == (0, 0, 0) and not bench.cameras
    bench.node.state = AGENT_CONNECTED
    bench.busy = True
    assert bench.tick(picture(100)) == (0, 0, 0) and not bench.cameras
