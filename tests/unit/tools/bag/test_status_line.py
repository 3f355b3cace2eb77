import io

import pytest

from uros.tools.bag.status_line import PERIOD, StatusLine


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.mark.parametrize(
    "options, drawn",
    [({}, [0, 3]), ({"period": 2.0}, [0]), ({"period": 0.0}, [0, 1, 2, 3]), ({"period": None}, [])],
)
def test_the_state_is_drawn_once_in_a_period(monkeypatch, options, drawn):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    now = [5.0]
    line = StatusLine(clock=lambda: now[0], **options)
    for number, at in enumerate((5.0, 5.01, 5.02, 5.0 + PERIOD)):
        now[0] = at
        line.show(lambda: f"state {number}")  # noqa: B023
    assert terminal.getvalue() == "".join(f"\rstate {number}\033[K" for number in drawn)


def test_a_line_replaces_the_state(monkeypatch, capsys):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    line = StatusLine()
    line.show(lambda: "a\x1bb")
    line.warn("x\x1b")
    line.say("y")
    assert terminal.getvalue() == "\ra\\x1bb\033[K\r\033[KWARNING: x\\x1b\n"
    assert capsys.readouterr().out == "y\n"


def test_without_a_terminal_there_are_lines_alone(monkeypatch, capsys):
    line = StatusLine(0.0)
    line.show(lambda: "state")
    line.warn("x")
    assert capsys.readouterr().err == "WARNING: x\n"
