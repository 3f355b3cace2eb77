"""``uros calibrate``: finds a rover's wheel radii and track from squares that it drives.

The rover is driven by ``cmd_vel`` and watched by ``odom``; where it really is, a person measures.
"""

from __future__ import annotations

import argparse
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, cast

from ..common import domain, positive_float, topic_name
from ..errors import ToolError

if TYPE_CHECKING:
    from ...control.calibrate import Calibration
    from ...host.direct import Direct

_EPILOG: Final = """\
Two squares, one in each direction. Mark where the rover stands and which way it looks: that is the
origin, x ahead, y to the left. It stops after the first side and at the end of a square; measure
there, and type metres and degrees:

  0.998 0.004        x and y; y is negative to the right
  0.012 -0.020 1.5   and how far it is turned, counter-clockwise

Enter alone leaves that point out. Then put it back, exactly, for the second square.

With a virtual rover, read the pose off the table of 'uros board run sprturtlebot', and put it back
with rover:place=0,0,0.

examples:

  uros calibrate
  uros calibrate --side 2 --radius 0.0325 --d 0.134
"""

_COMMAND_SECONDS: Final = 0.2  # a rover stops a second after the last one
_TURN_SPEED: Final = 0.8
_BRAKE_SECONDS: Final = 0.15
_STILL: Final = 0.001  # m and rad between two messages
_FAR_OFF: Final = 0.5  # m between odometry and what was measured: a slip of the pen
_SILENT_SECONDS: Final = 5.0
_LOST_SECONDS: Final = 60.0  # for a side, or a corner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    for name, default, text in (
        ("--side", 1.0, "length of the square's sides in metres"),
        ("--speed", 0.2, "how fast to drive them, in m/s"),
        ("--radius", 0.0325, "wheel radius that the rover's program has, in metres"),
        ("--d", 0.134, "half the track that it has, in metres"),
    ):
        parser.add_argument(
            name, type=positive_float, default=default, metavar="N",
            help=f"{text} (default: {default:g})",
        )  # fmt: skip
    for name, text in (
        ("cmd_vel", "where the rover takes geometry_msgs/msg/Twist"),
        ("odom", "where it publishes nav_msgs/msg/Odometry"),
        ("motor_power", "where it takes std_msgs/msg/Bool, the motors' power"),
    ):
        option = "--" + name.replace("_", "-")
        parser.add_argument(
            option, type=topic_name, default="/" + name, metavar="TOPIC",
            help=f"{text} (default: /{name})",
        )  # fmt: skip
    parser.add_argument(
        "--domain", type=domain, metavar="N", help="ROS domain (default: ROS_DOMAIN_ID, or 0)"
    )


def run(args: argparse.Namespace) -> int:
    """Drive, ask, and print the sizes. Raises ToolError."""
    from ...control.calibrate import Calibration, CalibrationError

    calibration = Calibration(args.radius, args.d)
    with _Rover(args) as rover:
        rover.begin()
        try:
            for clockwise in (False, True):
                which = "to the right" if clockwise else "to the left"
                _say(f"square {which}: mark where the rover stands, then Enter")
                rover.ask_line()
                square(rover, calibration, args.side, args.speed, clockwise)
                if not clockwise:
                    calibration.restart()
        finally:
            rover.end()
    try:
        calibration.solve()
    except CalibrationError as error:
        raise ToolError(str(error)) from error
    print("for the rover's config.py, in metres:\n")
    print(f"RIGHT_RADIUS = {calibration.right_radius:.5f}")
    print(f"LEFT_RADIUS = {calibration.left_radius:.5f}")
    print(f"D = {calibration.d:.5f}\n")
    print(f"what was measured differs from that by {1000 * calibration.misfit:.1f} mm")
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


