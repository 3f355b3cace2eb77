"""uros board build: what it writes, what it says, and what it refuses."""

import re
import subprocess
import sys

import pytest
from support.variants import slow_except

from uros.boards.builder.file_system import build
from uros.boards.builder.pipeline import PASSES
from uros.boards.virtual.engine.runner import firmware_folder
from uros.boards.virtual.models.catalog import BOARDS
from uros.interfaces import InterfaceError, load
from uros.tools import cli

PROGRAM = """
from uros.client import Node
from uros.wire.errors import DecodeError
from uros.transport.serial import StreamTransport
"""


@pytest.fixture
def program(tmp_path):
    """Makes a folder of a main.py."""

    def make(text, name="blinker"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "main.py").write_text(text)
        return folder

    return make


def files(folder):
    """Paths and contents, but the mark of who made it."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def test_help_is_cheap():
    probe = (
        "import sys\nfrom uros.tools import cli\n"
        "assert cli.main(['board', 'build', '--help']) == 0\n"
        "heavy = {'uros.boards.builder.file_system', 'uros.interfaces', 'uros.middleware'}\n"
        "heavy |= {'ctypes', 'asyncio'}\n"
        "print(heavy & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    *text, heavy = done.stdout.splitlines()
    assert text[0].startswith("usage: uros board build") and heavy == "set()"


@pytest.mark.parametrize("name", slow_except(BOARDS, "esp32_publisher"))
def test_a_program_by_the_name_of_its_board(name, tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    assert cli.main(["board", "build", name, str(out)]) == 0
    made = files(out)
    expected = tmp_path / "expected"
    build(firmware_folder(BOARDS[name]), expected)
    assert made == files(expected) and "main.py" in made
    printed = capsys.readouterr()
    first, *rest = printed.out.splitlines()
    assert first == f"{out}: {len(made)} files, {sum(map(len, made.values()))} bytes"
    assert f"  mpremote connect PORT cp -r {out}/* :" in rest
    assert "  mpremote connect PORT reset" in rest
    assert printed.err == ""


def test_a_folder_and_the_effect_of_options(program, tmp_path, monkeypatch, capsys):
    folder = program(PROGRAM)
    monkeypatch.chdir(tmp_path)
    made = {}
    for name, options in {
        "text": [], "whole": ["--no-lean"], "mpy": ["--mpy"], "apart": ["--mpy", "--no-bundle"],
    }.items():  # fmt: skip
        assert cli.main(["board", "build", "blinker", name, *options]) == 0
        made[name] = files(tmp_path / name)
    out = capsys.readouterr().out
    assert "text: 1" in out and "cp -r text/* :" in out
    assert made["text"].keys() == made["whole"].keys()
    assert sum(map(len, made["text"].values())) < sum(map(len, made["whole"].values()))
    assert all(name.endswith(".py") for name in made["text"])
    for name in ("mpy", "apart"):
        assert {path for path in made[name] if not path.endswith(".mpy")} == {"main.py"}
    assert len(made["mpy"]) < len(made["apart"])
    assert made["text"]["main.py"] == (folder / "main.py").read_bytes()


@pytest.fixture(scope="module")
def whole_build(tmp_path_factory):
    """The folder of a program, and its files by a build with all passes."""
    root = tmp_path_factory.mktemp("whole")
    folder = root / "blinker"
    folder.mkdir()
    (folder / "main.py").write_text("from app import node\n")
    (folder / "app.py").write_text(
        "from uros.client import Node\nfrom uros.transport.serial import StreamTransport\n"
        "def node(port):\n"
        "    node = Node('n', StreamTransport(port))\n"
        "    publisher = node.create_publisher(None, 'topic', 10)\n"
        "    node.create_subscription(None, 'topic', print, 10)\n"
        "    node.create_timer(1.0, lambda: publisher.publish(None))\n"
        "    node.spin()\n"
    )
    assert cli.main(["board", "build", str(folder), str(root / "out"), "--mpy"]) == 0
    return folder, files(root / "out")


@pytest.mark.slow
@pytest.mark.parametrize("name", [step.name for step in PASSES])
def test_each_pass_can_be_skipped(name, whole_build, tmp_path, capsys):
    folder, whole = whole_build
    command = ["board", "build", str(folder), str(tmp_path / "out"), "--mpy", "--without", name]
    assert cli.main(command) == 0
    without = files(tmp_path / "out")
    assert whole != without
    assert sum(map(len, whole.values())) < sum(map(len, without.values()))


def test_the_passes_are_in_the_help(capsys):
    assert cli.main(["board", "build", "--help"]) == 0
    out = capsys.readouterr().out
    for build_pass in PASSES:
        assert re.search(
            rf"^  {build_pass.name} +{re.escape(build_pass.purpose)}", out, re.MULTILINE
        )


def test_an_unknown_pass(program, tmp_path, capsys):
    options = ["--without", "bundle", "--without", "bundel"]
    assert cli.main(["board", "build", str(program("pass")), str(tmp_path / "out"), *options]) == 1
    error = capsys.readouterr().err
    assert "no pass 'bundel' to leave out; there are terse-errors, constants, tree-shake" in error
    assert not (tmp_path / "out").exists()


def test_a_name_with_spaces_is_quoted_for_the_shell(program, tmp_path, capsys):
    out = tmp_path / "my board"
    assert cli.main(["board", "build", str(program("pass")), str(out)]) == 0
    assert f"cp -r '{out}'/* :" in capsys.readouterr().out


def test_custom_interfaces(program, tmp_path, capsys):
    types = tmp_path / "valve_msgs" / "msg"
    types.mkdir(parents=True)
    (types / "Valve.msg").write_text("int8 position\n")
    folder = program("from valve_msgs.msg import Valve\nprint(Valve)\n")
    with pytest.raises(InterfaceError):
        load("valve_msgs/msg/Valve")
    out = tmp_path / "out"
    assert cli.main(["board", "build", str(folder), str(out)]) == 1
    assert "--interfaces DIR" in capsys.readouterr().err
    options = ["--interfaces", str(tmp_path / "valve_msgs")]
    assert cli.main(["board", "build", str(folder), str(out), *options]) == 0
    assert "valve_msgs/msg.py" in files(out)


def refusal(capsys, *arguments):
    """What is said on standard error, in one line."""
    assert cli.main(["board", "build", *map(str, arguments)]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith("uros: ")
    return printed.err[len("uros: ") :]


def test_a_name_that_is_neither_board_nor_folder(tmp_path, capsys):
    said = refusal(capsys, "ra6m5_sensor_nod", tmp_path / "out")
    assert said.startswith("there is no board or folder 'ra6m5_sensor_nod'; did you mean 'ra6m5_s")
    said = refusal(capsys, "x", tmp_path / "out")
    assert all(name in said for name in BOARDS)
    (tmp_path / "empty").mkdir()
    assert "no main.py" in refusal(capsys, tmp_path / "empty", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("line", ["from uros import Node", "import uros"])
def test_a_program_that_cannot_be_built(program, tmp_path, capsys, line):
    folder = program(f"import time\n{line}\n")
    said = refusal(capsys, folder, tmp_path / "out")
    assert said.startswith(f"{folder / 'main.py'}:2: ")
    assert said.endswith("from uros.client import Node\n")
    assert not (tmp_path / "out").exists()


def test_folders_that_cannot_be_written(program, tmp_path, capsys):
    folder = program("pass")
    assert "holds something else" in refusal(capsys, folder, tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    assert str(file) in refusal(capsys, folder, file / "out")


def test_bad_command_lines(capsys):
    assert cli.main(["board", "build", "ra6m5_sensor_node"]) == 2
    assert capsys.readouterr().err.startswith("uros board build: error: ")


def test_a_misspelt_field_is_rejected_with_its_place_and_similar_names(program, tmp_path, capsys):
    folder = program("from std_msgs.msg import Int32\nm = Int32()\nm.dta = 1\n")
    assert cli.main(["board", "build", str(folder), str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.strip() == (
        f"uros: {folder}/main.py:3: std_msgs/msg/Int32 has no field dta; did you mean data?"
    )
    assert not (tmp_path / "out").exists()
