"""What a microcontroller knows of its resets: the cause of the last one, watchdog, kept memory."""

from __future__ import annotations

from typing import Final

from .clock import BoardClock

# The causes, as MicroPython numbers them on an ESP32.
POWER_ON: Final = 1
HARD: Final = 2
WATCHDOG: Final = 3
DEEP_SLEEP: Final = 4
SOFT: Final = 5


class Resets:
    """Cause of the last reset, watchdog, and the memory of the real-time clock.

    ``cause`` is one of the constants above, ``memory`` what the program has stored; both are as
    after power-on at first.

    Args:
        clock: The board's clock.
    """

    def __init__(self, clock: BoardClock) -> None:
        self.cause = POWER_ON
        self.memory = b""
        self._clock = clock
        self._timeout_us = 0  # 0: the watchdog is off
        self._due_us = 0

    def feed(self, timeout_ms: int = 0) -> None:
        """Feed the watchdog; ``timeout_ms`` starts it, or changes its timeout."""
        if timeout_ms:
            self._timeout_us = timeout_ms * 1000
        self._due_us = self._clock.world_us() + self._timeout_us

    def left_us(self) -> int | None:
        """Return the true microseconds until the watchdog resets the board; None if it is off."""
        if not self._timeout_us:
            return None
        return max(0, self._due_us - self._clock.world_us())

    def begin(self, cause: int) -> None:
        """Note a reset. All but a soft one switch the watchdog off."""
        self.cause = cause
        if cause != SOFT:
            self._timeout_us = 0
