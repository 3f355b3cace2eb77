"""LEDs: one whose brightness is set, and one that tells whether all is well."""

try:
    from typing import Any, Final
except ImportError:
    pass

_STEPS: Final = 255  # eight bits: 0 is off, 255 always on
_U16: Final = 257  # of 65535, which is always on for MicroPython


class Dimmer:
    """An LED on ``pwm``, a ``machine.PWM``, in 255 steps: ``Dimmer(PWM(Pin(22), freq=5000))``.

    ``brightness`` is what was set last, 0.0 to 1.0, at first 0.0. It shines so while it is ``on``.
    """

    def __init__(self, pwm: "Any", on: bool = True) -> None:
        self._pwm = pwm
        self.brightness = 0.0
        self.switch(on)

    def set(self, brightness: float) -> None:
        """What is beyond 0 or 1 is taken for that. NaN is refused with ValueError, and changes
        nothing.
        """
        if brightness != brightness:
            raise ValueError("a brightness is a number from 0 to 1, not nan")
        self.brightness = min(1.0, max(0.0, brightness))
        self.switch(self.on)

    def switch(self, on: bool) -> None:
        self.on = on
        self._pwm.duty_u16(int(self.brightness * _STEPS + 0.5) * _U16 if on else 0)


class Signal:
    """An LED on ``pin``, a ``machine.Pin`` that is an output: on while all is well, blinking while
    something is not.
    """

    def __init__(self, pin: "Any") -> None:
        self._pin = pin
        pin.value(1)

    def show(self, well: bool) -> None:
        """To be called every 100 ms: it blinks as fast as that."""
        self._pin.value(1 if well else not self._pin.value())
