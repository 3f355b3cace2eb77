"""Any octets for the rover's end of the tuning line, and any gains."""

from hypothesis import given
from hypothesis import strategies as st

from uros.drivers.pid_line import (
    MAX_GAIN,
    MAX_LINE,
    MAX_SPEED,
    PidLine,
    format_gains,
    parse_gains,
)

gain = st.integers(0, MAX_GAIN) | st.integers(0, 9999).map(lambda it: it / 100)
speed = st.integers(-500, 500).map(lambda it: it / 100)
commands = st.tuples(gain, gain, gain, gain, gain, gain, speed, st.sampled_from((-1, 0, 1)))
GOOD = b"\n200,30,5,200,30,5,1.0,0\n"


def pieces_of(data, draw):
    """Any way that TCP could cut them."""
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=6)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(commands)
def test_gains_come_back(values):
    assert parse_gains(format_gains(values)) == values


@given(
    st.lists(commands, min_size=1, max_size=5), st.sampled_from(("\n", "\r\n", ";", "")), st.data()
)
def test_however_it_is_cut_or_joined(sent, end, data):
    """Without line ends, too: only the last one needs a pause then."""
    line, found = PidLine(), []
    text = "".join(format_gains(values) + end for values in sent).encode()
    for piece in pieces_of(text, data.draw):
        found += line.feed(piece)
    found += line.flush()
    assert found == sent and not line.faults


@given(
    st.binary(max_size=400) | st.text("0123456789,.-+\n", max_size=400).map(str.encode), st.data()
)
def test_any_octets(octets, data):
    line, found = PidLine(), []
    for piece in pieces_of(octets, data.draw):
        found += line.feed(piece)
        assert len(line._text) <= MAX_LINE
    for values in found:
        assert all(0 <= it <= MAX_GAIN for it in values[:6])
        assert abs(values[6]) <= MAX_SPEED and values[7] in (-1, 0, 1)
    assert line.feed(GOOD)[-1] == (200, 30, 5, 200, 30, 5, 1, 0)
