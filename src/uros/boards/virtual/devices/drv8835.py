"""TI DRV8835, a double H-bridge, in IN/IN mode (its MODE pin low).

The truth table of the datasheet: 0 0 coasts, 1 0 is forward, 0 1 reverse, 1 1 brakes. PWM goes
through the table in turn. Its two inputs begin their periods together, as the channels of one timer
do, so that they are both high for the shorter duty of the two.
"""

from __future__ import annotations

from typing import ClassVar, Final

FULL: Final = 65535
FASTEST: Final = 250_000  # Hz; the outputs do not follow faster inputs (datasheet, 6.6)


class Drv8835:
    """Inputs 0 to 3 are AIN1, AIN2, BIN1, BIN2; bridge 0 is A, 1 is B.

    ``powered`` says whether its motors' supply is on: without it they coast.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "overheated": "has switched itself off: both motors coast",
        "dead_a": "bridge A does nothing",
        "dead_b": "bridge B does nothing",
    }

    def __init__(self) -> None:
        self.powered = False
        self.faults: set[str] = set()
        self._duty = [0, 0, 0, 0]
        self._fast = [False] * 4

    def set_duty(self, channel: int, duty: int, frequency: int = 1000) -> None:
        """``duty`` of 65535. Above 250 kHz an input counts as low."""
        if not 0 <= channel <= 3:
            raise ValueError(f"a DRV8835 has inputs 0 to 3, not {channel}")
        if not 0 <= duty <= FULL:
            raise ValueError(f"a duty is 0 to {FULL}, not {duty}")
        self._duty[channel] = duty
        # All the time high or low has no frequency.
        self._fast[channel] = frequency > FASTEST and 0 < duty < FULL

    def off(self) -> None:
        """All inputs are low and the motors' supply is off, as after a reset."""
        self._duty = [0, 0, 0, 0]
        self._fast = [False] * 4
        self.powered = False

    def bridge(self, which: int) -> tuple[float, float]:
        """The shares of the time in which it drives (negative in reverse) and brakes."""
        dead = "dead_b" if which else "dead_a"
        if not self.powered or "overheated" in self.faults or dead in self.faults:
            return 0.0, 0.0
        first = 0 if self._fast[2 * which] else self._duty[2 * which]
        second = 0 if self._fast[2 * which + 1] else self._duty[2 * which + 1]
        return (first - second) / FULL, min(first, second) / FULL
