"""Speed control of two wheels that follow a Twist."""

try:
    from typing import Final
except ImportError:
    pass

from .pid import Pid
from .wheel import Wheel

_MASK: Final = 0x3FFFFFFF
_HALF: Final = 0x20000000
# Share of the duty limit that turns any wheel that is not blocked.
_HARD: Final = 0.4
# A driven wheel that is not blocked reaches this share of its target speed at least.
_RUNS: Final = 0.2
# Time until a motor turns.
_START_US: Final = 50000
# Commands are refused for so long after a wheel was stuck.
_REST_MS: Final = 1000


def is_number(value: float) -> bool:
    """Return whether a float is neither NaN nor infinite."""
    return value - value == 0


class DiffDrive:
    """Differential drive: one speed controller for each wheel, a command timeout, stall detection.

    Call `step` every 20 ms or so, and give ``right_duty`` and ``left_duty`` to the motors' driver:
    -255.0 to 255.0, where 0 brakes. ``v`` and ``w`` are the commanded rates after limits.

    A stalled wheel stops both. ``fault`` names it until both wheels turn again or the power is
    switched; commands are accepted again a second later.

    Args:
        right: The right wheel.
        left: The left wheel.
        right_pid: Speed controller of the right wheel.
        left_pid: Speed controller of the left wheel.
        d: Half the track, in metres.
        fastest: Largest speed of a wheel, in m/s.
        timeout_ms: The drive stops so long after the last command.
        stuck_ms: A wheel that is driven hard and hardly turns for so long counts as stalled.
    """

    def __init__(
        self,
        right: Wheel,
        left: Wheel,
        right_pid: Pid,
        left_pid: Pid,
        d: float = 0.134,
        fastest: float = 0.9,
        timeout_ms: int = 1000,
        stuck_ms: int = 500,
    ) -> None:
        self.right = right
        self.left = left
        self.right_pid = right_pid
        self.left_pid = left_pid
        self.d = d
        self.fastest = fastest
        self.right_duty = 0.0
        self.left_duty = 0.0
        self.v = 0.0
        self.w = 0.0
        self.powered = False
        self.fault = ""
        self._timeout_us = timeout_ms * 1000
        self._stuck_us = stuck_ms * 1000
        self._right_target = 0.0
        self._left_target = 0.0
        # Time since the last command, and for how long each wheel has been stalled.
        self._idle_us = 0
        self._right_us = 0
        self._left_us = 0
        self._rest_us = 0
        self._then = -1

    def power(self, on: bool) -> None:
        """Note that the motor supply was switched, and reset both controllers."""
        self.powered = on
        self.fault = ""
        self._rest_us = 0
        self.stop()

    def command(self, v: float, w: float) -> bool:
        """Set the rates to drive with. Above ``fastest`` they are scaled, on the same curve.

        Args:
            v: Forward, in m/s.
            w: Counter-clockwise, in rad/s.

        Returns:
            Whether the command is accepted: not while the motors are off, not with NaN or infinity,
            and not in the second after a wheel was stuck.
        """
        if not (self.powered and is_number(v) and is_number(w)) or self._rest_us > 0:
            return False
        if v == 0 and w == 0:
            self.stop()
            return True
        # Before anything is multiplied: 32-bit floats overflow at 3e38.
        most = max(abs(v), abs(w) * self.d)
        if most > self.fastest:
            v = v / most * self.fastest
            w = w / most * self.fastest
        most = abs(v) + abs(w) * self.d
        if most > self.fastest:
            v *= self.fastest / most
            w *= self.fastest / most
        self.v = v
        self.w = w
        self._right_target = v + self.d * w
        self._left_target = v - self.d * w
        self._idle_us = 0
        return True

    def step(self, now_us: int) -> None:
        """Run one control cycle: measure, and set both duties."""
        then = self._then
        dt_us = (now_us - then) & _MASK if then >= 0 else 0
        self._then = now_us
        if dt_us >= _HALF:
            dt_us = 0
        self.right.update(now_us, self._right_target)
        self.left.update(now_us, self._left_target)
        if self._rest_us > 0:
            self._rest_us -= dt_us
        if self._right_target == 0 and self._left_target == 0:
            return
        self._idle_us += dt_us
        # Stop a step too early rather than too late.
        if self._idle_us + dt_us > self._timeout_us:
            self.stop()
            return
        if dt_us == 0:
            return
        dt = dt_us / 1000000
        self.right_duty = self._duty(self.right, self.right_pid, self._right_target, dt)
        self.left_duty = self._duty(self.left, self.left_pid, self._left_target, dt)
        right_runs = abs(self.right.speed) >= _RUNS * abs(self._right_target)
        left_runs = abs(self.left.speed) >= _RUNS * abs(self._left_target)
        # For how long each has been driven hard without turning.
        hard = _HARD * self.right_pid.limit
        if right_runs or abs(self.right_pid.output) < hard:
            self._right_us = 0
        else:
            self._right_us += dt_us
        hard = _HARD * self.left_pid.limit
        if left_runs or abs(self.left_pid.output) < hard:
            self._left_us = 0
        else:
            self._left_us += dt_us
        if self._right_us >= self._stuck_us or self._left_us >= self._stuck_us:
            if self._right_us == 0:
                self._stuck("the left wheel does")
            elif self._left_us == 0:
                self._stuck("the right wheel does")
            else:
                self._stuck("both wheels do")
        elif right_runs and left_runs:
            self.fault = ""

    def _duty(self, wheel: Wheel, pid: Pid, target: float, dt: float) -> float:
        if target == 0 or wheel.reversing:
            pid.reset()
            return 0.0
        # The time within which a wheel that is not blocked passes two edges.
        soon = _START_US + 2.5e6 * wheel.pitch / abs(target)
        return pid.step(target, wheel.speed, dt, not 0 < wheel.unsure_us < soon)

    def _stuck(self, subject: str) -> None:
        self.stop()
        self.fault = subject + " not turn: look for a block, a motor without power, a loose encoder"
        self._rest_us = _REST_MS * 1000

    def stop(self) -> None:
        """Brake now, and reset both controllers."""
        self.v = 0.0
        self.w = 0.0
        self._right_target = 0.0
        self._left_target = 0.0
        self.right_duty = 0.0
        self.left_duty = 0.0
        self.right_pid.reset()
        self.left_pid.reset()
        self._idle_us = 0
        self._right_us = 0
        self._left_us = 0
