"""A failed start. CPython only: MicroPython's modules have no time of their own to replace."""

from unit.drivers.portable_button_led import FakePin

from uros.drivers import starting
from uros.drivers.led import Signal


class FakeTime:
    def __init__(self):
        self.slept = []

    def sleep(self, seconds):
        self.slept.append(seconds)


def test_a_failed_start_is_printed_and_blinks_for_a_second():
    real, starting.time = starting.time, FakeTime()
    print_real, errors = starting.print_exception, []
    starting.print_exception = errors.append
    try:
        pin = FakePin(0)

        def build():
            raise ValueError("UART(2) doesn't exist")

        assert starting.attempt(build, Signal(pin)) is None
        assert starting.attempt(build) is None
        assert starting.time.slept == [0.1] * 20
        assert pin.written == [1] + [0, 1] * 5
        assert [str(error) for error in errors] == ["UART(2) doesn't exist"] * 2
        assert starting.attempt(lambda: 7, Signal(pin)) == 7
        assert starting.time.slept == [0.1] * 20
    finally:
        starting.time, starting.print_exception = real, print_real