class Watched:
    """The rover as a square sees it: poses come by :meth:`wait`, commands go by :meth:`command`.

    ``x``, ``y``, ``theta`` (not wrapped), ``v`` and ``w`` are those of the last odometry, ``came``
    when that was, in seconds; ``on_step(ds, dtheta)`` hears how far each took it.
    """

    def __init__(self) -> None:
        self.x = self.y = self.theta = self.v = self.w = 0.0
        self.came = 0.0
        self.known = False
        self.on_step: Callable[[float, float], object] = lambda ds, dtheta: None

    def heard(self, message: Any, now: float) -> None:
        """An Odometry came."""
        pose = message.pose.pose
        x, y = pose.position.x, pose.position.y
        heading = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        turn = math.remainder(heading - self.theta, math.tau)
        if self.known:
            middle = self.theta + turn / 2
            along = (x - self.x) * math.cos(middle) + (y - self.y) * math.sin(middle)
            # The way is longer than its chord.
            bend = 1.0 if abs(turn) < 1e-6 else (turn / 2) / math.sin(turn / 2)
            self.on_step(along * bend, turn)
        self.x, self.y = x, y
        self.theta += turn
        twist = message.twist.twist
        self.v, self.w = twist.linear.x, twist.angular.z
        self.came = now
        self.known = True

    def now(self) -> float:
        """Seconds."""
        raise NotImplementedError

    def wait(self, seconds: float) -> bool:
        """Let so much time go by, or less if a message comes; whether one came. Raises ToolError
        where the rover is silent.
        """
        raise NotImplementedError

    def command(self, v: float, w: float) -> None:
        """Drive so, in m/s and rad/s."""
        raise NotImplementedError

    def ask_pose(self, what: str) -> tuple[float, ...]:
        """What a person measured: x, y in metres and perhaps theta in radians; nothing: not."""
        raise NotImplementedError

    def say(self, text: str) -> None:
        """To the person."""
        _say(text)


def square(
    rover: Watched, calibration: Calibration, side: float, speed: float, clockwise: bool
) -> None:
    """Drive one, and ask where it stands at the first corner and at the end."""
    d = calibration.d

    def step(ds: float, dtheta: float) -> None:
        calibration.add(ds + d * dtheta, ds - d * dtheta)

    rover.on_step = step
    began = (rover.x, rover.y, rover.theta)
    turn = math.copysign(math.pi / 2, -1 if clockwise else 1)
    for corner in range(4):
        _leg(rover, lambda began: math.hypot(rover.x - began[0], rover.y - began[1]), side, speed)
        if corner == 0:
            _measure(rover, calibration, "after the first side", began)
        _leg(rover, lambda began: abs(rover.theta - began[2]), abs(turn), 0.0, turn)
    _measure(rover, calibration, "at the end", began)


def _leg(
    rover: Watched, gone: Callable[[tuple[float, float, float]], float], far: float, v: float,
    turn: float = 0.0,
) -> None:  # fmt: skip
    """One side, or one corner: drive until ``gone`` is ``far``, and wait until it stands."""
    began = (rover.x, rover.y, rover.theta)
    w = math.copysign(_TURN_SPEED, turn) if turn else 0.0
    rate = abs(v) + abs(w)
    ends = rover.now() + _LOST_SECONDS
    # Odometry comes once a second: in between it goes as fast as it said.
    while gone(began) + (rover.now() - rover.came + _BRAKE_SECONDS) * _rate(rover, turn) < far:
        rover.command(v, w)
        left = far - gone(began) - (rover.now() - rover.came) * _rate(rover, turn)
        rover.wait(max(0.01, min(_COMMAND_SECONDS, left / rate - _BRAKE_SECONDS)))
        if rover.now() > ends:
            rover.command(0.0, 0.0)
            raise ToolError("the rover does not come on: are its motors on, is it against a wall?")
    rover.command(0.0, 0.0)
    before = (math.inf, math.inf, math.inf)
    for _ in _until(rover, ends):
        now = (rover.x, rover.y, rover.theta)
        if max(abs(a - b) for a, b in zip(now, before, strict=True)) < _STILL:
            return
        before = now


def _rate(rover: Watched, turn: float) -> float:
    return abs(rover.w) if turn else abs(rover.v)


def _until(rover: Watched, ends: float) -> Iterator[None]:
    """Each message that comes, up to a time."""
    while rover.now() < ends:
        if rover.wait(1.0):
            yield
    raise ToolError("the rover does not stand still: does something push it?")


