"""``uros image view``: show the images of a topic live in a browser."""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from ...dashboard.serve import Answer, Newest, number
from ...printable import printable
from ..common import add_common, discover, join
from ..pages import add_page_arguments, open_pages
from .source import ImageSource, add_image_topic, age

if TYPE_CHECKING:
    from ...dashboard.pictures import Picture

PORT: Final = 8090
_CHECK_SECONDS: Final = 0.5
# A request of a page is answered after this time at the latest, with the age of the last image.
_WAIT_SECONDS: Final = 1.0
# The period of the rate.
_RATE_SECONDS: Final = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros image view``."""
    add_image_topic(parser)
    add_common(parser)
    add_page_arguments(parser, PORT)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    shown = Shown(args.topic)
    pages = open_pages(args, ("image.html", "page.css", "image.js"), get={"/picture": shown.answer})
    print(f"{args.topic} is shown at {pages.url} (Ctrl-C ends it)", flush=True)
    try:
        with join(args) as network:
            discover(network, args)
            source = ImageSource(network, args.topic, shown.add, shown.trouble)
            said = ""
            while True:
                why = source.check()
                shown.waiting(why)
                if why and why != said:
                    print(printable(why), file=sys.stderr, flush=True)
                said = why
                network.spin(lambda: False, _CHECK_SECONDS)
    except KeyboardInterrupt:
        return 0
    finally:
        pages.close()


class Shown:
    """The newest image of a topic and its state, for pages in other threads."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._newest = Newest()
        self._picture: Picture | None = None
        self._number = 0  # the picture's
        self._received_ns = 0
        self._times: deque[float] = deque()
        self._broken = 0
        self._trouble = ""
        self._waiting = "discovering the network"

    def add(self, picture: Picture, received_ns: int) -> None:
        """Show a new image."""
        with self._newest:
            self._picture, self._received_ns = picture, received_ns
            self._number += 1
            self._trouble = ""
            self._times.append(time.monotonic())
            self._newest.change()

    def trouble(self, text: str) -> None:
        """Count an image that cannot be shown; ``text`` is the reason."""
        with self._newest:
            self._broken += 1
            self._trouble = text
            self._newest.change()

    def waiting(self, why: str) -> None:
        """Show why no image comes; "" if one may come."""
        with self._newest:
            if why != self._waiting:
                self._waiting = why
                self._newest.change()

    def _rate(self) -> float:
        now = time.monotonic()
        times = self._times
        while times and times[0] < now - _RATE_SECONDS:
            times.popleft()
        if len(times) < 2:
            return 0.0
        # Counted up to now if they stopped, so that the rate falls to 0.
        mean = (times[-1] - times[0]) / (len(times) - 1)
        span = max(times[-1], now - mean) - times[0]
        return (len(times) - 1) / span if span else 0.0

    def answer(self, query: dict[str, str]) -> Answer:
        """Answer ``/picture?version=V&picture=N``: the state, and the image if it is not N."""
        with self._newest:
            self._newest.wait(number(query, "version"), _WAIT_SECONDS)
            picture = self._picture
            about: dict[str, Any] = {
                "version": self._newest.version,
                "picture": self._number,
                "topic": self._topic,
                "broken": self._broken,
                "trouble": printable(self._trouble or self._waiting),
                "rate": round(self._rate(), 2),
            }
            received_ns = self._received_ns
        if picture is None:
            return Answer(200, b"", "text/plain", about)
        about.update(
            width=picture.width, height=picture.height, octets=len(picture.data), was=picture.was,
            suffix=picture.suffix, frame_id=printable(picture.frame_id[:64]),
            age=age(picture.stamp_ns, received_ns),
            stamp=f"{picture.stamp_ns // 10**9}.{picture.stamp_ns % 10**9:09d}",
            ago=round(max(0.0, time.time() - received_ns / 1e9), 1),
        )  # fmt: skip
        if number(query, "picture") == about["picture"]:
            return Answer(200, b"", "text/plain", about)
        return Answer(200, picture.data, picture.mime, about)
