"""firmware/spresense_camera: what is published, and what LED2 and LED3 tell of other pictures."""

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
    """The program's Pictures, with a camera that gives ``picture``, or raises it."""

    def __init__(self, monkeypatch):
        self.picture = None
        self.made = []  # the arguments of each Camera
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
        self.said = []
        self.main.print = lambda *words: self.said.append(" ".join(map(str, words)))
        self.node = SimpleNamespace(
            state=AGENT_CONNECTED,
            clock=SimpleNamespace(stamp=self.stamp),
            create_publisher=lambda *_: "publisher",
            create_timer=lambda *_: None,
        )
        self.pictures = self.main.Pictures(self.node)

    def camera(self, **options):
        self.made.append(options)
        if isinstance(self.picture, OSError):
            raise self.picture
        return SimpleNamespace(capture=lambda: self.picture)

    def stamp(self, stamp):
        stamp.sec = 1000 + len(self.published)

    def publish(self, publisher, message, length, source):
        data = b"".join(bytes(it) for it in source)
        assert (publisher, length) == ("publisher", len(data))
        self.published.append((message.header.stamp.sec, data))
        return True

    def tick(self, picture):
        """What is published, and the LEDs behind it."""
        self.picture = picture
        before = len(self.published)
        self.pictures.tick()
        return len(self.published) - before, Pin.levels[LED2], Pin.levels[LED3]


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def picture(size):
    """What begins and ends as a JPEG picture does, as the driver gives it."""
    return memoryview(b"\xff\xd8" + bytes(size - 4) + b"\xff\xd9")


def test_a_picture_of_up_to_20000_octets_is_published_and_a_larger_one_is_told(bench):
    assert bench.tick(picture(12_000)) == (1, 0, 0)
    assert bench.tick(picture(20_000)) == (1, 0, 0)
    assert bench.tick(picture(20_001)) == (0, 0, 1)
    assert bench.tick(picture(4)) == (1, 0, 0)
    assert [(sec, len(data)) for sec, data in bench.published] == [
        (1000, 12_000), (1001, 20_000), (1002, 4)
    ]  # fmt: skip
    image = bench.pictures.image
    assert (image.header.frame_id, image.format, len(image.data)) == ("myframe", "jpeg", 0)
    (options,) = bench.made
    assert (options["frame_size"], options["pixel_format"]) == (5, 4)


@pytest.mark.parametrize("bad", [None, memoryview(b""), picture(12_000)[:-1], memoryview(b"\xff")])
def test_no_picture_and_half_of_one_are_told(bench, bad):
    assert bench.tick(bad) == (0, 1, 0)
    assert bench.tick(picture(20_001)) == (0, 0, 1)
    assert bench.tick(bad) == (0, 1, 0)
    assert bench.tick(picture(100)) == (1, 0, 0)


def test_a_camera_that_is_not_there_is_told_and_looked_for_again(bench):
    assert bench.tick(OSError(19, "no such device")) == (0, 1, 0)
    assert bench.said == ["no camera: [Errno 19] no such device"]
    assert bench.tick(picture(100)) == (1, 0, 0)
    assert len(bench.made) == 2


def test_none_is_taken_without_an_agent_or_while_the_last_one_is_sent(bench):
    bench.node.state = WAITING_AGENT
    assert bench.tick(picture(100)) == (0, 0, 0) and not bench.made
    bench.node.state = AGENT_CONNECTED
    bench.busy = True
    assert bench.tick(picture(100)) == (0, 0, 0) and not bench.made
