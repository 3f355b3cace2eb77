"""``uros calibrate``: calibrate a rover's wheel radii and track by driving squares.

The tool drives the rover by ``cmd_vel`` and reads ``odom``; the user measures the true pose.
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
The rover drives two squares, one in each direction. Mark its position and heading: this is the
origin, with x ahead and y to the left. The rover stops after the first side and at the end of a
square. Measure its pose there, and type metres and degrees:

  0.998 0.004        x and y; y is negative to the right
  0.012 -0.020 1.5   and the rotation, counter-clockwise

Enter alone skips a point. Then put the rover back to the origin for the second square.

The table of 'uros board run sprturtlebot' shows the pose of a virtual rover; rover:place=0,0,0 puts
it back.

examples:

  uros calibrate
  uros calibrate --side 2 --radius 0.0325 --d 0.134
"""

_COMMAND_SECONDS: Final = 0.2  # a rover stops a second after the last one
_TURN_SPEED: Final = 0.8
_BRAKE_SECONDS: Final = 0.15
_STILL: Final = 0.001  # m and rad between two messages
_FAR_OFF: Final = 0.5  # m between odometry and measurement: a typing error
_SILENT_SECONDS: Final = 5.0
_LOST_SECONDS: Final = 60.0  # for a side, or a corner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros calibrate``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    for name, default, text in (
        ("--side", 1.0, "length of the square's sides in metres"),
        ("--speed", 0.2, "how fast to drive them, in m/s"),
        ("--radius", 0.0325, "wheel radius in the rover's program, in metres"),
        ("--d", 0.134, "half the track in the rover's program, in metres"),
    ):
        parser.add_argument(
            name, type=positive_float, default=default, metavar="N",
            help=f"{text} (default: {default:g})",
        )  # fmt: skip
    for name, text in (
        ("cmd_vel", "topic of the rover's geometry_msgs/msg/Twist"),
        ("odom", "topic of the rover's nav_msgs/msg/Odometry"),
        ("motor_power", "topic of the rover's std_msgs/msg/Bool for the motors' power"),
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
    """Drive the squares, ask for the measurements, and print the result.

    Raises:
        ToolError: The rover does not move, is silent, or the measurements make no sense.
    """
    from ...control.calibrate import Calibration, CalibrationError

    calibration = Calibration(args.radius, args.d)
    with _Rover(args) as rover:
        rover.begin()
        try:
            for clockwise in (False, True):
                which = "to the right" if clockwise else "to the left"
                _say(f"square {which}: mark where the rover stands, then press Enter")
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
    print(f"residual of the measurements: {1000 * calibration.misfit:.1f} mm")
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


class Watched:
    """A rover: :meth:`wait` receives odometry, :meth:`command` sends commands.

    Attributes:
        x: Of the last odometry, in metres, as ``y``.
        theta: Its heading in radians, not wrapped.
        v: Its speed in m/s; ``w`` is its rate of turn in rad/s.
        came: When it came, in seconds.
        known: Whether any odometry came.
        on_step: Called as ``on_step(ds, dtheta)`` with the way between two messages.
    """

    def __init__(self) -> None:
        self.x = self.y = self.theta = self.v = self.w = 0.0
        self.came = 0.0
        self.known = False
        self.on_step: Callable[[float, float], object] = lambda ds, dtheta: None

    def heard(self, message: Any, now: float) -> None:
        """Take an Odometry that came at ``now``."""
        pose = message.pose.pose
        x, y = pose.position.x, pose.position.y
        heading = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        turn = math.remainder(heading - self.theta, math.tau)
        if self.known:
            middle = self.theta + turn / 2
            along = (x - self.x) * math.cos(middle) + (y - self.y) * math.sin(middle)
            # The arc is longer than its chord.
            bend = 1.0 if abs(turn) < 1e-6 else (turn / 2) / math.sin(turn / 2)
            self.on_step(along * bend, turn)
        self.x, self.y = x, y
        self.theta += turn
        twist = message.twist.twist
        self.v, self.w = twist.linear.x, twist.angular.z
        self.came = now
        self.known = True

    def now(self) -> float:
        """Return a monotonic time in seconds."""
        raise NotImplementedError

    def wait(self, seconds: float) -> bool:
        """Wait for a message for at most so long, and return whether one came.

        Raises:
            ToolError: The rover is silent.
        """
        raise NotImplementedError

    def command(self, v: float, w: float) -> None:
        """Send a velocity, in m/s and rad/s."""
        raise NotImplementedError

    def ask_pose(self, what: str) -> tuple[float, ...]:
        """Ask the user for x, y in metres and perhaps theta in radians; empty if skipped."""
        raise NotImplementedError

    def say(self, text: str) -> None:
        """Print a text for the user."""
        _say(text)


def square(
    rover: Watched, calibration: Calibration, side: float, speed: float, clockwise: bool
) -> None:
    """Drive a square, and ask for the pose at the first corner and at the end.

    Args:
        rover: The rover.
        calibration: Collects the steps and the measurements.
        side: Length of a side in metres.
        speed: Speed on the sides in m/s.
        clockwise: The direction.
    """
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
    """Drive one side or one corner until ``gone`` is ``far``, then wait for standstill."""
    began = (rover.x, rover.y, rover.theta)
    w = math.copysign(_TURN_SPEED, turn) if turn else 0.0
    rate = abs(v) + abs(w)
    ends = rover.now() + _LOST_SECONDS
    # Odometry comes once a second: the pose is extrapolated between.
    while gone(began) + (rover.now() - rover.came + _BRAKE_SECONDS) * _rate(rover, turn) < far:
        rover.command(v, w)
        left = far - gone(began) - (rover.now() - rover.came) * _rate(rover, turn)
        rover.wait(max(0.01, min(_COMMAND_SECONDS, left / rate - _BRAKE_SECONDS)))
        if rover.now() > ends:
            rover.command(0.0, 0.0)
            raise ToolError("the rover does not move on: are its motors on, is it against a wall?")
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
    """Yield at each message, up to a time."""
    while rover.now() < ends:
        if rover.wait(1.0):
            yield
    raise ToolError("the rover does not stop: does something push it?")


def _measure(
    rover: Watched, calibration: Calibration, where: str, began: tuple[float, float, float]
) -> None:
    """Ask until the pose is plausible, or skipped."""
    from ...control.calibrate import CalibrationError

    x, y, theta = began
    ahead = (rover.x - x) * math.cos(theta) + (rover.y - y) * math.sin(theta)
    aside = (rover.y - y) * math.cos(theta) - (rover.x - x) * math.sin(theta)
    while pose := rover.ask_pose(where):
        off = math.hypot(pose[0] - ahead, pose[1] - aside)
        if off < _FAR_OFF:
            break
        rover.say(
            f"this is {off:.2f} m away from the odometry ({ahead:.2f} {aside:.2f}): give metres"
            " from the origin, x ahead, y to the left"
        )
    if pose:
        try:
            calibration.measured(*pose)
        except CalibrationError as error:
            raise ToolError(str(error)) from error


def read_pose(text: str) -> tuple[float, ...]:
    """Parse a pose such as ``"0.998 0.004 1.5"``: metres and degrees.

    Returns:
        x and y in metres, and theta in radians if given; empty for an empty text.

    Raises:
        ValueError: The text is not a pose.
    """
    words = text.replace(",", " ").split()
    if not words:
        return ()
    if len(words) not in (2, 3):
        raise ValueError("type x and y in metres, and perhaps degrees: 0.998 0.004 1.5")
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"{text.strip()!r}: type numbers such as 0.998 0.004 1.5") from None
    if not all(math.isfinite(value) and abs(value) < 1000 for value in values):
        raise ValueError("this is too far away: type metres and degrees")
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
        """Wait for the rover and switch its motors on."""
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
        """Stop the rover and switch its motors off."""
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
        """Return the next line that the user types. Raises ToolError at the end of input."""
        while sys.stdin.isatty() and not self._lines.empty():
            self._lines.get()  # typed before the question
        while True:
            self._node.spin_once(0.1)
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                continue
            if line is None:
                raise ToolError("no measurement: standard input has ended")
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
            _say(f"{what}: pose? x y in metres, and degrees if you can (Enter: skip)")
            try:
                return read_pose(self.ask_line())
            except ValueError as error:
                _say(str(error))
