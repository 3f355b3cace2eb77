"""A PID controller for the speed of a motor that has a dead zone."""


class Pid:
    """Speed controller of a motor: PID with feed-forward, and a first-order reference model.

    ``dead_zone`` and ``kf`` are feed-forward. The error is the difference to ``expected``, the
    speed that a motor with the time constant ``lag`` has by now, so that the integral does not wind
    up while the motor accelerates as fast as it can.

    The integral follows the trapezoidal rule, and is held while the output is saturated and the
    error would increase it further. A motor is never driven against its target: the output is 0
    then, which brakes. ``output`` is the last duty.

    Args:
        kp: Duty per m/s of error.
        ki: Duty per metre of integrated error.
        kd: Duty per m/s² of measured acceleration.
        limit: The largest duty.
        dead_zone: Duty below which the motor does not turn; 0 if unknown.
        kf: Duty per m/s above the dead zone; 0 if unknown.
        lag: Time constant of the motor and the delay of its measurement, in seconds; 0 if unknown.
    """

    def __init__(
        self,
        kp: float,
        ki: float,
        kd: float = 0.0,
        limit: float = 255.0,
        dead_zone: float = 0.0,
        kf: float = 0.0,
        lag: float = 0.0,
    ) -> None:
        self.kp = kp
        self.ki = ki
        self.kd = kd
        self.limit = limit
        self.dead_zone = dead_zone
        self.kf = kf
        self.lag = lag
        self.reset()

    def reset(self) -> None:
        """Forget the integral, the last error and the output."""
        self.integral = 0.0
        self.error = 0.0
        self.output = 0.0
        self.expected = 0.0
        self._measured = 0.0

    def step(self, target: float, measured: float, dt: float, known: bool = True) -> float:
        """Return the duty for the next cycle.

        Args:
            target: Speed in m/s.
            measured: Speed in m/s.
            dt: Length of the cycle in seconds.
            known: False while no speed is measured yet: the expected one is used instead.
        """
        self.expected += (target - self.expected) * (dt / (self.lag + dt))
        if not known:
            measured = self.expected
        error = self.expected - measured
        area = (error + self.error) * 0.5 * dt
        out = self.kf * target + self.kp * error + self.ki * (self.integral + area)
        # The derivative of the measurement, not of the error: a new target must not cause a jump.
        out += self.kd * (self._measured - measured) / dt
        if target > 0:
            out += self.dead_zone
        elif target < 0:
            out -= self.dead_zone
        high = self.limit if target >= 0 else 0.0
        low = -self.limit if target <= 0 else 0.0
        if out > high:
            out = high
            if area > 0:
                area = 0.0
        elif out < low:
            out = low
            if area < 0:
                area = 0.0
        self.integral += area
        if self.ki:
            most = self.limit / abs(self.ki)
            if self.integral > most:
                self.integral = most
            elif self.integral < -most:
                self.integral = -most
        self.error = error
        self._measured = measured
        self.output = out
        return out
