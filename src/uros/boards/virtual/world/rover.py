"""SprTurtleBot's body: two driven wheels, a caster and a battery, in an arena.

Rigid-body dynamics of two wheels that roll without slipping, coupled by the body's mass and
inertia, with dry friction at each wheel. Integrated in steps of 1 ms of the world's time, on whole
milliseconds, so that a run does not depend on how often it is advanced. Call ``advance`` before the
inputs change: what is set after ``advance(t)`` takes effect at the next whole millisecond.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..devices.drv8835 import Drv8835
from ..devices.encoder import Encoder
from ..devices.motor import Motor
from ..hardware.parts import Part
from .arena import Arena

STEP_US: Final = 1000
RADIUS: Final = 0.0325  # of a wheel, m
HALF_TRACK: Final = 0.134  # m
BODY: Final = 0.15  # radius of the body for collisions, m

_MASS: Final = 0.7  # kg
_TURNING: Final = 0.0045  # kg·m² around the middle of the axle
_ROLLING: Final = 0.0022  # N·m at each wheel: rolling resistance of caster and tyres
_CAPACITY: Final = 2.0 * 3600  # A·s, two lithium cells in series
_INSIDE: Final = 0.15  # ohm: internal resistance of the battery and its wires
_SLIP: Final = 0.25  # share of the distance that is lost

RIGHT: Final = 0
LEFT: Final = 1
_SIDES: Final = ("right", "left")


def open_volts(level: float) -> float:
    """Return the open-circuit voltage of two lithium cells in V, by their charge (0 to 1).

    6.2 V empty, 7.4 V at half charge, 8.3 V full.
    """
    level = min(max(level, 0.0), 1.0)
    return 6.2 + 1.0 * min(level / 0.1, 1.0) + 0.4 * level + 0.7 * max(level - 0.6, 0.0) / 0.4


class Rover(Part):
    """A rover with differential drive. Pairs are in the order right, left.

    Attributes:
        x: Its true position in the arena in m, to the east.
        y: Its true position in the arena in m, to the north.
        theta: Its true yaw in rad, counter-clockwise from east (REP 103), not wrapped.
        path_length: The length of the path of its middle so far, in m.
        v: Its linear velocity in m/s.
        w: Its angular velocity in rad/s.
        motors: The motors of both wheels.
        encoders: The encoders of both wheels.
        driver: The motor driver.
        radii: The true radii of both wheels in m.
        half_track: Half of the true track width in m.
        angles: The angles in rad that the wheels have turned.
        battery: The battery's charge, 0 to 1.
        volts: The voltage of the motors' supply in V.
        current: The current from the battery in A.
        blocked: Whether a wall or a box stops it.

    Args:
        name: The part's name.
        seed: The seed of motors, encoders and dimensions.
        arena: The arena that it drives in; by default that of the seed.
        spread: How much motors differ; see `Motor`.
        tolerance: How far wheels and track are from their nominal dimensions at most: 0.002 is
            ±2 mm per m.
        uneven: How uneven the encoders' teeth are; see `Encoder`.
        battery: The battery's charge at power-on, 0 to 1.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "slip": "both wheels slip: a quarter of the distance is lost",
        "low_battery": "the battery is almost empty",
        **{f"driver_{kind}": f"the driver {text}" for kind, text in Drv8835.FAULTS.items()},
        **{
            f"{side}_{kind}": f"the {side} motor: {text}"
            for side in _SIDES
            for kind, text in Motor.FAULTS.items()
        },
        **{
            f"{side}_encoder_{kind}": f"the {side} encoder: {text}"
            for side in _SIDES
            for kind, text in Encoder.FAULTS.items()
        },
    }
    ACTS: ClassVar[dict[str, str]] = {
        "push": "push it to its left by a distance in metres, its wheels skidding: push=0.05",
        "place": "place it at x, y in metres and an angle in degrees: place=0,0,90",
        "battery": "charge or discharge the battery to a percentage: battery=20",
    }

    def __init__(
        self,
        name: str = "rover",
        seed: object = 0,
        arena: Arena | None = None,
        *,
        spread: float = 0.15,
        tolerance: float = 0.002,
        uneven: float = 0.0,
        battery: float = 0.8,
    ) -> None:
        super().__init__(name)
        source = random.Random(f"{seed}/rover")
        self.arena = arena if arena is not None else Arena(seed)
        self.motors = tuple(Motor(f"{seed}/{side}", spread) for side in _SIDES)
        self.encoders = tuple(Encoder(f"{seed}/{side}", uneven) for side in _SIDES)
        self.driver = Drv8835()
        self.radii = tuple(RADIUS * (1 + source.uniform(-tolerance, tolerance)) for _ in _SIDES)
        self.half_track = HALF_TRACK * (1 + source.uniform(-tolerance, tolerance))
        self.battery = battery
        self.volts = open_volts(battery)
        self.current = 0.0
        self.x = self.y = self.theta = self.path_length = 0.0
        self.v = self.w = 0.0
        self.angles = [0.0, 0.0]
        self.blocked = False
        self._on_power: Callable[[bool], None] | None = None
        self._at = 0  # the end of the last step
        self._inverse = self._masses()

    def _masses(self) -> tuple[float, float, float]:
        """Return the inverse of the mass matrix, which maps accelerations of the wheels to torques.

        Its two diagonal elements, and the off-diagonal one.
        """
        right_radius, left_radius = self.radii
        rolling, turning = _MASS / 4, _TURNING / (4 * self.half_track**2)
        right = self.motors[RIGHT].inertia + right_radius**2 * (rolling + turning)
        left = self.motors[LEFT].inertia + left_radius**2 * (rolling + turning)
        both = right_radius * left_radius * (rolling - turning)
        determinant = right * left - both * both
        return left / determinant, right / determinant, -both / determinant

    # Inputs.

    def set_duty(self, channel: int, duty: int, frequency: int = 1000) -> None:
        """Set the PWM at an input of the driver; see `Drv8835.set_duty`.

        AIN1 and AIN2 drive the right wheel, BIN1 and BIN2 the left one.
        """
        self.driver.set_duty(channel, duty, frequency)

    def power(self, on: bool) -> None:
        """Switch the motors' supply."""
        self.driver.powered = on

    def fault(self, kind: str) -> None:
        """Inject one of FAULTS; raise ValueError for any other."""
        if kind not in self.FAULTS:
            raise ValueError(f"{self.name} has no fault {kind}; it has {', '.join(self.FAULTS)}")
        super().fault(kind)
        self._spread_faults()

    def heal(self) -> None:
        """Clear all faults, those of its parts too."""
        super().heal()
        self._spread_faults()

    def _spread_faults(self) -> None:
        """Set the faults of the parts that have them."""
        self.driver.faults = _of(self.faults, "driver_")
        for side, motor, encoder in zip(_SIDES, self.motors, self.encoders, strict=True):
            encoder.faults = _of(self.faults, f"{side}_encoder_")
            motor.faults = _of(self.faults, f"{side}_") & set(Motor.FAULTS)

    def act(self, kind: str, value: str = "") -> None:
        """Carry out one of ACTS; raise ValueError for a value that is not allowed."""
        try:
            numbers = [float(number) for number in value.split(",")] if value else []
            if not all(map(math.isfinite, numbers)):
                numbers = []
        except ValueError:
            numbers = []
        if kind == "push" and len(numbers) <= 1:
            self._push(numbers[0] if numbers else 0.05)
        elif kind == "place" and len(numbers) == 3:
            self._place(numbers[0], numbers[1], math.radians(numbers[2]))
        elif kind == "battery" and len(numbers) == 1 and 0 <= numbers[0] <= 100:
            self.battery = numbers[0] / 100
        elif kind in self.ACTS:
            raise ValueError(f"{kind}={value}: {self.ACTS[kind]}")
        else:
            raise ValueError(f"{self.name} has no act {kind}; it has {', '.join(self.ACTS)}")

    def _push(self, metres: float) -> None:
        """Push the rover, at most to the next obstacle."""
        count = max(1, math.ceil(abs(metres) / 0.005))
        for _ in range(count):
            x = self.x - math.sin(self.theta) * metres / count
            y = self.y + math.cos(self.theta) * metres / count
            if not self.arena.is_free(x, y, BODY):
                return
            self.x, self.y = x, y

    def _place(self, x: float, y: float, theta: float) -> None:
        if not self.arena.is_free(x, y, BODY):
            raise ValueError(f"there is no room for it at {x:g}, {y:g}")
        self.x, self.y, self.theta = x, y, theta
        self.v = self.w = 0.0
        for motor in self.motors:
            motor.speed = 0.0

    def reset(self) -> None:
        """Switch off the driver: the board's pins are inputs with pull-downs."""
        self.driver.off()

    # What can be measured.

    @property
    def speeds(self) -> tuple[float, float]:
        """The speeds of the right and the left wheel at the floor, in m/s."""
        return self.motors[0].speed * self.radii[0], self.motors[1].speed * self.radii[1]

    def shows(self) -> str:
        """Return the pose in words."""
        degrees = math.degrees(math.remainder(self.theta, math.tau))
        return f"{self.x:.3f} m, {self.y:.3f} m, {degrees:.1f}°" + (
            ", against a wall" if self.blocked else ""
        )

    # Time.

    def advance(self, t_us: int) -> None:
        """Integrate up to ``t_us`` in µs since power-on, and report the encoders' edges."""
        while self._at + STEP_US <= t_us:
            if self._rests():
                self._at = t_us - t_us % STEP_US
                self.current = self.v = self.w = 0.0
                self.volts = open_volts(self._level())
                return
            self._step()

    def _rests(self) -> bool:
        """Return whether time alone changes nothing: at rest, undriven, encoders without faults."""
        if self.motors[0].speed or self.motors[1].speed:
            return False
        drives = self.driver.bridge(0)[0] or self.driver.bridge(1)[0]
        return not (drives or self.encoders[0].faults or self.encoders[1].faults)

    def _level(self) -> float:
        return 0.02 if "low_battery" in self.faults else self.battery

    def _step(self) -> None:
        dt = STEP_US / 1e6
        right, left = self.motors
        level = self._level()
        inside = 4 * _INSIDE if level < 0.1 else _INSIDE
        # The current of the previous step: it changes little in 1 ms.
        volts = self.volts = max(open_volts(level) - inside * self.current, 0.0)
        a = right.torque(volts, *self.driver.bridge(RIGHT)) * dt
        b = left.torque(volts, *self.driver.bridge(LEFT)) * dt
        # Energy that a motor returns goes to the other motor, or is lost.
        self.current = max(right.draw + left.draw, 0.0)
        self._roll(a, b, dt)
        t_us = self._at
        self._at += STEP_US
        self._turn(t_us, dt)

    def _roll(self, a: float, b: float, dt: float) -> None:
        """Set the new speeds from friction and the motors' angular impulses ``a`` and ``b``."""
        motor_a, motor_b = self.motors
        ma, mb, both = self._inverse
        right = motor_a.speed + ma * a + both * b
        left = motor_b.speed + both * a + mb * b
        # Dry friction takes the impulse that stops a wheel, up to its limit. The wheels are
        # coupled: iterate.
        most_a = (motor_a.friction + _ROLLING) * dt
        most_b = (motor_b.friction + _ROLLING) * dt
        taken_a = taken_b = 0.0
        for _ in range(4):
            new = min(max(taken_a - right / ma, -most_a), most_a)
            change, taken_a = new - taken_a, new
            right += ma * change
            left += both * change
            new = min(max(taken_b - left / mb, -most_b), most_b)
            change, taken_b = new - taken_b, new
            right += both * change
            left += mb * change
        # Exactly 0, so that `_rests` holds.
        motor_a.speed = 0.0 if abs(right) < 1e-6 else right
        motor_b.speed = 0.0 if abs(left) < 1e-6 else left

    def _turn(self, t_us: int, dt: float) -> None:
        right, left = self.motors
        vr, vl = right.speed * self.radii[RIGHT], left.speed * self.radii[LEFT]
        if self.faults:
            if "slip" in self.faults or "slips" in right.faults:
                vr *= 1 - _SLIP
            if "slip" in self.faults or "slips" in left.faults:
                vl *= 1 - _SLIP
        self.v, self.w = (vr + vl) / 2, (vr - vl) / (2 * self.half_track)
        middle = self.theta + self.w * dt / 2
        x = self.x + self.v * dt * math.cos(middle)
        y = self.y + self.v * dt * math.sin(middle)
        if self.v:
            self.blocked = not self.arena.is_free(x, y, BODY)
            if self.blocked and self.arena.is_free(self.x, self.y, BODY):
                self._stop_forward()
            else:
                self.x, self.y = x, y
                self.path_length += abs(self.v) * dt
        self.theta += self.w * dt
        self._wheels(t_us, dt)

    def _stop_forward(self) -> None:
        """Stop the forward motion at an obstacle.

        With wheels driven in opposite directions it still turns; driven against the obstacle,
        friction with it prevents turning.
        """
        right, left = self.motors
        if right.current * left.current > 0:
            right.speed = left.speed = self.v = self.w = 0.0
            return
        turn = (right.speed * self.radii[RIGHT] - left.speed * self.radii[LEFT]) / 2
        right.speed, left.speed = turn / self.radii[RIGHT], -turn / self.radii[LEFT]
        self.v = 0.0

    def _wheels(self, t_us: int, dt: float) -> None:
        edges = []
        for side in (RIGHT, LEFT):
            before = self.angles[side]
            after = self.angles[side] = before + self.motors[side].speed * dt
            encoder = self.encoders[side]
            for when, level in encoder.edges(t_us, STEP_US, before, after):
                edges.append((when, side, level))
        if edges:
            edges.sort()
            for when, side, level in edges:
                self.encoders[side].set_level(when, level)
        self.battery = max(self.battery - self.current * dt / _CAPACITY, 0.0)


def _of(faults: set[str], prefix: str) -> set[str]:
    return {kind.removeprefix(prefix) for kind in faults if kind.startswith(prefix)}
