"""The debounced button with any sequence of edges, and with the virtual button."""

from hypothesis import given
from hypothesis import strategies as st
from unit.drivers.portable_button_led import SETTLE, FakePin

from uros.boards.virtual.hardware.pins import FALLING, RISING
from uros.boards.virtual.hardware.pins import Button as VirtualButton
from uros.drivers.button import Button

# Milliseconds between edges, most of them as of bouncing contacts.
GAPS = st.one_of(st.integers(0, SETTLE - 1), st.integers(SETTLE, 300), st.just(SETTLE))


def clicks(segments):
    """Return the number of clicks by another definition, from segments of (level, ms).

    Only levels that lasted for SETTLE count; the first level is 1.
    """
    lasted = [1] + [level for level, ms in segments if ms >= SETTLE]
    return sum(lasted[i] == 0 and lasted[i + 1] == 1 for i in range(len(lasted) - 1))


@given(st.lists(GAPS, max_size=60), st.lists(st.booleans(), min_size=60, max_size=60))
def test_any_edges_with_polling_at_any_time(gaps, asked):
    pin = FakePin()
    button = Button(pin, pin.ms)
    counted = 0
    segments = []
    level = 1
    for gap, ask in zip(gaps, asked, strict=False):
        level = 1 - level
        pin.edge(0, level)
        segments.append((level, gap))
        pin.now += gap // 2
        counted += ask and button.clicked()
        pin.now += gap - gap // 2
    if level == 0:
        pin.edge(0, 1)
        segments.append((1, 0))
    pin.now += SETTLE
    segments[-1:] = [(1, segments[-1][1] + SETTLE) for _ in segments[-1:]]
    while button.clicked():
        counted += 1
    assert counted == clicks(segments)


@given(
    st.integers(0, 2**32),
    st.integers(0, SETTLE - 2),
    st.lists(st.tuples(st.integers(70, 600), st.integers(70, 600)), max_size=8),
    st.integers(1, 200),
)
def test_a_tap_of_the_virtual_button_is_one_click_despite_bounces(seed, bounce_ms, taps, every):
    virtual = VirtualButton("button", seed)
    virtual.act("bounce", str(bounce_ms))
    at = [0]

    class Pin:
        def value(self):
            return virtual.pin.value()

        def irq(self, handler):
            def edge(t_us, pin, level):
                at[0] = t_us // 1000
                handler(self)

            virtual.pin.edges = RISING | FALLING
            virtual.pin.on_edge = edge

    button = Button(Pin(), lambda: at[0])
    counted, now = 0, 0

    def wait(ms):
        nonlocal counted, now
        for _ in range(ms):
            now += 1
            virtual.advance(now * 1000)
            at[0] = now
            if now % every == 0:
                counted += button.clicked()

    for hold, pause in taps:
        virtual.act("press")
        wait(hold)
        virtual.act("release")
        wait(pause)
    wait(2 * SETTLE)
    while button.clicked():
        counted += 1
    assert counted == len(taps)
