"""Pins, LEDs, buttons and potentiometers, without a program."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.hardware.pins import (
    DOWN,
    FALLING,
    FULL,
    IN,
    OUT,
    RISING,
    UP,
    Button,
    Led,
    Pin,
)
from uros.boards.virtual.hardware.pins import Potentiometer as Knob


def edges_of(button, wanted=RISING | FALLING):
    """Return a list that gets (time, level) of each interrupt of the button's pin."""
    edges = []
    button.pin.pull = UP
    button.pin.edges = wanted
    button.pin.on_edge = lambda t_us, pin, level: edges.append((t_us, level))
    return edges


def test_an_input_that_nothing_drives_follows_its_pull():
    pin = Pin("1")
    assert pin.mode == IN and pin.value() == 1  # as an open input of most boards reads
    pin.pull = DOWN
    assert pin.value() == 0
    pin.pull = UP
    assert pin.value() == 1


def test_a_driven_wire_overrides_the_pull():
    level = 0
    pin = Pin("1", wire=lambda: level)
    pin.pull = UP
    assert pin.value() == 0


def test_an_led_is_on_while_its_pin_is_high():
    states = []
    led = Led("led", lambda part: states.append(part.shows()))
    pin = Pin("22", on_duty=led.drive)
    pin.value(1)
    assert led.shows() == "off" and not states  # not an output yet
    pin.mode = OUT
    pin.tell()
    assert led.shows() == "on" and led.brightness == 1.0
    pin.pwm(FULL // 4)
    assert led.shows() == "25 %"
    pin.pwm(0)
    pin.pwm(None)
    assert led.shows() == "on"  # the level is still set
    pin.reset()
    assert led.shows() == "off" and states == ["on", "25 %", "off", "on", "off"]


def test_a_dead_led_is_dark():
    led = Led("led")
    led.drive(FULL)
    led.fault("dead")
    assert led.brightness == 0.0 and led.shows() == "off"
    led.heal()
    assert led.shows() == "on"


def test_a_button_bounces_and_ends_pressed():
    button = Button("button", seed=3)
    edges = edges_of(button)
    button.act("press")
    button.advance(1_000_000)
    assert button.shows() == "pressed" and button.pin.value() == 0
    assert len(edges) >= 3 and edges[0] == (0, 0) and edges[-1][1] == 0
    assert edges[-1][0] <= 8_000
    # Each edge is another level than the one before.
    assert all(a[1] != b[1] for a, b in zip(edges, edges[1:], strict=False))


def test_an_interrupt_at_falling_edges_gets_no_rising_edge():
    button = Button("button")
    edges = edges_of(button, FALLING)
    button.act("tap")
    button.advance(1_000_000)
    assert {level for _, level in edges} == {0}


@given(
    seed=st.integers(0, 1000), bounce=st.floats(0, 50), hold=st.floats(0, 2),
    step=st.integers(1, 100_000),
)  # fmt: skip
def test_a_tap_ends_released_and_does_not_depend_on_the_time_steps(seed, bounce, hold, step):
    def run(rhythm):
        button = Button("button", seed)
        edges = edges_of(button)
        button.act("bounce", str(bounce))
        button.act("tap", str(hold))
        for t_us in range(0, 2_200_001, rhythm):
            button.advance(t_us)
        button.advance(2_200_001)
        assert button.shows() == "released" and button.pin.value() == 1
        return edges

    assert run(max(step, 5000)) == run(2_200_001)


def test_a_stuck_and_a_broken_button():
    button = Button("button")
    edges = edges_of(button)
    button.advance(5)
    button.fault("stuck")
    assert button.pin.value() == 0 and edges == [(5, 0)]
    button.heal()
    assert button.pin.value() == 1 and edges == [(5, 0), (5, 1)]
    button.fault("broken")
    button.act("press")
    button.advance(100_000)
    assert button.pin.value() == 1 and len(edges) == 2


def test_clearing_faults_restores_the_bounce_time():
    def edges():
        button = Button("button", seed=7)
        edges = edges_of(button)
        button.act("bounce", "0")
        button.act("press")
        button.advance(20_000)
        assert len(edges) == 1
        button.heal()
        button.act("release")
        button.advance(40_000)
        return edges

    untouched = Button("button", seed=7)
    assert untouched._bounce_us > 0
    assert len(edges()) > 2


def test_the_visible_state_of_a_button_does_not_bounce():
    button = Button("button", seed=7)
    button.act("tap", "0.02")
    shown, levels = [button.shows()], []
    for t_us in range(0, 40_000, 50):
        button.advance(t_us)
        levels.append(button.wire())
        if shown[-1] != button.shows():
            shown.append(button.shows())
    assert shown == ["released", "pressed", "released"]
    assert sum(a != b for a, b in zip(levels, levels[1:], strict=False)) > 2, "its contacts bounce"


def test_a_knob():
    knob = Knob("knob")
    assert knob.analog() == 0.5
    knob.act("turn", "20")
    assert knob.analog() == pytest.approx(0.2) and knob.shows() == "20 %"
    knob.fault("open")
    assert len({knob.analog() for _ in range(5)}) == 5


@pytest.mark.parametrize(
    ("part", "kind", "value"),
    [
        (Knob("knob"), "turn", "101"), (Knob("knob"), "turn", "x"), (Knob("knob"), "turn", "nan"),
        (Button("button"), "bounce", "-1"), (Button("button"), "tap", "for ever"),
    ],
)  # fmt: skip
def test_an_invalid_value_is_refused(part, kind, value):
    with pytest.raises(ValueError, match="it takes a number from 0 to .*, like "):
        part.act(kind, value)
