"""``uros image save``: save the images of a topic to files."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ...printable import printable
from ..common import add_common, discover, join, positive_float, unsigned_int
from ..errors import ToolError
from ..waiting import warn
from .source import ImageSource, add_image_topic, age

if TYPE_CHECKING:
    from ...dashboard.pictures import Picture

_CHECK_SECONDS: Final = 0.5
_SUFFIXES: Final = {".jpg": ".jpg", ".jpeg": ".jpg", ".png": ".png"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros image save``."""
    add_image_topic(parser)
    add_common(parser)
    parser.add_argument(
        "--count",
        metavar="N",
        type=unsigned_int,
        default=1,
        help="exit after so many images (default: 1; 0: no limit)",
    )
    parser.add_argument(
        "--out",
        metavar="PATH",
        default=".",
        help="folder to write to, or for one image the file, .jpg or .png (default: this folder)",
    )
    parser.add_argument(
        "--every",
        metavar="S",
        type=positive_float,
        default=0.0,
        help="skip images that come within so many seconds after the last one (default: none)",
    )
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=positive_float,
        help="exit after so many seconds; exit status 1 if fewer than --count images came",
    )


def run(args: argparse.Namespace) -> int:
    """Save images.

    Returns:
        0 if as many came as were asked for, else 1.
    """
    saver = Saver(args.topic, args.out, args.count, args.every)
    end = None if args.timeout is None else time.monotonic() + args.timeout
    troubles: list[str] = []
    said = ""
    try:
        with join(args) as network:
            discover(network, args)
            source = ImageSource(network, args.topic, saver.add, troubles.append)
            while not saver.done:
                why = source.check()
                if why and why != said:
                    warn(f"{why}; waiting for it")
                said = why
                left = _CHECK_SECONDS
                if end is not None:
                    left = min(left, end - time.monotonic())
                if left <= 0:
                    break
                network.spin(lambda: saver.done, left)
                for text in dict.fromkeys(troubles):
                    warn(text)
                troubles.clear()
    except KeyboardInterrupt:
        return 0
    if saver.done:
        return 0
    if args.count:
        print(
            f"uros: {saver.count} of {args.count} images came within {args.timeout:g} s"
            f"{f': {printable(said)}' if said else ''}",
            file=sys.stderr,
        )
    return int(saver.count < max(1, args.count))


class Saver:
    """Writes images to files.

    Args:
        topic: The topic, which names the files.
        out: A folder, or a file for one image.
        count: How many images to write; 0 for no limit.
        every: The least time between two images, in seconds.

    Raises:
        ToolError: ``out`` cannot be used.
    """

    def __init__(self, topic: str, out: str, count: int, every: float) -> None:
        self.count = 0
        self._wanted = count
        # One image a second may come a little early.
        self._least_ns = int(every * 0.9e9)
        self._last_ns: int | None = None
        self._stem = topic.strip("/").replace("/", "_")
        path = Path(out)
        self._file: Path | None = None
        if path.suffix.lower() in _SUFFIXES and not path.is_dir():
            if count != 1:
                raise ToolError(f"--out {out} is a file, for --count 1; give a folder")
            self._file = path
            path = path.parent
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ToolError(f"--out {path} cannot be made: {error.strerror}") from error
        self._folder = path

    @property
    def done(self) -> bool:
        """Whether enough images were written."""
        return bool(self._wanted) and self.count >= self._wanted

    def add(self, picture: Picture, received_ns: int) -> None:
        """Write an image, unless enough are written, or it is too soon after the last one.

        Raises:
            ToolError: The file cannot be written, or has the wrong suffix.
        """
        if self.done:
            return
        if self._last_ns is not None and received_ns - self._last_ns < self._least_ns:
            return
        path = self._file or self._free(picture, received_ns)
        if self._file and _SUFFIXES[path.suffix.lower()] != picture.suffix:
            raise ToolError(
                f"the images are {picture.kind}: give --out a {picture.suffix} name, or a folder"
            )
        try:
            _write(path, picture.data)
        except OSError as error:
            raise ToolError(f"{path} cannot be written: {error.strerror}") from error
        self._last_ns = received_ns
        self.count += 1
        print(
            f"{path}: {picture.width}x{picture.height}, {len(picture.data)} octets,"
            f" {age(picture.stamp_ns, received_ns)}",
            flush=True,
        )

    def _free(self, picture: Picture, received_ns: int) -> Path:
        """Return a free file name of the topic and the stamp, or the time of reception."""
        at = picture.stamp_ns or received_ns
        stem = f"{self._stem}_{at // 10**9}.{at % 10**9:09d}"
        if not picture.stamp_ns:
            stem += "_received"
        path, again = self._folder / f"{stem}{picture.suffix}", 1
        while path.exists():
            again += 1
            path = self._folder / f"{stem}_{again}{picture.suffix}"
        return path


def _write(path: Path, data: bytes) -> None:
    """Write a file at once, because another program may watch the folder."""
    mask = os.umask(0)
    os.umask(mask)
    handle, name = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise
