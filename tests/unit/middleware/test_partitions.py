"""Partitions: which names and patterns meet, and what comparing them may cost."""

import tracemalloc
from fnmatch import fnmatchcase

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from uros.middleware import partitions

MANY = [f"*{number}" + "*a" * 253 for number in range(64)]


@pytest.mark.parametrize(
    "offered, requested, meets",
    [
        ([], [], True),
        ([], [""], True),
        (["a"], [], False),
        (["a", "b"], ["c", "b"], True),
        (["*"], [], True),
        (["robot1"], ["robot*"], True),
        (["robot?"], ["x", "robot1"], True),
        (["robot*"], ["robot*"], False),  # a pattern matches no pattern
        (["robot[1-3]"], ["robot2"], True),
        (["robot[!1-3]"], ["robot2"], False),
    ],
)
def test_names_and_patterns(offered, requested, meets):
    assert partitions.meet(offered, requested) is meets
    assert partitions.meet(requested, offered) is meets


@given(st.text("ab-]!\n\U0001f916", max_size=8), st.text("ab*?[]!-\U0001f916", max_size=12))
@example("a", "[b-a]")
@example("a", "[!b-a]")
@example("]", "[]]")
@example("b", "[!]a]")
@example("-", "[a-]")
@example("b", "[a-b-]")
@example("x", "[x*")
@example("aab", "*a*b")
def test_patterns_are_those_of_fnmatch(name, pattern):
    if any(sign in pattern for sign in "*?["):
        assert partitions.meet([name], [pattern]) is fnmatchcase(name, pattern)


def test_patterns_leave_nothing_behind():
    """Attack: patterns without end. ``fnmatch`` keeps 32,768 of them, of 14 kB each."""
    partitions.meet(["a" * 511], ["*b"])
    tracemalloc.start()
    try:
        assert not partitions.meet(["a" * 511], MANY)
        assert tracemalloc.get_traced_memory()[0] < 20_000
    finally:
        tracemalloc.stop()


def test_the_work_for_two_lists_is_limited():
    """Attack: 64 patterns of 511 octets, compared with as many names."""
    names = [f"a{number}" for number in range(64)]
    longest = "*" * 508 + "a63"
    assert partitions.meet(names, [*MANY, "*63"])
    assert partitions.meet(names, [longest]) and partitions.meet(["a63"], [*MANY[4:], longest])
    assert not partitions.meet(names, [*MANY, longest, longest + "*"])
