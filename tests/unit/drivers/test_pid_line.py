"""The parser of tuning lines with any octets, and with any gains."""

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

gain = st.integers(0, MAX_GAIN) | st.integers(0, 9999).map(lambda hundredths: hundredths / 100)
speed = st.integers(-500, 500).map(lambda hundredths: hundredths / 100)
commands = st.tuples(gain, gain, gain, gain, gain, gain, speed, st.sampled_from((-1, 0, 1)))
GOOD = b"\n200,30,5,200,30,5,1.0,0\n"


def pieces_of(data, draw):
    """Return the data in pieces, cut in any way."""
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=6)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(commands)
def test_formatted_gains_are_parsed_to_the_same_values(values):
    assert parse_gains(format_gains(values)) == values


@given(
    st.lists(commands, min_size=1, max_size=5), st.sampled_from(("\n", "\r\n", ";", "")), st.data()
)
def test_lines_cut_or_joined_in_any_way(sent, end, data):
    """Also without line ends: then only the last line needs a pause."""
    line, parsed = PidLine(), []
    text = "".join(format_gains(values) + end for values in sent).encode()
    for piece in pieces_of(text, data.draw):
        parsed += line.feed(piece)
    parsed += line.flush()
    assert parsed == sent and not line.faults


@given(
    st.binary(max_size=400) | st.text("0123456789,.-+\n", max_size=400).map(str.encode), st.data()
)
def test_any_octets(octets, data):
    line, parsed = PidLine(), []
    for piece in pieces_of(octets, data.draw):
        parsed += line.feed(piece)
        assert len(line._text) <= MAX_LINE
    for values in parsed:
        assert all(0 <= value <= MAX_GAIN for value in values[:6])
        assert abs(values[6]) <= MAX_SPEED and values[7] in (-1, 0, 1)
    assert line.feed(GOOD)[-1] == (200, 30, 5, 200, 30, 5, 1, 0)
