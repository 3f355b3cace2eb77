import os
import pty
import termios
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.bag import keyboard
from uros.tools.bag.keyboard import DOWN, RIGHT, SPACE, UP, Keyboard, open_keyboard, parse


@pytest.mark.parametrize(
    "typed, keys",
    [
        (b" ", [SPACE]),
        (b"s ", ["s", SPACE]),
        (b"\x1b[A\x1b[B\x1b[C\x1b[D", [UP, DOWN, RIGHT]),
        (b"\x1bOA\x1bOC", [UP, RIGHT]),
        (b"\x1b[1;5C", [RIGHT]),
        (b"\x1b[3~ ", [SPACE]),
        (b"\x1b", []),
        ("ü".encode(), []),
    ],
)
def test_keys(typed, keys):
    assert parse(typed) == keys


@given(st.binary(max_size=64))
def test_any_octets_are_keys_or_nothing(typed):
    assert all(key.isascii() for key in parse(typed))


@contextmanager
def terminal(monkeypatch, is_ours):
    leader, follower = pty.openpty()
    try:
        monkeypatch.setattr(keyboard.sys, "stdin", os.fdopen(follower, "r", closefd=False))
        monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp() if is_ours else 1)
        yield leader, follower
    finally:
        os.close(leader)
        os.close(follower)


def test_a_key_is_read_at_once_and_the_terminal_is_restored(monkeypatch):
    with terminal(monkeypatch, is_ours=True) as (leader, follower):
        before = termios.tcgetattr(follower)
        with open_keyboard() as keys:
            assert keys.is_open
            assert not termios.tcgetattr(follower)[3] & (termios.ICANON | termios.ECHO)
            assert keys.pressed() == []
            os.write(leader, b" \x1b[A")
            assert keys.pressed() == [SPACE, UP]
        assert termios.tcgetattr(follower) == before


@pytest.mark.parametrize("enabled, is_ours", [(False, True), (True, False)])
def test_a_terminal_that_is_not_to_be_read_is_left_alone(monkeypatch, enabled, is_ours):
    with terminal(monkeypatch, is_ours) as (_, follower):
        before = termios.tcgetattr(follower)
        with open_keyboard(enabled) as keys:
            assert not keys.is_open and keys.pressed() == []
            assert termios.tcgetattr(follower) == before


def test_without_a_terminal_there_are_no_keys(monkeypatch, tmp_path):
    with open(tmp_path / "file", "w+") as file:
        monkeypatch.setattr(keyboard.sys, "stdin", file)
        with open_keyboard() as keys:
            assert not keys.is_open


def test_a_terminal_that_is_gone_has_no_more_keys():
    reader, writer = os.pipe()
    keys = Keyboard(reader)
    os.close(writer)
    assert keys.pressed() == keys.pressed() == []
    os.close(reader)
