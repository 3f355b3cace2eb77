"""TI DRV8835 in IN/IN mode: one of its two H-bridges, on two PWM outputs.

It alternates between driving and braking (slow decay): the speed then follows the duty even where
that is small, which it does not where a motor coasts in between.
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
        """Set the duty: -255 is full speed backward, 255 forward, 0 brakes."""
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
