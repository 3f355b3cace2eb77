"""Identification of both motors of a rover, and PID gains for them."""

try:
    from typing import Final
except ImportError:
    pass

from .pid import Pid
from .wheel import Wheel

# Duties of the test runs, as shares of the largest: forward and back, slow and fast.
_RUNS: Final = (0.3, -0.3, 0.55, -0.55)
# The ramp crosses the whole range of duties in so many seconds; it ends when the wheel turns.
_RAMP_S: Final = 4.0
# Length of a run, and when in it the measurement of the speed begins.
_RUN_US: Final = 1300000
_MEASURED_US: Final = 700000
# Age of a wheel's measured speed when it is used: half of two intervals, and half a period.
_DELAY_S: Final = 0.03
_KP: Final = 0.7


class Answer:
    """Model of one motor, estimated from the test runs.

    ``starts`` is the duty at which it begins to turn, ``dead_zone`` and ``kf`` are those of
    :class:`~.pid.Pid`, ``lag`` is its time constant in seconds.
    """

    def __init__(self, wheel: Wheel) -> None:
        self.wheel = wheel
        self.starts = 0.0
        self.dead_zone = 0.0
        self.kf = 0.0
        self.lag = 0.0
        self._speeds = [0.0] * len(_RUNS)
        self._lags = [0.0] * len(_RUNS)
        self._from_us = 0
        self._begun = 0
        self._edges = 0
        self._edge_us = 0

    def begin(self) -> None:
        """Begin a run."""
        self._begun = self.wheel.edges
        self._edge_us = -1

    def check(self, after_us: int) -> None:
        """Note the first edge of a run's measured part, ``after_us`` after the run's start."""
        if self._edge_us < 0 and self.wheel.edges != self._begun:
            self._edges = self.wheel.edges
            self._edge_us = after_us - self.wheel.age_us

    def finish(self, run: int, after_us: int) -> None:
        """Store the speed and the time constant of a run; nothing if the wheel has stopped."""
        wheel = self.wheel
        last_us = after_us - wheel.age_us
        if self._edge_us < 0 or last_us <= self._edge_us:
            return
        speed = abs(wheel.edges - self._edges) * wheel.pitch / (last_us - self._edge_us) * 1e6
        # The first edge comes after half the distance between two edges, on average.
        way = (abs(wheel.edges - self._begun) - 0.5) * wheel.pitch
        self._speeds[run] = speed
        if speed > 0:
            self._lags[run] = last_us / 1e6 - way / speed

    def judge(self, limit: float) -> str:
        """Fit ``kf``, ``dead_zone`` and ``lag`` to the runs.

        Args:
            limit: The largest duty.

        Returns:
            What is wrong with the runs, or "".
        """
        slow = (self._speeds[0] + self._speeds[1]) / 2
        fast = (self._speeds[2] + self._speeds[3]) / 2
        if min(self._speeds) <= 0:
            return "stopped on the way: is it blocked, or its encoder loose?"
        if fast < slow * 1.2:
            return "is hardly faster with almost twice the duty: is the battery empty?"
        if abs(self._speeds[2] - self._speeds[3]) > 0.5 * fast:
            return "is much faster in one direction than in the other: does it slip or rub?"
        low = _RUNS[0] * limit
        high = _RUNS[2] * limit
        self.kf = (high - low) / (fast - slow)
        self.dead_zone = max(low - self.kf * slow, 0.0)
        self.lag = max(sum(self._lags) / len(self._lags), 0.02)
        return ""

    def apply(self, pid: Pid) -> None:
        """Set the gains of a Pid.

        An error decays within about one and a half of the motor's time constants: the delay of the
        measured speed does not allow less. The integral cancels the motor's lag.
        """
        pid.kf = self.kf
        pid.dead_zone = self.dead_zone
        pid.kp = _KP * self.kf
        pid.ki = pid.kp / (self.lag + _DELAY_S)
        pid.kd = 0.0
        pid.lag = self.lag + _DELAY_S
        pid.reset()


