import string

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uros.interfaces import load
from uros.tools.errors import ToolError, UsageError
from uros.tools.values.expression import FUNCTIONS, METHODS, Expression

POSES = load("geometry_msgs/msg/PoseArray")
POSE = load("geometry_msgs/msg/Pose")


def message(*xs, frame=""):
    made = POSES(poses=[POSE() for _ in xs])
    made.header.frame_id = frame
    for pose, x in zip(made.poses, xs, strict=True):
        pose.position.x = x
    return made


@pytest.mark.parametrize(
    "text, expected",
    [
        ("m.poses[1].position.x > 1.5", True),
        ("1 < m.poses[0].position.x + 1 <= 2 and not m.header.stamp.sec", True),
        ("m.poses[-1].position.x == 2 or m.poses[9].position.x", True),
        ("len(m.poses) in (1, 3)", False),
        ("any(p.position.x > 1 for p in m.poses if p.position.y == 0)", True),
        ("sum([p.position.x for p in m.poses[:1]]) * 2 ** 3 == 8", True),
        ("m.header.frame_id.upper().startswith('MA') and 'p' in m.header.frame_id", True),
        ("-m.poses[0].position.x if m.poses else 0", True),
        ("max(p.position.x for p in m.poses) // 2 % 2 & 1 | 0 ^ 0", None),
        ("hypot(m.poses[0].position.x, 0) >= 1", True),
        ("{1, 2} == {2, 1} and [1] == [1]", True),
        ("m.header.frame_id is None", False),
        ("  m.poses", True),
    ],
)
def test_what_is_true(text, expected):
    expression = Expression(text)
    sample = message(1.0, 2.0, frame="map")
    if expected is None:
        with pytest.raises(ToolError, match="fails on a message: TypeError"):
            expression.accepts(sample)
    else:
        assert expression.accepts(sample) is expected


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "no expression"),
        ("m.data >", "--filter 'm.data >': no expression: .* at column"),
        ("m.data = 1", "no expression"),
        ("m; m", "no expression"),
        ("\0", "--filter '.x00'"),
        ("-" * 99_999 + "1", r"--filter '-{60}\.\.\.'"),
        ("msg.data", "there is no 'msg' here, only the message m"),
        ("len", "a function is called, as in len"),
        ("sqr(m.data)", "there is no function sqr; did you mean 'sqrt'"),
        ("m.data.beginswith('a')", "there is no function m.data.beginswith"),
        ("max(m.data, key=len)", "arguments with names are not allowed"),
        ("lambda: 1", "lambda: 1 is not allowed"),
        ("f'{m}'", "is not allowed"),
        ("(n := 1)", "is not allowed"),
        ("[a for a in m for b in m]", "give one 'for' with one name"),
        ("{1: 2}", "is not allowed"),
        ("__import__('os').system('true')", "there is no function"),
        ("eval('1')", "there is no function eval"),
        ("m.data.format(m)", "there is no function m.data.format"),
        ("print(*m)", "is not allowed"),
        ("(lambda: m)()", "there is no function"),
    ],
)
def test_what_cannot_be_written(text, said):
    with pytest.raises(UsageError, match=said):
        Expression(text)


@pytest.mark.parametrize(
    "text, said",
    [
        ("m.poses[7]", "IndexError"),
        ("1 / len(m.poses)", "ZeroDivisionError"),
        ("m.header > 1", "TypeError"),
        ("'x' * 1000000000", "takes numbers"),
        ("'%999999999d' % 1", "takes numbers"),
        ("(10 ** 9) ** 999999", "too large"),
        ("1 << 99999999", "too large"),
        ("sum(range(99999999))", "at most 1000000 numbers"),
        ("int('9' + 'x')", "ValueError"),
        ("m.poses.append", "a list has no field 'append'"),
        ("m.__class__", "has no field '__class__'"),
        ("m.header.__init__", "has no field"),
        ("m.poses.index(1)", "ValueError"),
        ("m.header.count(1)", "has no count"),
    ],
)
def test_what_fails_on_a_message(text, said):
    expression = Expression(text)
    with pytest.raises(ToolError, match=said) as caught:
        expression.accepts(message())
    assert "\n" not in str(caught.value)


def test_fields_are_checked_before_a_message_comes():
    with pytest.raises(ToolError, match="has no field 'pose'; it has header, poses; did you mean"):
        Expression("m.pose[0]").check(POSES)
    assert Expression("m.poses[0].position.x > 1").check(POSES)(message(2.0))


WORDS = [
    "m", "m.poses", "m.header", "m.__class__", "x", "1", "2.5", "'a'", "+", "-", "*", "**", "(",
    ")", "[", "]", ".", ",", " for x in ", " if ", " else ", " and ", "not ", "==", "<", "<<", "%",
    ":", "lambda ", "__import__", *FUNCTIONS, *METHODS,
]  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.text(max_size=60),
        st.lists(st.sampled_from(WORDS), max_size=14).map("".join),
        st.lists(st.sampled_from([*WORDS, *string.printable]), max_size=20).map("".join),
    )
)
def test_any_text_is_an_answer_or_an_error_for_the_user(text):
    try:
        Expression(text).check(POSES)(message(1.0, frame="map"))
    except ToolError as error:
        assert str(error).startswith("--filter ")
