"""What a virtual board's console shows of errors that repeat."""

import pytest

from uros.boards.virtual.engine.console import Console

HEAD = "Traceback (most recent call last):\n"
FRAME = '  File "main.py", line 11, in tick\n'
NAME = f"{HEAD}{FRAME}NameError: name 'speed' isn't defined\n"
VALUE = f"{HEAD}{FRAME}ValueError: 7\n"


@pytest.fixture
def console():
    """A console; its ``lines`` were shown since they were last asked for."""
    shown = []
    console = Console(shown.append)

    def lines():
        text = "".join(f"{line}\n" for line in shown)
        shown.clear()
        return text

    console.lines = lines
    return console


def test_a_repeated_traceback_becomes_a_count(console):
    console.print(f"tick\n{NAME}")
    assert console.lines() == f"tick\n{NAME}"
    console.print(f"tick\n{VALUE}")
    assert console.lines() == f"tick\n{VALUE}"
    error = "NameError: name 'speed' isn't defined (the same error, {} times)\n"
    counts = {2: error.format(2), 4: error.format(4), 8: error.format(8)}
    for count in range(2, 10):
        console.print(f"tick\n{NAME}")
        assert console.lines() == "tick\n" + counts.get(count, "")
    console.print(VALUE)
    assert console.lines() == "ValueError: 7 (the same error, 2 times)\n"


def test_the_same_error_at_another_line_is_another_one(console):
    other = NAME.replace("11", "12")
    console.print(NAME + other)
    assert console.lines() == NAME + other


def test_after_a_reset_errors_are_shown_again(console):
    console.print(NAME)
    console.forget()
    console.print(NAME)
    assert console.lines() == NAME + NAME


def test_a_traceback_that_has_no_end_is_shown(console):
    console.print(HEAD + FRAME)
    assert console.lines() == ""
    console.print(NAME)
    assert console.lines() == HEAD + FRAME + NAME
    console.print(HEAD + FRAME * 200)
    assert console.lines() == HEAD + FRAME * 200
    console.print(HEAD)
    assert console.lines() == ""
    console.flush()
    assert console.lines() == HEAD


def test_errors_that_differ_each_time_take_no_memory_for_ever(console):
    for number in range(300):
        console.print(VALUE.replace("7", str(number)))
    assert len(console._tracebacks._counts) == 100
    console.lines()
    console.print(VALUE.replace("7", "299"))
    assert console.lines() == "ValueError: 299 (the same error, 2 times)\n"
