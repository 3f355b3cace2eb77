"""Parameters that survive a restart. Also runs on MicroPython."""

import os

from support.portable import SINGLE_FLOATS
from support.services import Bench

from uros.client.parameter_file import ParameterFile
from uros.client.parameters import (
    IntegerRange,
    Parameter,
    ParameterDescriptor,
    ParameterServer,
)

try:
    from tempfile import mkdtemp
except ImportError:  # MicroPython

    def mkdtemp():
        """Make a folder of a new name in the working folder, which the board may write to."""
        number = 0
        while True:
            folder = "parameters%d" % number
            try:
                os.mkdir(folder)
                return folder
            except OSError:
                os.stat(folder)  # raises unless it exists; the number of EEXIST differs by port
            number += 1


PERIOD = 5.0
ODD = 1e-30 if SINGLE_FLOATS else 1e-300
VALUES = {
    "bool": True, "int": -(2**63), "float": 1.0, "odd": ODD, "text": 'grün "\n',
    "octets": b"\0\xff", "bools": [True, False], "ints": [4],
    "floats": [0.5, float("inf")], "texts": ["a", ""],
    "nothing": float("-inf"),
}  # fmt: skip


def path():
    return mkdtemp() + "/params.json"


def read(name):
    with open(name) as file:
        return file.read()


def write(name, text):
    with open(name, "w") as file:
        file.write(text)


def exists(name):
    try:
        os.stat(name)
        return True
    except OSError:
        return False


class Board:
    """A node after power-on, with its parameters and their file."""

    def __init__(self, name, values=VALUES, rules=None):
        self.bench = Bench(connect=False)
        self.node = self.bench.node
        self.lines = []
        self.file = ParameterFile(name, PERIOD)
        self.file.say = self.lines.append
        ParameterServer(self.node, persist=self.file)
        for parameter in sorted(values):
            self.node.declare_parameter(parameter, values[parameter], (rules or {}).get(parameter))

    def set(self, **values):
        for name in values:
            (result,) = self.node.set_parameters([Parameter(name, value=values[name])])
            assert result.successful, result

    def get(self, name):
        return self.node.get_parameter(name).value


def test_values_survive_a_restart() -> None:
    name = path()
    first = Board(name)
    assert not exists(name)  # nothing was set
    new = {
        "bool": False, "int": 2**63 - 1, "float": -2.5, "odd": 3.0, "text": "☃", "octets": b"",
        "bools": [False], "floats": [1.0, float("-inf")], "texts": ["z"],
        "nothing": 0.5,
    }  # fmt: skip
    first.set(**new)
    assert first.file.save() and first.file.writes == 1
    again = Board(name)
    for parameter in VALUES:
        assert again.get(parameter) == new.get(parameter, VALUES[parameter]), parameter
    assert again.lines == [] and again.file.writes == 0


def test_the_types_of_empty_lists_are_kept() -> None:
    name = path()
    first = Board(name, {"a": [1], "b": [0.5], "c": ["x"]})
    kinds = (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY, Parameter.Type.STRING_ARRAY)
    parameters = [Parameter("abc"[i], kinds[i], []) for i in range(3)]
    assert first.node.set_parameters_atomically(parameters).successful
    first.file.save()
    again = Board(name, {"a": [1], "b": [0.5], "c": ["x"]})
    assert [again.get(parameter) for parameter in "abc"] == [[], [], []] and again.lines == []


def test_the_file_is_written_at_most_once_a_period_and_only_after_changes() -> None:
    name = path()
    board = Board(name)
    board.bench.connect()
    board.bench.run(20000)
    assert board.file.writes == 0 and not exists(name)
    for number in range(100):
        board.set(int=number)
        board.bench.run(10)
    assert board.file.writes == 0
    board.bench.run(4000)
    assert board.file.writes == 1 and '"int": [2, 99]' in read(name)
    board.bench.run(20000)
    assert board.file.writes == 1
    board.set(int=5)
    board.set(int=99)  # as in the file
    board.bench.run(20000)
    assert board.file.writes == 1
    board.set(int=7)
    assert board.file.save() and board.file.writes == 2  # before a planned power-off
    board.bench.run(20000)
    assert board.file.writes == 2


