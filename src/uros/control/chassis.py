"""What a rover drives with, as one thing: supply, motors and encoders, speeds and odometry."""

from .diff_drive import DiffDrive
from .odometry import Odometry
from .pid import Pid
from .wheel import Wheel

try:
    from typing import Any, Callable
except ImportError:
    pass


class Chassis:
    """``power`` is the pin that switches the motors' supply. Of each side, ``motor`` has
    ``drive(duty)`` and ``coast()``, as `uros.drivers.drv8835` has them, and ``encoder`` is a pin
    with ``irq(handler)``. ``ticks_us`` is the board's `time.ticks_us`. Other ``options`` are those
    of :class:`~.diff_drive.DiffDrive`.

    The supply is off at first. Call `step` every 20 ms or so. ``control`` is what has the wheels:
    ``drive``, or for a while another that has ``step(now_us)``, ``right_duty`` and ``left_duty``,
    such as an :class:`~.autotune.AutoTune`.
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
        """Switch the motors' supply. Nothing that was commanded before counts any more."""
        self._power.value(1 if on else 0)
        self.control = self.drive
        self.drive.power(on)
        if not on:
            self._right_motor.coast()
            self._left_motor.coast()

    def step(self) -> None:
        """One turn: measure, drive, and see where that has brought us."""
        control = self.control
        control.step(self._ticks_us())
        if self.drive.powered:
            self._right_motor.drive(control.right_duty)
            self._left_motor.drive(control.left_duty)
        right = self.right
        left = self.left
        self.odometry.update(right.moved, left.moved, right.speed, left.speed)
