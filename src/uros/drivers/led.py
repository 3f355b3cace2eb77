"""LEDs: a dimmed one, and one that signals faults."""

try:
    from typing import Any, Final
except ImportError:
    pass

_STEPS: Final = 255  # eight bits: 0 is off, 255 always on
_U16: Final = 257  # of 65535, which is always on for MicroPython


class Dimmer:
    """An LED with 255 steps of brightness: ``Dimmer(PWM(Pin(22), freq=5000))``.

    ``brightness`` is the last one set, 0.0 to 1.0, and 0.0 at first; it applies while ``on``.

    Args:
        pwm: A ``machine.PWM``.
        on: Whether the LED is switched on.
    """

    def __init__(self, pwm: "Any", on: bool = True) -> None:
        self._pwm = pwm
        self.brightness = 0.0
        self.switch(on)

    def set(self, brightness: float) -> None:
        """Set the brightness, clamped to 0.0 to 1.0.

        Raises:
            ValueError: It is NaN; nothing is changed.
        """
        if brightness != brightness:
            raise ValueError("a brightness is a number from 0 to 1, not nan")
        self.brightness = min(1.0, max(0.0, brightness))
        self.switch(self.on)

    def switch(self, on: bool) -> None:
        """Switch the LED on, with the brightness that is set, or off."""
        self.on = on
        self._pwm.duty_u16(int(self.brightness * _STEPS + 0.5) * _U16 if on else 0)


class Signal:
    """An LED that is on while there is no fault, and blinks during one.

    Args:
        pin: A ``machine.Pin`` that is an output.
    """

    def __init__(self, pin: "Any") -> None:
        self._pin = pin
        pin.value(1)

    def show(self, well: bool) -> None:
        """Set or toggle the LED; to be called every 100 ms, half a period of blinking."""
        self._pin.value(1 if well else not self._pin.value())
