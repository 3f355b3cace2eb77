"""``uros tf echo``: print the transform between two frames."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from typing import Final

from ...printable import printable
from ..common import add_common, join, positive_float, unsigned_int
from ..errors import ToolError
from ..waiting import warn
from .frames import NoTransformError, Stamped
from .listener import MIDDLEWARE, Listener
from .transforms import matrix, roll_pitch_yaw

_PRECISION: Final = 3
_MOST_DIGITS: Final = 17
# Seconds between the looks at what is missing, which is said where it has changed.
_PATIENCE: Final = 1.0
_MOST_NAMED: Final = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros tf echo``."""
    parser.add_argument("source", metavar="SOURCE", help="frame in which the pose is printed")
    parser.add_argument("target", metavar="TARGET", help="frame whose pose is printed")
    parser.add_argument(
        "rate", metavar="RATE", nargs="?", type=positive_float, default=1.0,
        help="prints a second (default: 1)",
    )  # fmt: skip
    add_common(parser)
    parser.add_argument(
        "-p", "--precision", metavar="N", type=_digits, default=_PRECISION,
        help=f"digits behind the point (default: {_PRECISION})",
    )  # fmt: skip
    parser.add_argument("-1", "--once", action="store_true", help="print it once, and end")
    parser.add_argument(
        "--timeout", metavar="S", type=positive_float,
        help="seconds to wait for the transform; exit status 1 without one (default: no limit)",
    )  # fmt: skip


def _digits(text: str) -> int:
    number = unsigned_int(text)
    if number > _MOST_DIGITS:
        raise argparse.ArgumentTypeError(f"{text!r} is more than {_MOST_DIGITS} digits")
    return number


def run(args: argparse.Namespace) -> int:
    """Print the transform until Ctrl-C, or once.

    Raises:
        ToolError: There is no such transform within the timeout.
    """
    try:
        with join(args, MIDDLEWARE) as network:
            listener = Listener(network)

            def found() -> bool:
                return not _missing(listener, args)

            said = ""
            deadline = None if args.timeout is None else time.monotonic() + args.timeout
            while not network.spin(found, _wait(deadline)):
                why = _missing(listener, args)
                if deadline is not None and time.monotonic() >= deadline:
                    raise ToolError(f"no transform within {args.timeout:g} s: {why}")
                if why != said:
                    warn(f"waiting for the transform {args.source} -> {args.target}: {why}")
                said = why
            while True:
                try:
                    stamped = listener.tree.lookup(args.source, args.target)
                    sys.stdout.write("\n".join(_lines(stamped, args.precision)) + "\n")
                    sys.stdout.flush()
                    said = ""
                except NoTransformError as error:
                    if str(error) != said:
                        warn(str(error))
                    said = str(error)
                if args.once:
                    return 0
                network.spin(lambda: False, 1.0 / args.rate)
    except KeyboardInterrupt:
        return 0


def _wait(deadline: float | None) -> float:
    if deadline is None:
        return _PATIENCE
    return max(0.0, min(_PATIENCE, deadline - time.monotonic()))


def _missing(listener: Listener, args: argparse.Namespace) -> str:
    """Return why there is no transform, with the frames that there are; "" if there is one."""
    try:
        listener.tree.lookup(args.source, args.target)
    except NoTransformError as error:
        frames = listener.tree.frames()
        named = ", ".join(frames[:_MOST_NAMED]) or "none; does a node publish on /tf?"
        more = f" and {len(frames) - _MOST_NAMED} more" if len(frames) > _MOST_NAMED else ""
        return printable(f"{error} (frames: {named}{more})")
    return ""


def _lines(stamped: Stamped, precision: int) -> Iterator[str]:
    """Yield the lines of a pose, as tf2_echo prints them."""
    (translation, rotation), stamp_ns = stamped
    angles = roll_pitch_yaw(rotation)

    def number(value: float, width: int = 0) -> str:
        return f"{round(value, precision) + 0.0:{width}.{precision}f}"  # 0.0 for -0.0, too

    def row(values: tuple[float, ...]) -> str:
        return ", ".join(map(number, values))

    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    yield f"At time {seconds}.{nanoseconds:09d}"
    yield f"- Translation: [{row(translation)}]"
    yield f"- Rotation: in Quaternion [{row(rotation)}]"
    yield f"- Rotation: in RPY (radian) [{row(angles)}]"
    yield f"- Rotation: in RPY (degree) [{row(tuple(map(math.degrees, angles)))}]"
    yield "- Matrix:"
    rows = [(*line, moved) for line, moved in zip(matrix(rotation), translation, strict=True)]
    for line in (*rows, (0.0, 0.0, 0.0, 1.0)):
        yield "".join(f" {number(value, precision + 3)}" for value in line)
