"""A push button, debounced."""

try:
    from typing import Any, Callable, Final
except ImportError:
    pass

_HALF: Final = 0x20000000  # of the period of ticks
_MASK: Final = 0x3FFFFFFF


class Button:
    """A push button that is debounced.

    Edges are noticed by interrupts, so that neither a short push nor a bounce is missed while the
    program is busy. A button that is held down at construction counts from the next push on.

    Args:
        pin: A ``machine.Pin`` that is an input.
        ms: Returns milliseconds modulo 2^30, such as ``node.clock.ms``.
        settle_ms: A level counts after so long; contacts mostly bounce for less than 10 ms.
        pressed: The pin's level while the button is pressed.
    """

    def __init__(
        self, pin: "Any", ms: "Callable[[], int]", settle_ms: int = 30, pressed: int = 0
    ) -> None:
        self._pin = pin
        self._ms = ms
        self._settle_ms = settle_ms
        self._down = pressed
        # The level since the last edge, and when that was.
        self._level: int = pin.value()
        self._since = ms()
        self._settled = self._level
        self._pushed = False
        self._clicks = 0
        # An interrupt may come between any two steps of clicked().
        self._busy = False
        self._late = False
        pin.irq(self._edge)

    def clicked(self) -> bool:
        """Return whether it was pushed and released once more; to be called every 10 ms or so."""
        level = self._pin.value()
        now = self._ms()
        self._busy = True
        self._settle(now)
        if level != self._level:  # an edge that was too quick for an interrupt
            self._level = level
            self._since = now
        clicked = self._clicks > 0
        if clicked:
            self._clicks -= 1
        self._busy = False
        if self._late:
            self._late = False
            self._edge(self._pin)
        return clicked

    def _edge(self, pin: "Any") -> None:
        if self._busy:
            self._late = True
            return
        now = self._ms()
        self._settle(now)
        self._level = pin.value()
        self._since = now

    def _settle(self, now: int) -> None:
        """Accept the level since the last edge if it has lasted for ``settle_ms``."""
        lasted = ((now - self._since + _HALF) & _MASK) - _HALF
        if self._level == self._settled or lasted < self._settle_ms:
            return
        self._settled = self._level
        if self._level == self._down:
            self._pushed = True
        elif self._pushed:
            self._pushed = False
            self._clicks += 1
