"""The drive train of a rover: motor supply, motors, encoders, speed control and odometry."""

from .diff_drive import DiffDrive
from .odometry import Odometry
from .pid import Pid
from .wheel import Wheel

try:
    from typing import Any, Callable
except ImportError:
    pass


class Chassis:
    """Motors, encoders, speed control and odometry of a rover with two driven wheels.

    The motor supply is off at first. Call `step` every 20 ms or so. ``control`` is the controller
    of the wheels: ``drive``, or temporarily another object with ``step(now_us)``, ``right_duty``
    and ``left_duty``, such as an :class:`~.autotune.AutoTune`.

    Args:
        power: The pin that switches the motor supply.
        right_motor: Has ``drive(duty)`` and ``coast()``, as `uros.drivers.drv8835`.
        left_motor: The same.
        right_encoder: A pin with ``irq(handler)``.
        left_encoder: The same.
        right_pid: Speed controller of the right wheel.
        left_pid: Speed controller of the left wheel.
        ticks_us: The board's ``time.ticks_us``.
        right_radius: In metres.
        left_radius: In metres.
        d: Half the track, in metres.
        options: Those of :class:`~.diff_drive.DiffDrive`.
    """

    def __init__(
        self,
        power: "Any",
        right_motor: "Any",
        left_motor: "Any",
        right_encoder: "Any",
        left_encoder: "Any",
        right_pid: Pid,
        left_pid: Pid,
        ticks_us: "Callable[[], int]",
        right_radius: float = 0.0325,
        left_radius: float = 0.0325,
        d: float = 0.134,
        **options: "Any",
    ) -> None:
        self.right = Wheel(right_radius)
        self.left = Wheel(left_radius)
        self.drive = DiffDrive(self.right, self.left, right_pid, left_pid, d, **options)
        self.control: "Any" = self.drive
        self.odometry = Odometry(d)
        self._power = power
        self._right_motor = right_motor
        self._left_motor = left_motor
        self._ticks_us = ticks_us
        right_encoder.irq(lambda _: self.right.edge(ticks_us()))
        left_encoder.irq(lambda _: self.left.edge(ticks_us()))
        self.power(False)

    def power(self, on: bool) -> None:
        """Switch the motor supply. Earlier commands are dropped, and ``drive`` is in control."""
        self._power.value(1 if on else 0)
        self.control = self.drive
        self.drive.power(on)
        if not on:
            self._right_motor.coast()
            self._left_motor.coast()

    def step(self) -> None:
        """Run one control cycle: measure, set the duties, update the odometry."""
        control = self.control
        control.step(self._ticks_us())
        if self.drive.powered:
            self._right_motor.drive(control.right_duty)
            self._left_motor.drive(control.left_duty)
        right = self.right
        left = self.left
        self.odometry.update(right.moved, left.moved, right.speed, left.speed)
