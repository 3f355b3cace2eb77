"""Buttons, LEDs and the start of a program, on simulated pins. Also runs on MicroPython."""

from uros.drivers import starting
from uros.drivers.button import Button
from uros.drivers.led import Dimmer, Signal

SETTLE = 30


class FakePin:
    """A pin whose level and time the test sets; ``written`` are the levels written."""

    def __init__(self, level=1):
        self.level = level
        self.now = 0
        self.written = []
        self._handler = None

    def value(self, level=None):
        if level is None:
            return self.level
        self.level = level
        self.written.append(level)

    def irq(self, handler):
        self._handler = handler

    def ms(self):
        return self.now & 0x3FFFFFFF

    def edge(self, after, level, interrupt=True):
        """Set the level after ``after`` milliseconds."""
        self.now += after
        self.level = level
        if interrupt:
            self._handler(self)


class FakePwm:
    def __init__(self):
        self.duties = []

    def duty_u16(self, duty):
        self.duties.append(duty)


def pushed(pin):
    """Push for 100 ms with bounces at both ends, and wait until the level has settled."""
    for after, level in ((50, 0), (1, 1), (2, 0), (1, 1), (4, 0), (100, 1), (3, 0), (1, 1)):
        pin.edge(after, level)
    pin.now += SETTLE


def test_a_click_is_a_push_and_a_release():
    pin = FakePin()
    button = Button(pin, pin.ms)
    assert not button.clicked()
    pin.edge(100, 0)
    pin.now += 5000
    assert not button.clicked(), "the button is still held down"
    pin.edge(0, 1)
    assert not button.clicked(), "the level has not settled"
    pin.now += SETTLE
    assert button.clicked()
    assert not button.clicked()


def test_bounces_are_no_clicks():
    pin = FakePin()
    button = Button(pin, pin.ms)
    for _ in range(3):
        pushed(pin)
        assert button.clicked() and not button.clicked()


def test_clicks_are_kept_while_the_program_is_busy():
    pin = FakePin()
    button = Button(pin, pin.ms)
    for _ in range(3):
        pushed(pin)
    assert [button.clicked() for _ in range(4)] == [True, True, True, False]


def test_spikes_are_no_clicks():
    pin = FakePin()
    button = Button(pin, pin.ms)
    for _ in range(20):
        pin.edge(200, 0)
        pin.edge(SETTLE - 1, 1)
    pin.now += 1000
    assert not button.clicked()


def test_a_button_held_down_at_the_start_counts_from_the_next_push():
    pin = FakePin(0)
    button = Button(pin, pin.ms)
    pin.edge(500, 1)
    pin.now += 500
    assert not button.clicked()
    pushed(pin)
    assert button.clicked()


def test_a_button_with_the_other_polarity():
    pin = FakePin(0)
    button = Button(pin, pin.ms, pressed=1)
    pin.edge(100, 1)
    pin.edge(100, 0)
    pin.now += SETTLE
    assert button.clicked()


def test_ticks_may_wrap():
    pin = FakePin()
    pin.now = 0x3FFFFFFF - 170
    button = Button(pin, pin.ms)
    pushed(pin)
    assert button.clicked()


def test_edges_without_interrupts_are_found_by_polling():
    pin = FakePin()
    button = Button(pin, pin.ms)
    clicks = 0
    for level in (0, 1, 0, 1):
        pin.edge(0, level, interrupt=False)
        for _ in range(5):
            clicks += button.clicked()
            pin.now += 10
    assert clicks == 2


def test_an_interrupt_during_clicked():
    """An edge between two steps of clicked() is counted exactly once."""
    pin = FakePin()
    button = Button(pin, pin.ms)
    pin.edge(100, 0)
    pin.edge(100, 1)
    pin.now += SETTLE
    plain = button._settle

    def interrupted(now):
        plain(now)
        button._settle = plain
        pin.edge(1, 0)

    button._settle = interrupted
    assert button.clicked()
    pin.edge(100, 1)
    pin.now += SETTLE
    assert button.clicked(), "the push during clicked()"
    assert not button.clicked()


def test_an_edge_between_reading_time_and_level():
    """An edge after the time is read and before the level is does not count as settled."""
    pin = FakePin()
    button = Button(pin, pin.ms)
    pin.now = 1000

    def late():
        before = pin.now
        if pin.level:
            pin.edge(1, 0)
        return before

    button._ms = late
    assert not button.clicked()
    button._ms = pin.ms
    pin.edge(1, 1)
    pin.now += 1000
    assert not button.clicked()


def test_a_dimmer_has_255_steps_and_ends():
    pwm = FakePwm()
    led = Dimmer(pwm)
    assert pwm.duties == [0]
    for brightness, step in (
        (0.0, 0), (1.0, 255), (0.5, 128), (0.3, 77), (1 / 255, 1), (0.001, 0), (1.7, 255),
        (-0.2, 0), (float("inf"), 255), (float("-inf"), 0), (1, 255),
    ):  # fmt: skip
        led.set(brightness)
        assert pwm.duties[-1] == step * 257, (brightness, pwm.duties[-1])
        assert 0 <= led.brightness <= 1
    assert max(pwm.duties) == 65535


def test_a_dimmer_refuses_nan():
    pwm = FakePwm()
    led = Dimmer(pwm)
    led.set(0.5)
    try:
        led.set(float("nan"))
    except ValueError as error:
        assert "0 to 1" in str(error)
    else:
        raise AssertionError("nan was taken")
    assert led.brightness == 0.5 and pwm.duties[-1] == 128 * 257


def test_a_dimmer_that_is_off_keeps_its_brightness():
    pwm = FakePwm()
    led = Dimmer(pwm, on=False)
    led.set(1.0)
    assert not led.on and set(pwm.duties) == {0}
    led.switch(True)
    assert led.on and pwm.duties[-1] == 65535
    led.switch(False)
    assert pwm.duties[-1] == 0
    led.set(0.2)
    led.switch(True)
    assert pwm.duties[-1] == 51 * 257


def test_a_signal_is_on_or_blinks():
    pin = FakePin(0)
    led = Signal(pin)
    for well in (True, False, False, False, True, True):
        led.show(well)
    assert pin.written == [1, 1, 0, 1, 0, 1, 1]


def test_attempt_returns_the_result_of_build():
    pin = FakePin(0)
    assert starting.attempt(lambda: 7, Signal(pin)) == 7
    assert pin.written == [1]