class AutoTune:
    """Tunes both wheels at once, on the floor.

    It ramps the duties up until each wheel turns, and then drives forward and back at two duties,
    which takes about ten seconds and a metre of space in front.

    Call `step` every 20 ms or so until it returns False, and give ``right_duty`` and ``left_duty``
    to the motors. Then ``fault`` is "" and `apply` sets the gains of the Pids, or ``fault`` says
    what is wrong.

    The speeds at two duties give the dead zone and the duty for a speed. The difference between
    the distance of a run and that at its final speed throughout gives the time constant.
    """

    def __init__(self, right: Wheel, left: Wheel, limit: float = 255.0) -> None:
        self.right = Answer(right)
        self.left = Answer(left)
        self.right_duty = 0.0
        self.left_duty = 0.0
        self.fault = ""
        self.done = False
        self._limit = limit
        self._run = -1  # the ramp
        self._stopping = True
        self._after_us = 0
        self._then = -1

    def step(self, now_us: int) -> bool:
        """Measure, and set both duties.

        Args:
            now_us: Ticks in microseconds.

        Returns:
            Whether the tuning goes on.
        """
        dt_us = (now_us - self._then) & 0x3FFFFFFF if self._then >= 0 else 0
        self._then = now_us
        self.right.wheel.update(now_us, self.right_duty)
        self.left.wheel.update(now_us, self.left_duty)
        if self.done:
            return False
        self._after_us += dt_us
        if self._stopping:
            if self.right.wheel.resting and self.left.wheel.resting and self._after_us > 300000:
                self._start()
        elif self._run < 0:
            self._ramp()
        else:
            self._measure()
        return not self.done

    def apply(self, right: Pid, left: Pid) -> None:
        """Set the gains of both Pids."""
        self.right.apply(right)
        self.left.apply(left)

    def _start(self) -> None:
        self._stopping = False
        self._after_us = 0
        self.right.begin()
        self.left.begin()
        if self._run >= 0:
            self.right_duty = self.left_duty = _RUNS[self._run] * self._limit
            # The wheels stand still, so they take the new direction at once.
            self.right.wheel.update(self._then, self.right_duty)
            self.left.wheel.update(self._then, self.left_duty)

    def _stop(self) -> None:
        self._run += 1
        self._stopping = True
        self._after_us = 0
        self.right_duty = self.left_duty = 0.0

    def _end(self, fault: str = "") -> None:
        self.right_duty = self.left_duty = 0.0
        self.fault = fault
        self.done = True

    def _ramp(self) -> None:
        duty = self._after_us / 1e6 / _RAMP_S * self._limit
        if duty > 0.6 * self._limit:
            if self.right.starts or self.left.starts:
                self._end(
                    "the %s wheel does not turn: is it blocked, its motor without power, its"
                    " encoder off?" % ("left" if self.right.starts else "right")
                )
            else:
                self._end("no wheel turns: are the motors switched on, the encoders connected?")
            return
        # A wheel that turns already keeps its duty, so that it does not accelerate further.
        self.right_duty = self._up(self.right, duty)
        self.left_duty = self._up(self.left, duty)
        if self.right.starts and self.left.starts:
            self._stop()

    def _up(self, answer: Answer, duty: float) -> float:
        if not answer.starts and abs(answer.wheel.edges - answer._begun) >= 2:
            answer.starts = duty
        return min(duty, answer.starts) if answer.starts else duty

    def _measure(self) -> None:
        after = self._after_us
        if after >= _MEASURED_US:
            self.right.check(after)
            self.left.check(after)
        if after < _RUN_US:
            return
        self.right.finish(self._run, after)
        self.left.finish(self._run, after)
        self._stop()
        if self._run == len(_RUNS):
            fault = self.right.judge(self._limit)
            if fault:
                self._end("the right wheel " + fault)
                return
            fault = self.left.judge(self._limit)
            self._end(fault and "the left wheel " + fault)