def test_a_damaged_file_is_ignored_and_reported() -> None:
    name = path()
    board = Board(name)
    board.set(int=5, text="x" * 50)
    board.file.save()
    good = read(name)
    assert Board(name).get("int") == 5
    damaged = [good[:size] for size in range(1, len(good) - 10, 7)]
    damaged += [good.replace("5", "6", 1), good.replace("xx", "xy", 1), "", "[]", "null", "7", "{"]
    for text in damaged:
        write(name, text)
        again = Board(name)
        assert again.get("int") == VALUES["int"] and again.get("text") == VALUES["text"], text
        assert len(again.lines) == 1 and "is damaged" in again.lines[0], (text, again.lines)
        assert "the declared values count" in again.lines[0]
    again.set(int=8)
    again.file.save()
    assert Board(name).get("int") == 8


def test_a_value_that_does_not_fit_any_more_is_dropped_and_reported() -> None:
    name = path()
    board = Board(name, {"a": 1, "b": 2, "c": 3})
    board.set(a=50, b=60, c=70)
    board.file.save()
    rules = {"a": ParameterDescriptor(integer_range=[IntegerRange(0, 9)])}
    again = Board(name, {"a": 1, "b": 2.5, "c": 3}, rules)
    assert [again.get(parameter) for parameter in "abc"] == [1, 2.5, 70]
    assert len(again.lines) == 2
    assert "a of" in again.lines[0] and "out of range" in again.lines[0]
    assert "b of" in again.lines[1] and "wrong type" in again.lines[1]


def test_a_file_edited_by_hand() -> None:
    name = path()
    text = '{"float": [3, 7], "floats": [8, [1, 2.5]],\n"int": [2, "x"],\n"text": 5, "z": [9, []]}'
    write(name, text)
    board = Board(name)
    assert board.get("float") == 7.0 and board.get("floats") == [1.0, 2.5]
    assert board.get("int") == VALUES["int"] and board.get("text") == VALUES["text"]
    assert len(board.lines) == 2
    board.set(bool=False)
    board.file.save()
    assert '"z": [9, []]' in read(name)  # a parameter that another program declares


def test_undeclared_parameters_are_removed_from_the_file() -> None:
    name = path()
    board = Board(name, {"a": 1, "b": 2})
    board.set(a=5, b=6)
    board.file.save()
    board.node.undeclare_parameter("a")
    assert board.file.save() and '"a"' not in read(name) and '"b"' in read(name)


def test_the_new_file_replaces_the_old_one_when_complete() -> None:
    name = path()
    board = Board(name)
    board.set(int=5)
    board.file.save()
    old = read(name)
    board.set(int=6)
    board.file.save()
    assert not exists(name + ".new")
    # Power failed before the new file was complete.
    new = read(name)
    write(name, old)
    write(name + ".new", new[:20])
    assert Board(name).get("int") == 5
    # A file system that cannot replace a file: power failed between removal and renaming.
    os.remove(name)
    write(name + ".new", new)
    again = Board(name)
    assert again.get("int") == 6 and again.lines == []
    again.set(int=7)
    assert again.file.save() and Board(name).get("int") == 7


def test_a_failed_write_is_reported_once_and_retried() -> None:
    folder = mkdtemp()
    board = Board(folder + "/none/params.json")
    board.bench.connect()
    board.set(int=5)
    assert not board.file.save()
    board.bench.run(16000)
    assert board.file.failures == 4 and len(board.lines) == 1
    assert "cannot be written" in board.lines[0]
    os.mkdir(folder + "/none")
    board.bench.run(5000)
    assert board.file.writes == 1 and Board(folder + "/none/params.json").get("int") == 5
