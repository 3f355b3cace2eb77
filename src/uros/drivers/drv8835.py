"""TI DRV8835 in IN/IN mode: one of its two H-bridges, on two PWM outputs.

The bridge alternates between driving and braking (slow decay), so the speed follows the duty cycle
even when it is low. If it coasted instead of braking, the speed would not follow a low duty cycle.
"""

try:
    from typing import Any
except ImportError:
    pass


class DRV8835:
    """An H-bridge on two PWMs: those of AIN1 and AIN2, or of BIN1 and BIN2."""

    def __init__(self, first: "Any", second: "Any") -> None:
        self._first = first
        self._second = second
        self.coast()

    def drive(self, duty: float) -> None:
        """Set the duty cycle, from -255 (full speed backward) to 255 (forward); 0 brakes.

        Values beyond this range are limited to it.
        """
        off = 65535 - int(min(abs(duty), 255) * 257)
        if duty >= 0:
            self._first.duty_u16(65535)
            self._second.duty_u16(off)
        else:
            self._first.duty_u16(off)
            self._second.duty_u16(65535)

    def coast(self) -> None:
        """Switch both outputs off, so that the motor coasts."""
        self._first.duty_u16(0)
        self._second.duty_u16(0)
