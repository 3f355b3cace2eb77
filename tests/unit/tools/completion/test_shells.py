"""Command lines as shells pass them, and candidates as shells take them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.completion.shells import FUNCTIONS, NO_FILES, lines, open_quote, split


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
    assert lines("bash", "a:=", "", pairs) == ["1", "2"]
    assert lines("zsh", "a", "", pairs) == ["a\\:=1:about it", "a\\:=2"]
    assert lines("fish", "a", "", pairs) == ["a:=1\tabout it", "a:=2\t"]


@pytest.mark.parametrize("shell", FUNCTIONS)
def test_names_that_a_shell_would_obey_are_left_out(shell):
    evil = ["/$(reboot)", "/a;reboot", "/a b", "/`x`", "/a\n/b", "/a|b", "~x", "/a'b", ""]
    assert lines(shell, "/", "", [(name, "") for name in evil]) == []


TWIST = "{linear: {x: 0.0}}"


@pytest.mark.parametrize(
    "shell, line, found",
    [
        ("bash", "uros topic pub /x T ", [f'"{TWIST}"']),
        ("bash", "uros topic pub /x T {lin", [f'"{TWIST}"']),
        ("bash", 'uros topic pub /x T "{linear: {', [TWIST]),
        ("zsh", "uros topic pub /x T ", [r'"{linear\: {x\: 0.0}}"']),
        ("zsh", "uros topic pub /x T '{lin", [r"{linear\: {x\: 0.0}}"]),
        ("zsh", "uros topic pub /x T {lin", [" "]),
        ("fish", "uros topic pub /x T ", [f"{TWIST}\t"]),  # fish puts the quotes itself
    ],
)
def test_values_stand_in_quotes(shell, line, found):
    pairs = [(TWIST, ""), NO_FILES]
    assert lines(shell, split(line)[-1], open_quote(line), pairs) == found


def test_values_within_single_quotes():
    assert lines("bash", "", "'", [("{data: ''}", "")]) == ['{data: ""}']


@pytest.mark.parametrize("shell", FUNCTIONS)
def test_where_no_file_may_stand(shell):
    assert lines(shell, "a", "", [NO_FILES]) == [" "]
    for evil in ('{data: "$(reboot)"}', "{data: `x`}", "{data: !x}", "{data: 1};reboot", "{\n}"):
        assert lines(shell, "", "", [(evil, "")]) == []
