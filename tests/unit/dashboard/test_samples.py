"""Parsing of a rover's samples, split, joined or damaged."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.dashboard.samples import MAX_FIELDS, MAX_LINE, MAX_VALUE, Samples

values = st.integers(-MAX_VALUE, MAX_VALUE)
PAUSE = None


def read(*pieces):
    """Parse pieces in turn; return the samples and the parser."""
    parser, samples = Samples(), []
    for piece in pieces:
        samples += parser.flush() if piece is PAUSE else parser.feed(piece)
    return samples, parser


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b";", b"\n\n"])
def test_with_line_ends(end):
    samples, parser = read(b"12,-3" + end + b" 15 , -4" + end, b"7,8,9,10" + end)
    assert samples == [(12, -3), (15, -4), (7, 8, 9, 10)] and not parser.faults


def test_as_the_document_sends_them():
    """Without line ends each piece is one message, or a pause ends the message."""
    samples, parser = read(b"12,-3", PAUSE, b"15,-4", PAUSE, b"16,5", b"17,6", PAUSE)
    assert samples == [(12, -3), (15, -4), (16, 5), (17, 6)] and not parser.faults


def test_a_rover_without_line_ends_that_never_pauses():
    samples, parser = read(*[b"%d,-3" % value for value in range(20)])
    assert samples == [(value, -3) for value in range(19)] and not parser.faults


def test_split_within_a_number_without_line_end():
    """A piece with fewer values than the samples before is continued by the next."""
    samples, parser = read(b"1,2,3,4", PAUSE, b"5,6", b"7,8,9", PAUSE)
    assert samples == [(1, 2, 3, 4), (5, 67, 8, 9)] and not parser.faults


def test_split_within_a_message_without_line_end():
    samples, parser = read(
        b"12,-3", PAUSE, b"15,", b"-4", PAUSE, b"1", b",2", PAUSE, b"3", b",4", b"5,6"
    )
    assert samples == [(12, -3), (15, -4), (1, 2), (3, 4)] and not parser.faults
    assert parser.flush() == [(5, 6)]


def test_joined_without_line_end_a_sign_separates_messages():
    samples, parser = read(b"12,-3", PAUSE, b"15,-4-16,5", PAUSE)
    assert samples == [(12, -3), (15, -4), (-16, 5)] and not parser.faults


def test_joined_without_a_sign_messages_are_dropped():
    samples, parser = read(b"12,-3", PAUSE, b"12,-315,-4", PAUSE, b"7,8", PAUSE)
    assert samples == [(12, -3), (7, 8)]
    assert parser.faults == 1 and "end each with a line end" in parser.notes[0]


def test_a_rover_may_send_more_values_later():
    samples, _ = read(b"1,2", PAUSE, b"1,2,3,4", PAUSE, b"5,6,7,8", PAUSE)
    assert samples == [(1, 2), (5, 6, 7, 8)]  # the first piece could be two messages
    samples, parser = read(b"1,2\n1,2,3,4\n")
    assert len(samples) == 2 and not parser.faults


def test_one_value_is_a_sample():
    assert read(b"12", PAUSE, b"-13", PAUSE)[0] == [(12,), (-13,)]


@pytest.mark.parametrize(
    ("line", "note"),
    [
        (b"12,x", "x is no whole number"),
        (b"12,", "nothing is no whole number"),
        (b"1.5,2", "1.5 is no whole number"),
        (b"1,1000001", "beyond 1000000"),
        (b"1,2,3,4,5,6,7,8,9", "9 values in a line: 8 at most"),
        (b"\xff\x00", "? is no whole number"),
        (b"1-2,3", "1-2 is no whole number"),
        ("\u0661".encode() * 3, "is no whole number"),
    ],
)
def test_an_invalid_line_is_noted_and_the_next_is_read(line, note):
    samples, parser = read(b"1,2\n" + line + b"\n3,4\n")
    assert samples == [(1, 2), (3, 4)]
    assert parser.faults == 1 and note in parser.notes[0]


def test_a_remark_of_the_rover():
    samples, parser = read(b"# battery low <b>\n1,2\n")
    assert samples == [(1, 2)] and not parser.faults
    assert parser.notes == ["the rover says: battery low <b>"]


def test_at_most_eight_short_notes_are_stored():
    assert len(read(b"x\n" * 1000)[1].notes) == 8
    assert len(max(read(b"#" + b"y" * 200 + b"\n")[1].notes)) < 150


def test_the_memory_of_a_line_without_end_is_limited():
    parser = Samples()
    for _ in range(100):
        parser.feed(b"1" * 50)
        assert sum(map(len, parser._pieces)) <= MAX_LINE
    assert parser.faults >= 1
    assert parser.feed(b"\n1,2\n") == [(1, 2)]


def pieces_of(octets, draw):
    cuts = sorted(draw(st.lists(st.integers(0, len(octets)), max_size=6)))
    return [octets[a:b] for a, b in zip([0, *cuts], [*cuts, len(octets)], strict=True)]


@given(
    st.lists(st.lists(values, min_size=1, max_size=MAX_FIELDS).map(tuple), max_size=8),
    st.sampled_from(("\n", "\r\n", ";")),
    st.data(),
)
def test_with_line_ends_messages_may_be_split_anywhere(sent, end, data):
    octets = "".join(",".join(map(str, sample)) + end for sample in sent).encode()
    pieces = pieces_of(octets, data.draw) if len(octets) <= MAX_LINE else [octets]
    samples, parser = read(*pieces)
    assert samples == sent and not parser.faults


@given(st.integers(1, 6), st.data())
def test_without_line_ends_each_piece_is_one_message(fields, data):
    sent = data.draw(st.lists(st.tuples(*[values] * fields), min_size=1, max_size=20))
    pieces = []
    for sample in sent:
        pieces.append(",".join(map(str, sample)).encode())
        pieces += data.draw(st.sampled_from(([], [PAUSE])))
    samples, parser = read(*pieces, PAUSE)
    assert samples == sent and not parser.faults


@given(
    st.lists(
        st.none()
        | st.binary(max_size=300)
        | st.text("0123456789,-\n#", max_size=300).map(str.encode)
    )
)
def test_any_octets(pieces):
    samples, parser = read(*pieces)
    assert all(
        1 <= len(sample) <= MAX_FIELDS and max(map(abs, sample)) <= MAX_VALUE for sample in samples
    )
    assert sum(map(len, parser._pieces)) <= MAX_LINE and len(parser.notes) <= 8
    assert all(text.isprintable() for text in parser.notes)
    assert parser.feed(b"\n5,-6\n")[-1] == (5, -6)
