"""Pins of a virtual board, and simple parts on them: LEDs, buttons and potentiometers."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from .parts import Part

IN: Final = "in"
OUT: Final = "out"
UP: Final = "up"
DOWN: Final = "down"
RISING: Final = 1
FALLING: Final = 2
FULL: Final = 65535
"""The duty of an output that is always high."""

_BOUNCE_US: Final = 8_000
_BOUNCES: Final = 5
_LONGEST_BOUNCE_MS: Final = 10_000


class Pin:
    """A pin with a level.

    An output reads as the level written; an input as the level of its wire, or as its pull.

    Args:
        name: The pin's name.
        function: What the board uses the pin for, "" for nothing.
        wire: Returns the level that the wire has by itself; None where nothing drives it.
        driven: Called with each level that the pin is set to as an output.
        on_duty: Called with the time that the pin is high, in parts of :data:`FULL`: a part without
            a clock of its own sees no more of PWM.
        analog: Returns the voltage on the wire as a fraction of the converter's range.
    """

    def __init__(
        self,
        name: str,
        function: str = "",
        wire: Callable[[], int | None] | None = None,
        driven: Callable[[int], None] | None = None,
        on_duty: Callable[[int], None] | None = None,
        analog: Callable[[], float] | None = None,
    ) -> None:
        self.name = name
        self.function = function
        self.mode = IN
        self.pull = ""
        self.edges = 0
        self.analog = analog
        self.on_edge: Callable[[int, Pin, int], None] | None = None
        self._level = 0
        self._duty: int | None = None  # of PWM
        self._wire = wire
        self._driven = driven
        self._on_duty = on_duty
        self._reported_duty = 0

    def value(self, level: int | None = None) -> int:
        """Return the level; if one is given, set it first.

        A level that is set takes effect once the pin is an output.
        """
        if level is not None:
            level = 1 if level else 0
            changed, self._level = level != self._level, level
            if changed and self.mode == OUT and self._driven is not None:
                self._driven(level)
            self.tell()
        if self.mode == OUT and not (self._level and self._wire):
            return self._level
        outside = None if self._wire is None else self._wire()
        if outside is not None:
            return outside
        return 0 if self.pull == DOWN else 1

    def pwm(self, duty: int | None) -> None:
        """Set the PWM duty in parts of :data:`FULL`; None stops PWM."""
        self._duty = duty
        if duty is not None:
            self.mode = OUT
        self.tell()

    def tell(self) -> None:
        """Report the duty to the part on the pin if it has changed."""
        duty = self._duty
        if duty is None:
            duty = FULL if self.mode == OUT and self._level else 0
        if duty != self._reported_duty:
            self._reported_duty = duty
            if self._on_duty is not None:
                self._on_duty(duty)

    def edge(self, t_us: int, level: int) -> None:
        """Report a new level of the wire; an interrupt follows if enabled for this edge."""
        if self.on_edge is not None and self.edges & (RISING if level else FALLING):
            self.on_edge(t_us, self, level)

    def reset(self) -> None:
        """Handle a reset of the microcontroller: an input without a pull."""
        self.mode = IN
        self.pull = ""
        self.edges = 0
        self.on_edge = None
        self._level = 0
        self.pwm(None)


class Led(Part):
    """An LED; ``changed(self)`` is called when ``brightness`` has changed."""

    FAULTS: ClassVar = {"dead": "does not shine, whatever the pin does"}

    def __init__(self, name: str, changed: Callable[[Part], None] = lambda _: None) -> None:
        super().__init__(name)
        self._duty = 0
        self._changed = changed

    @property
    def brightness(self) -> float:
        """Brightness from 0.0 to 1.0."""
        return 0.0 if "dead" in self.faults else self._duty / FULL

    def drive(self, duty: int) -> None:
        """Set the duty of the pin, 0 to :data:`FULL`."""
        self._duty = duty
        self._changed(self)

    def shows(self) -> str:
        """Return "on", "off" or the brightness in percent."""
        percent = round(self.brightness * 100)
        if 0 < percent < 100:
            return f"{percent} %"
        return "on" if percent else "off"


class Button(Part):
    """A push button between its pin and the rail of ``pressed_level``; else the pin's pull counts.

    Its contacts bounce: within 8 ms of each press and release there are short edges at times drawn
    from ``seed``. ``bounce=MS`` changes this time until the part's faults are cleared.
    """

    FAULTS: ClassVar = {
        "stuck": "stays pressed",
        "broken": "its contacts never touch",
    }
    ACTS: ClassVar = {
        "press": "push it and hold it",
        "release": "let it go",
        "tap": "press for 0.1 s; tap=SECONDS for another time",
        "bounce": f"bounce=MS: for how long its contacts bounce ({_BOUNCE_US // 1000} when off)",
    }

    def __init__(self, name: str, seed: int = 0, pressed_level: int = 0) -> None:
        super().__init__(name)
        self._random = random.Random(f"{seed}/{name}")
        self._pressed_level = pressed_level
        self._t_us = 0
        self._pressed = False  # the contact, bounces included
        self._held = False  # whether the user holds it
        # Time of a change, the contact from then on, and the level it settles to; in order of time.
        self._due: list[tuple[int, bool, bool]] = []
        self._bounce_us = _BOUNCE_US
        self.pin = Pin(name, name, self.wire)

    def wire(self) -> int | None:
        """Return the level of the wire while the button connects it, else None."""
        return self._pressed_level if self._closes(self._pressed) else None

    def _closes(self, pressed: bool) -> bool:
        return (pressed or "stuck" in self.faults) and "broken" not in self.faults

    def act(self, kind: str, value: str = "") -> None:
        """Press, release or tap the button, or set the bounce time; ValueError for a bad value."""
        if kind == "bounce":
            self._bounce_us = round(_number(value, _LONGEST_BOUNCE_MS, "bounce=8") * 1000)
        elif kind == "tap":
            hold = round(_number(value or "0.1", 3600, "tap=0.1") * 1e6)
            self._move(self._t_us, True)
            self._move(self._t_us + max(hold, self._bounce_us), False)
        else:
            self._move(self._t_us, kind == "press")

    def _move(self, t_us: int, closed: bool) -> None:
        times = sorted(self._random.randrange(self._bounce_us + 1) for _ in range(2 * _BOUNCES))
        self._due = [entry for entry in self._due if entry[0] < t_us]
        self._due.append((t_us, closed, closed))
        if self._bounce_us:
            for index, after in enumerate(times):
                self._due.append((t_us + after, closed if index % 2 else not closed, closed))

    def shows(self) -> str:
        """Return "pressed" or "released", without bounces."""
        # Not the contact: its bounces would appear as presses.
        return "pressed" if self._closes(self._held) else "released"

    def fault(self, kind: str) -> None:
        """Activate a fault; a change of the level is an edge."""
        self._apply(lambda: self.faults.add(kind))

    def heal(self) -> None:
        """Clear all faults and restore the bounce time."""
        self._bounce_us = _BOUNCE_US
        self._apply(self.faults.clear)

    def _apply(self, change: Callable[[], object]) -> None:
        """Make a change; report an edge if the level of the pin has changed."""
        before = self.pin.value()
        change()
        if self.pin.value() != before:
            self.pin.edge(self._t_us, 1 - before)

    def advance(self, t_us: int) -> None:
        """Apply all changes of the contact up to ``t_us``."""
        while self._due and self._due[0][0] <= t_us:
            self._t_us, closed, self._held = self._due.pop(0)

            def change(to: bool = closed) -> None:
                self._pressed = to

            self._apply(change)
        self._t_us = t_us


class Potentiometer(Part):
    """A potentiometer across the converter's whole range; :meth:`analog` is its wiper."""

    FAULTS: ClassVar = {"open": "its wiper has no contact: noise"}
    ACTS: ClassVar = {"turn": "turn=PERCENT: turn its knob"}

    def __init__(self, name: str, seed: int = 0) -> None:
        super().__init__(name)
        self._random = random.Random(f"{seed}/{name}")
        self._percent = 50.0

    def analog(self) -> float:
        """Return the position of the wiper, 0.0 to 1.0; noise without contact."""
        if "open" in self.faults:
            return self._random.random()
        return self._percent / 100

    def act(self, kind: str, value: str = "") -> None:
        """Turn the knob; ValueError for a value that is not 0 to 100 percent."""
        self._percent = _number(value, 100, "turn=50")

    def shows(self) -> str:
        """Return the position in percent."""
        return f"{self._percent:g} %"


def _number(text: str, most: float, example: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number <= most:
        raise ValueError(f"it takes a number from 0 to {most:g}, like {example}")
    return number