def _measure(
    rover: Watched, calibration: Calibration, where: str, began: tuple[float, float, float]
) -> None:
    """Ask until a pose can be, or is left out."""
    from ...control.calibrate import CalibrationError

    x, y, theta = began
    ahead = (rover.x - x) * math.cos(theta) + (rover.y - y) * math.sin(theta)
    aside = (rover.y - y) * math.cos(theta) - (rover.x - x) * math.sin(theta)
    while pose := rover.ask_pose(where):
        off = math.hypot(pose[0] - ahead, pose[1] - aside)
        if off < _FAR_OFF:
            break
        rover.say(
            f"that is {off:.2f} m from where its odometry has it ({ahead:.2f} {aside:.2f}): metres"
            " from where it began, x ahead, y to the left"
        )
    if pose:
        try:
            calibration.measured(*pose)
        except CalibrationError as error:
            raise ToolError(str(error)) from error


def read_pose(text: str) -> tuple[float, ...]:
    """``"0.998 0.004 1.5"``: x, y in metres, and radians of the degrees. Raises ValueError."""
    words = text.replace(",", " ").split()
    if not words:
        return ()
    if len(words) not in (2, 3):
        raise ValueError("type x and y in metres, and perhaps degrees: 0.998 0.004 1.5")
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"{text.strip()!r} is not of numbers: 0.998 0.004 1.5") from None
    if not all(math.isfinite(value) and abs(value) < 1000 for value in values):
        raise ValueError("no rover is there: metres and degrees")
    return (*values[:2], *(math.radians(value) for value in values[2:]))


class _Rover(Watched):
    """The rover on the ROS network."""

    def __init__(self, args: argparse.Namespace) -> None:
        super().__init__()
        from ...host.node import Node
        from ...interfaces import load

        self._twist: Any = load("geometry_msgs/msg/Twist")()
        self._bool: Any = load("std_msgs/msg/Bool")()
        self._args = args
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._node = Node("uros_calibrate", domain_id=args.domain)
        self._drive = self._node.create_publisher(type(self._twist), args.cmd_vel, 1)
        self._power = self._node.create_publisher(type(self._bool), args.motor_power, 1)
        self._node.create_subscription(
            load("nav_msgs/msg/Odometry"), args.odom,
            lambda message: self.heard(message, time.monotonic()),
        )  # fmt: skip

    def __enter__(self) -> _Rover:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()

    def begin(self) -> None:
        """Wait for the rover, and switch its motors on."""
        told = False
        network = cast("Direct", self._node.connection)
        while not (
            self.known and network.matched(self._drive) and network.matched(self._power)
        ):  # fmt: skip
            self._node.spin_once(0.5)
            if not told and not self.known:
                told = True
                _say(f"waiting for a rover that publishes {self._args.odom}; Ctrl-C ends it")
        threading.Thread(target=self._read, daemon=True).start()
        self._switch(True)

    def end(self) -> None:
        """It stands, and its motors are off."""
        self.command(0.0, 0.0)
        self._switch(False)
        self._node.spin_once(0.2)

    def _switch(self, on: bool) -> None:
        self._bool.data = on
        self._power.publish(self._bool)

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        self._lines.put(None)

    def ask_line(self) -> str:
        """A line that the person types. Raises ToolError where there will be none."""
        while sys.stdin.isatty() and not self._lines.empty():
            self._lines.get()  # typed before it was asked for
        while True:
            self._node.spin_once(0.1)
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                continue
            if line is None:
                raise ToolError("nobody is there to measure: standard input has ended")
            return line

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> bool:
        came = self.came
        self._node.spin_once(seconds)
        if self.came == came and self.now() - came > _SILENT_SECONDS:
            raise ToolError(f"{self._args.odom} is silent: is the rover still connected?")
        return self.came != came

    def command(self, v: float, w: float) -> None:
        self._twist.linear.x = v
        self._twist.angular.z = w
        self._drive.publish(self._twist)

    def ask_pose(self, what: str) -> tuple[float, ...]:
        while True:
            _say(f"{what}: where is it? x y in metres, and degrees if you can (Enter: left out)")
            try:
                return read_pose(self.ask_line())
            except ValueError as error:
                _say(str(error))
