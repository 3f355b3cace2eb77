"""A PID controller for the speed of a motor that has a dead zone."""


class Pid:
    """``kp``, ``ki`` and ``kd`` turn an error in m/s into a duty; ``limit`` is the largest duty.

    ``dead_zone`` is the duty below which the motor does not turn, and ``kf`` the duty that one m/s
    takes above it: both are given at once. ``lag`` is the time constant in seconds by which the
    motor follows, with the delay of its measurement: the error is that from where the motor should
    be by now, ``expected``, so that the integral does not grow while it accelerates as it can.
    All three are 0 where they are not known.

    The integral is trapezoid, and holds while the output is at its limit and the error would bring
    it further. Against its target a motor is not driven: then the output is 0, which brakes.

    ``output`` is the last duty.
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
        """The duty for the next ``dt`` seconds. Where the speed is not ``known`` yet, the motor is
        taken to do what is expected.
        """
        self.expected += (target - self.expected) * (dt / (self.lag + dt))
        if not known:
            measured = self.expected
        error = self.expected - measured
        area = (error + self.error) * 0.5 * dt
        out = self.kf * target + self.kp * error + self.ki * (self.integral + area)
        # By the measurement and not by the error: a new target is no reason to jump.
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
