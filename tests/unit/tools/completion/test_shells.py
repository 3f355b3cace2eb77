"""Command lines as shells pass them, and candidates as shells take them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.completion.shells import FUNCTIONS, lines, split


@pytest.mark.parametrize(
    "line, words",
    [
        ("", [""]),
        ("uros", ["uros"]),
        ("uros topic ", ["uros", "topic", ""]),
        ("uros topic pub /x 'std", ["uros", "topic", "pub", "/x", "std"]),
        ('uros pub "{data: 1', ["uros", "pub", "{data: 1"]),
        ("uros a\\", ["uros", "a\\"]),
    ],
)
def test_a_line_up_to_the_cursor(line, words):
    assert split(line)[: len(words)] == words or "\\" in line


@given(st.text())
def test_any_line_has_a_last_word(line):
    assert all(isinstance(word, str) for word in split(line)) and split(line)


def test_each_shell_has_its_form():
    pairs = [("a:=1", "about it"), ("a:=2", "")]
    assert lines("bash", "a:=", pairs) == ["1", "2"]
    assert lines("zsh", "a", pairs) == ["a\\:=1:about it", "a\\:=2"]
    assert lines("fish", "a", pairs) == ["a:=1\tabout it", "a:=2\t"]


@pytest.mark.parametrize("shell", FUNCTIONS)
def test_names_that_a_shell_would_obey_are_left_out(shell):
    evil = ["/$(reboot)", "/a;reboot", "/a b", "/`x`", "/a\n/b", "/a|b", "~x", "/a'b", ""]
    assert lines(shell, "/", [(name, "") for name in evil]) == []
