"""The TI DRV8835 dual H-bridge in IN/IN mode (MODE pin low).

The truth table of the data sheet: 0 0 coasts, 1 0 drives forward, 0 1 in reverse, 1 1 brakes. With
PWM the bridge alternates between these states. The periods of both inputs start together, as with
two channels of one timer, so that both are high for the shorter of the two duty cycles.
"""

from __future__ import annotations

from typing import ClassVar, Final

FULL: Final = 65535  # a duty cycle of 100 %
FASTEST: Final = 250_000  # Hz; the outputs do not follow faster inputs (data sheet, 6.6)


class Drv8835:
    """A DRV8835. Inputs 0 to 3 are AIN1, AIN2, BIN1, BIN2; bridge 0 is A, 1 is B.

    Attributes:
        powered: Whether the motors' supply is on; without it they coast.
        faults: The faults that are injected.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "overheated": "is in thermal shutdown: both motors coast",
        "dead_a": "bridge A does not drive",
        "dead_b": "bridge B does not drive",
    }

    def __init__(self) -> None:
        self.powered = False
        self.faults: set[str] = set()
        self._duty = [0, 0, 0, 0]
        self._fast = [False] * 4

    def set_duty(self, channel: int, duty: int, frequency: int = 1000) -> None:
        """Set the PWM at an input. Above 250 kHz an input counts as low.

        Args:
            channel: The input, 0 to 3.
            duty: The duty cycle, 0 to 65535.
            frequency: The PWM frequency in Hz.

        Raises:
            ValueError: The channel or the duty cycle is out of range.
        """
        if not 0 <= channel <= 3:
            raise ValueError(f"a DRV8835 has inputs 0 to 3, not {channel}")
        if not 0 <= duty <= FULL:
            raise ValueError(f"a duty is 0 to {FULL}, not {duty}")
        self._duty[channel] = duty
        # A constant level has no frequency.
        self._fast[channel] = frequency > FASTEST and 0 < duty < FULL

    def off(self) -> None:
        """Set all inputs low and switch off the motors' supply, as after a reset."""
        self._duty = [0, 0, 0, 0]
        self._fast = [False] * 4
        self.powered = False

    def bridge(self, which: int) -> tuple[float, float]:
        """Return the duty cycles of driving (-1 to 1, negative in reverse) and of braking."""
        dead = "dead_b" if which else "dead_a"
        if not self.powered or "overheated" in self.faults or dead in self.faults:
            return 0.0, 0.0
        first = 0 if self._fast[2 * which] else self._duty[2 * which]
        second = 0 if self._fast[2 * which + 1] else self._duty[2 * which + 1]
        return (first - second) / FULL, min(first, second) / FULL
