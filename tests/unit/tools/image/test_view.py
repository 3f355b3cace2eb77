"""``uros image view``: what a page is told, and the whole of it over DDS and HTTP."""

import argparse
import http.client
import json
import re
import time
from functools import partial

import pytest
from support.screen import HOSTILE, visible_lines
from support.waiting import eventually
from unit.dashboard.test_pictures import JPEG, PNG

import uros
from uros.dashboard.pictures import picture
from uros.host.direct import Direct
from uros.host.network import Network
from uros.interfaces import load
from uros.middleware import open_middleware
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.tools.errors import ToolError
from uros.tools.image import view
from uros.tools.image.source import ImageSource, age
from uros.tools.pages import bind_error, open_pages

CompressedImage = load("sensor_msgs/msg/CompressedImage")
Image = load("sensor_msgs/msg/Image")
String = load("std_msgs/msg/String")
TOPIC = "/image/compressed"
SECOND = 1_000_000_000


def taken(data=JPEG, stamp=5):
    message = CompressedImage(format="jpeg", data=data)
    message.header.stamp.sec = stamp
    message.header.frame_id = "myframe"
    return message


# --- what pages are told ---------------------------------------------------------------------


@pytest.fixture
def shown(monkeypatch):
    monkeypatch.setattr(view, "_WAIT_SECONDS", 0.0)
    return view.Shown(TOPIC)


def test_the_state_before_the_first_picture(shown):
    shown.waiting("nobody publishes it")
    answer = shown.answer({})
    assert (answer.status, answer.body) == (200, b"")
    assert answer.about["trouble"] == "nobody publishes it"
    assert (answer.about["topic"], answer.about["picture"]) == (TOPIC, 0)
    assert "width" not in answer.about


def test_a_page_gets_escaped_text(shown):
    message = taken()
    message.header.frame_id = HOSTILE
    shown.add(picture(message), time.time_ns())
    shown.trouble(HOSTILE)
    about = shown.answer({}).about
    assert about["frame_id"].startswith("a\\x1b") and about["trouble"].startswith("a\\x1b")
    visible_lines(about["frame_id"] + about["trouble"])


def test_a_picture_is_sent_once(shown):
    shown.waiting("")
    shown.add(picture(taken()), time.time_ns())
    answer = shown.answer({"version": "-1", "picture": "-1"})
    assert (answer.body, answer.mime) == (JPEG, "image/jpeg")
    about = answer.about
    assert (about["width"], about["height"], about["octets"]) == (16, 8, len(JPEG))
    assert (about["was"], about["frame_id"], about["stamp"]) == ("jpeg", "myframe", "5.000000000")
    assert about["trouble"] == "" and about["ago"] < 5
    again = shown.answer({"picture": str(about["picture"])})
    assert again.body == b"" and again.about["width"] == 16


def test_a_broken_picture_is_reported_beside_the_last_valid_one(shown):
    shown.waiting("")
    shown.add(picture(taken()), time.time_ns())
    shown.trouble("an image cannot be shown: it is empty")
    answer = shown.answer({})
    assert answer.body == JPEG
    assert (answer.about["broken"], answer.about["trouble"]) == (
        1, "an image cannot be shown: it is empty",
    )  # fmt: skip
    shown.add(picture(taken(PNG)), time.time_ns())
    answer = shown.answer({})
    assert (answer.mime, answer.about["trouble"], answer.about["broken"]) == ("image/png", "", 1)


