"""Type stubs of messages: what an editor or mypy says about a program for a board."""

import ast
import os
import subprocess
import sys

from uros.interfaces import load, registry
from uros.interfaces.stubs import write_stubs
from uros.tools import cli

PROGRAM = """
from example_interfaces.action import Fibonacci
from example_interfaces.srv import AddTwoInts
from sensor_msgs.msg import BatteryState, Image, JointState
from std_msgs.msg import Header, Int32

reveal_type(Header().stamp.sec)
number = Int32(data="x")
number.dat = 3
joints = JointState(name=["a"], position=[1.0])
joints.name.append("b")
Image(data=b"123", height=3)
reveal_type(AddTwoInts.Request(a=1).b)
reveal_type(Fibonacci.Result().sequence)
reveal_type(BatteryState.POWER_SUPPLY_STATUS_FULL)
"""


def test_a_type_checker_knows_messages_and_finds_wrong_fields(tmp_path):
    assert cli.main(["board", "stubs", str(tmp_path / "typings")]) == 0
    (tmp_path / "main.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-incremental", "--no-error-summary", "main.py"],
        cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "MYPYPATH": str(tmp_path / "typings")},
    )  # fmt: skip
    assert [line.partition(":")[2] for line in done.stdout.splitlines()] == [
        '7: note: Revealed type is "int"',
        '8: error: Argument "data" to "Int32" has incompatible type "str"; expected "int"'
        "  [arg-type]",
        '9: error: "Int32" has no attribute "dat"; maybe "data"?  [attr-defined]',
        '13: note: Revealed type is "int"',
        '14: note: Revealed type is "typing.Sequence[int]"',
        '15: note: Revealed type is "int"',
    ], done.stdout + done.stderr


def test_every_type_has_its_fields_and_constants(tmp_path):
    packages = write_stubs(tmp_path)
    assert {"std_msgs", "sensor_msgs", "geometry_msgs"} <= set(packages)
    count = 0
    for name in registry.list_types():
        package, kind, plain = name.split("/")
        module = ast.parse((tmp_path / package / kind / "__init__.pyi").read_text("utf-8"))
        (found,) = [node for node in module.body if getattr(node, "name", "") == plain]
        if kind == "msg":
            fields = [node.target.id for node in found.body if isinstance(node, ast.AnnAssign)]
            message = registry.message(name)
            wanted = [item.name for item in (*message.constants, *message.fields)]
            assert fields == wanted, name
            assert all(hasattr(load(name)(), field) for field in fields)
        count += 1
    assert count > 200


def test_types_of_your_own_and_the_stubs_of_a_boards_port(tmp_path, capsys):
    folder = tmp_path / "stub_valve_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Valve.msg").write_text("float32 opening\nstring<=8[] names\nuint8 OPEN=1\n")
    out = tmp_path / "typings"
    command = ["board", "stubs", str(out), "--board", "pico_w"]
    assert cli.main([*command, "--interfaces", str(tmp_path / "stub_valve_msgs")]) == 0
    text = (out / "stub_valve_msgs" / "msg" / "__init__.pyi").read_text()
    assert (
        "    opening: float\n    names: List[str]\n" in text and "    OPEN: ClassVar[int]\n" in text
    )
    said = capsys.readouterr().out
    assert f"python -m pip install --target {out} micropython-rp2-stubs" in said


def test_a_folder_that_cannot_be_written_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["board", "stubs", str(tmp_path / "file")]) == 1
    assert "file" in (said := capsys.readouterr().err) and "Not a directory" in said
