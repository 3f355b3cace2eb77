"""Tests that parse reads what MicroPython's repr writes, and refuses all other texts."""

import ast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.deploy.literal import MAX_DEPTH, MAX_ITEMS, parse

values = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.lists(inner, max_size=4).map(tuple),
    max_leaves=8,
)


def depth(value):
    return 1 + max(map(depth, value), default=0) if isinstance(value, (list, tuple)) else 0


@given(values.filter(lambda value: depth(value) <= MAX_DEPTH))
def test_parse_returns_the_value_that_repr_wrote(value):
    assert parse(repr(value)) == value
    assert type(parse(repr(value))) is type(value)


@given(st.text(st.sampled_from("[](),' \\x0n1N-oneTrue\"\t"), max_size=30) | st.text())
def test_any_accepted_text_is_the_same_python_literal(text):
    try:
        value = parse(text)
    except ValueError:
        return
    assert value == ast.literal_eval(text.strip())


@pytest.mark.parametrize(
    "text",
    [
        "", " ", "[", "]", "(]", "[1 2]", "[,]", "[1,,2]", "1,2", "1 2", "{}", "b''", "'a", "'\\q'",
        "'\\x1'", "'\\", "'\\U00110000'", "'\\UFFFFFFFF'", "01", "-01", "1.5", "1e9", "1+1",
        "f()", "-", "None None",
        "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "[" * 10**6,
        "[" + "0," * (MAX_ITEMS + 1) + "]", "9" * 10**6, "1+" * 10**6 + "1", "()" * 10**6,
    ],
    ids=lambda text: text[:20],
)  # fmt: skip
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError):
        parse(text)