def test_the_rate(shown, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(view.time, "monotonic", lambda: now[0])

    def rate():
        return shown.answer({"version": "-1"}).about["rate"]

    for _ in range(21):
        shown.add(picture(taken()), 0)
        now[0] += 0.1
    now[0] -= 0.1
    assert rate() == 10.0
    now[0] += 1.9  # and it stops
    assert 5.0 < rate() < 6.0
    now[0] += 10
    assert rate() == 0.0


@pytest.mark.parametrize(
    ("stamp", "received", "text"),
    [
        (0, 5 * SECOND, "not stamped"),
        (5 * SECOND, 5 * SECOND + 12_000_000, "12 ms old"),
        (5 * SECOND, 8 * SECOND, "3.0 s old"),
        (5 * SECOND + 9_000_000, 5 * SECOND, "0 ms old"),
        (9 * SECOND, 5 * SECOND, "4.0 s in the future: two clocks differ"),
        (5 * SECOND, 1000 * SECOND, "17 min old"),
        (12 * SECOND, 1_700_000_000 * SECOND, "19676 d old: the sender's clock is not set"),
    ],
)
def test_the_age_by_the_stamp(stamp, received, text):
    assert age(stamp, received) == text


# --- where pictures come from ------------------------------------------------------------------


@pytest.fixture
def world(own_domain_id):
    """A network that looks, a node that publishes, and what was seen."""
    node = uros.Node("camera", Direct(open_middleware("auto"), own_domain_id))
    seen, troubles = [], []
    with Network(own_domain_id) as network:
        source = ImageSource(
            network, TOPIC, lambda picture, _: seen.append(picture), troubles.append
        )

        def until(done):
            deadline = time.monotonic() + 10
            while not done():
                assert time.monotonic() < deadline, (source.check(), seen, troubles)
                source.check()
                network.spin(done, 0.05)
                node.spin_once(0)

        yield argparse.Namespace(
            network=network, node=node, source=source, seen=seen, troubles=troubles, until=until
        )
    node.destroy_node()


def publishes(world, message, qos=10):
    """Again and again until something has come of it."""
    publisher = world.node.create_publisher(type(message), TOPIC, qos)
    before = len(world.seen) + len(world.troubles)

    def came():
        publisher.publish(message)
        return len(world.seen) + len(world.troubles) > before

    world.until(came)
    return publisher


def test_a_publisher_that_starts_later(world):
    world.until(lambda: world.source.check() != "" and not world.network.alone)
    assert world.source.check() == (
        f"nobody publishes {TOPIC} yet: is the board connected, and its camera on?"
    )
    elsewhere = world.node.create_publisher(CompressedImage, "/cam", 10)
    world.until(lambda: "there are images on /cam" in world.source.check())
    elsewhere.destroy()
    publishes(world, taken())
    assert world.source.check() == ""
    assert world.seen[0].data == JPEG and world.source.octets > len(JPEG)


def test_alone_in_the_domain(own_domain_id):
    with Network(own_domain_id) as network:
        source = ImageSource(network, TOPIC, print, print)
        assert f"no other participant was found in domain {own_domain_id}" in source.check()


def test_raw_and_compressed_pictures(world):
    publishes(world, taken(PNG)).destroy()
    assert world.seen[-1].was == "png"
    raw = Image(height=1, width=2, encoding="rgb8", step=6, data=bytes(6))
    publisher = publishes(world, raw)
    world.until(lambda: publisher.publish(raw) and world.seen[-1].was == "rgb8")


def test_a_best_effort_publisher(world):
    qos = QoSProfile(1, ReliabilityPolicy.BEST_EFFORT)
    publishes(world, taken(), qos)


def test_a_transient_local_picture(world):
    qos = QoSProfile(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    world.node.create_publisher(CompressedImage, TOPIC, qos).publish(taken())
    world.until(lambda: world.seen)


def test_a_missing_camera_is_reported(world):
    publishes(world, taken()).destroy()
    world.until(lambda: "nobody publishes" in world.source.check())


def test_a_topic_of_a_different_type(world):
    world.node.create_publisher(String, TOPIC, 10)
    world.until(lambda: "is std_msgs/msg/String, which is not an image" in world.source.check())


def test_broken_pictures_are_reported_and_the_next_is_shown(world):
    publisher = publishes(world, taken(JPEG[:-2]))
    assert world.troubles[-1].startswith("an image cannot be shown: its JPEG has no end")
    publisher.publish(taken())
    world.until(lambda: world.seen)


# --- the whole ---------------------------------------------------------------------------------


def options(*arguments):
    parser = argparse.ArgumentParser()
    view.add_arguments(parser)
    return parser.parse_args([*arguments])


def test_the_topic_of_the_document_is_the_default():
    assert options().topic == TOPIC
    assert options("image").topic == "/image"
    assert (options().page_host, options().page_port) == ("127.0.0.1", view.PORT)


def test_over_dds_and_http(own_domain_id, monkeypatch, capsys):
    """The verb itself, in this thread; what its page asks is asked while the network spins."""
    node = uros.Node("camera", Direct(open_middleware("auto"), own_domain_id))
    publisher = node.create_publisher(CompressedImage, TOPIC, 10)
    got = []

    def spin(self, done, seconds, real=Network.spin):
        publisher.publish(taken())
        node.spin_once(0)
        ended = real(self, done, min(0.05, seconds or 0.05))
        port = int(re.search(r"127\.0\.0\.1:(\d+)/", printed[0]).group(1))
        page = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        page.request("GET", "/picture?version=-1&picture=-1")
        answer = page.getresponse()
        body, about = answer.read(), json.loads(answer.headers["X-About"])
        page.close()
        if body:
            got.append((body, answer.headers["Content-Type"], about))
            raise KeyboardInterrupt
        return ended

    printed = []
    monkeypatch.setattr(view, "print", lambda text, **_: printed.append(text), raising=False)
    monkeypatch.setattr(view, "discover", lambda network, args: None)
    monkeypatch.setattr(view, "_WAIT_SECONDS", 0.01)
    monkeypatch.setattr(Network, "spin", spin)
    arguments = ("--no-open", "--port", "0", "--domain", str(own_domain_id))
    assert view.run(options(*arguments)) == 0
    node.destroy_node()
    body, mime, about = got[0]
    assert (body, mime) == (JPEG, "image/jpeg")
    assert about["frame_id"] == "myframe" and about["trouble"] == ""


def test_a_page_that_waits_gets_the_next_picture_at_once():
    shown = view.Shown(TOPIC)
    version = shown.answer({"version": "99"}).about["version"]
    shown.add(picture(taken()), time.time_ns())
    begun = time.monotonic()
    assert shown.answer({"version": str(version)}).body == JPEG
    assert time.monotonic() - begun < view._WAIT_SECONDS / 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--host", "192.0.2.1"), "192.0.2.1 is not an address of this machine"),
        (("--host", "no such host"), "no such host is not an address of this machine"),
    ],
)
def test_an_address_of_a_different_machine(arguments, said):
    with pytest.raises(ToolError, match=said):
        open_pages(options("--no-open", "--port", "0", *arguments), ("image.html",), {})


def test_a_port_in_use():
    pages = open_pages(options("--no-open", "--port", "0"), ("image.html",), {})
    try:
        with pytest.raises(ToolError, match="in use, .* give another port with --port"):
            open_pages(options("--no-open", "--port", str(pages.port)), ("image.html",), {})
    finally:
        pages.close()


def test_a_reserved_port():
    said = str(bind_error("the page", "127.0.0.1", 80, "--port", PermissionError(13, "no")))
    assert said == "the page: port 80 is reserved for root; give a port above 1023 with --port"


def test_a_browser_is_opened_unless_no_open_is_given(monkeypatch):
    opened = []
    monkeypatch.setattr("uros.tools.pages.show", opened.append)
    open_one = partial(open_pages, names=("image.html",), get={})
    open_one(options("--no-open", "--port", "0")).close()
    assert not opened
    pages = open_one(options("--port", "0"))
    eventually(lambda: opened)
    pages.close()
    assert opened == [pages.url]
