"""The progress of a command: a line that is replaced on a terminal, some lines elsewhere."""

import sys

import pytest

from uros.tools.progress import Progress


@pytest.fixture
def times():
    return [0.0]


def test_some_lines_in_a_pipe(capsys, times):
    with Progress("packages", lambda: times[0]) as progress:
        for at in range(100):
            times[0] = at * 0.1
            progress.show(at, 100)
    assert capsys.readouterr() == ("", "0 of 100 packages\n50 of 100 packages\n")


def test_one_line_on_a_terminal(capsys, times, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with Progress("packages", lambda: times[0]) as progress:
        for at in range(4):
            times[0] = at * 0.06
            progress.show(at, 4)
    out, err = capsys.readouterr()
    assert err == "\r0 of 4 packages\033[K\r2 of 4 packages\033[K\r\033[K" and out == ""
