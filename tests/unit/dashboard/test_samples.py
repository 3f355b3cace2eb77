"""What a rover sends, however it was cut, joined or spoilt."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.dashboard.samples import MAX_FIELDS, MAX_LINE, MAX_VALUE, Samples

values = st.integers(-MAX_VALUE, MAX_VALUE)
PAUSE = None


def read(*pieces):
    """The samples of pieces that come one after the other, and the object that read them."""
    samples, found = Samples(), []
    for piece in pieces:
        found += samples.flush() if piece is PAUSE else samples.feed(piece)
    return found, samples


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b";", b"\n\n"])
def test_with_line_ends(end):
    found, samples = read(b"12,-3" + end + b" 15 , -4" + end, b"7,8,9,10" + end)
    assert found == [(12, -3), (15, -4), (7, 8, 9, 10)] and not samples.faults


def test_as_the_document_sends_them():
    """No line ends; each piece is one message, or a pause is behind it."""
    found, samples = read(b"12,-3", PAUSE, b"15,-4", PAUSE, b"16,5", b"17,6", PAUSE)
    assert found == [(12, -3), (15, -4), (16, 5), (17, 6)] and not samples.faults


def test_a_rover_without_line_ends_that_never_pauses():
    found, samples = read(*[b"%d,-3" % it for it in range(20)])
    assert found == [(it, -3) for it in range(19)] and not samples.faults


def test_cut_within_a_number_without_line_end():
    """That there are fewer values than in others tells it."""
    found, samples = read(b"1,2,3,4", PAUSE, b"5,6", b"7,8,9", PAUSE)
    assert found == [(1, 2, 3, 4), (5, 67, 8, 9)] and not samples.faults


def test_cut_within_a_message_without_line_end():
    found, samples = read(
        b"12,-3", PAUSE, b"15,", b"-4", PAUSE, b"1", b",2", PAUSE, b"3", b",4", b"5,6"
    )
    assert found == [(12, -3), (15, -4), (1, 2), (3, 4)] and not samples.faults
    assert samples.flush() == [(5, 6)]


def test_joined_without_line_end_a_sign_tells_them_apart():
    found, samples = read(b"12,-3", PAUSE, b"15,-4-16,5", PAUSE)
    assert found == [(12, -3), (15, -4), (-16, 5)] and not samples.faults


def test_joined_without_anything_between_they_are_left_out():
    found, samples = read(b"12,-3", PAUSE, b"12,-315,-4", PAUSE, b"7,8", PAUSE)
    assert found == [(12, -3), (7, 8)]
    assert samples.faults == 1 and "end each with a line end" in samples.said[0]


def test_a_rover_may_begin_to_tell_more():
    found, _ = read(b"1,2", PAUSE, b"1,2,3,4", PAUSE, b"5,6,7,8", PAUSE)
    assert found == [(1, 2), (5, 6, 7, 8)]  # the first could have been two
    found, samples = read(b"1,2\n1,2,3,4\n")
    assert len(found) == 2 and not samples.faults


def test_one_value_is_a_sample():
    assert read(b"12", PAUSE, b"-13", PAUSE)[0] == [(12,), (-13,)]


@pytest.mark.parametrize(
    ("line", "said"),
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
def test_what_is_left_out_is_told_and_the_rest_goes_on(line, said):
    found, samples = read(b"1,2\n" + line + b"\n3,4\n")
    assert found == [(1, 2), (3, 4)]
    assert samples.faults == 1 and said in samples.said[0]


def test_a_remark_of_the_rover():
    found, samples = read(b"# battery low <b>\n1,2\n")
    assert found == [(1, 2)] and not samples.faults
    assert samples.said == ["the rover says: battery low <b>"]


def test_no_more_words_are_kept_than_anybody_reads():
    assert len(read(b"x\n" * 1000)[1].said) == 8
    assert len(max(read(b"#" + b"y" * 200 + b"\n")[1].said)) < 150


def test_a_line_without_end_takes_no_memory():
    samples = Samples()
    for _ in range(100):
        samples.feed(b"1" * 50)
        assert sum(map(len, samples._pieces)) <= MAX_LINE
    assert samples.faults >= 1
    assert samples.feed(b"\n1,2\n") == [(1, 2)]


def pieces_of(octets, draw):
    cuts = sorted(draw(st.lists(st.integers(0, len(octets)), max_size=6)))
    return [octets[a:b] for a, b in zip([0, *cuts], [*cuts, len(octets)], strict=True)]


@given(
    st.lists(st.lists(values, min_size=1, max_size=MAX_FIELDS).map(tuple), max_size=8),
    st.sampled_from(("\n", "\r\n", ";")),
    st.data(),
)
def test_with_line_ends_it_does_not_matter_how_they_are_cut(sent, end, data):
    octets = "".join(",".join(map(str, it)) + end for it in sent).encode()
    pieces = pieces_of(octets, data.draw) if len(octets) <= MAX_LINE else [octets]
    found, samples = read(*pieces)
    assert found == sent and not samples.faults


@given(st.integers(1, 6), st.data())
def test_without_line_ends_each_piece_is_one(fields, data):
    sent = data.draw(st.lists(st.tuples(*[values] * fields), min_size=1, max_size=20))
    pieces = []
    for sample in sent:
        pieces.append(",".join(map(str, sample)).encode())
        pieces += data.draw(st.sampled_from(([], [PAUSE])))
    found, samples = read(*pieces, PAUSE)
    assert found == sent and not samples.faults


@given(
    st.lists(
        st.none()
        | st.binary(max_size=300)
        | st.text("0123456789,-\n#", max_size=300).map(str.encode)
    )
)
def test_any_octets(pieces):
    found, samples = read(*pieces)
    assert all(1 <= len(it) <= MAX_FIELDS and max(map(abs, it)) <= MAX_VALUE for it in found)
    assert sum(map(len, samples._pieces)) <= MAX_LINE and len(samples.said) <= 8
    assert all(text.isprintable() for text in samples.said)
    assert samples.feed(b"\n5,-6\n")[-1] == (5, -6)
