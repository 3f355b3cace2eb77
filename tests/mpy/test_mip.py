"""Tests that mpremote installs packages for mip on a MicroPython, where they run."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mpy.repl import ReplBoard

from uros.boards.builder.file_system import build
from uros.boards.deploy.mip import write_index, write_manifest

Mpremote = Callable[..., str]


@pytest.fixture
def mpremote() -> Iterator[Mpremote]:
    with ReplBoard() as board:

        def run(*arguments: object) -> str:
            command = [sys.executable, "-m", "mpremote", "connect", board.path]
            process = subprocess.run(
                [*command, *map(str, arguments)], capture_output=True, text=True, timeout=50
            )
            assert process.returncode == 0, process.stdout + process.stderr
            return process.stdout

        yield run


@pytest.mark.slow
@pytest.mark.parametrize("form", ["py", "mpy"])
def test_packages_of_an_index(form: str, tmp_path: Path, mpremote: Mpremote) -> None:
    write_index(tmp_path, [form], ["std_msgs/msg/Int32"])
    install = ["mip", "install", "--index", tmp_path, "--target", "/flash/lib"]
    if form == "py":
        install.append("--no-mpy")
    mpremote(*install, "uros-qos", "std_msgs/msg/Int32")
    output = mpremote(
        "exec",
        "from uros.client import Node\nfrom uros.qos import QoSProfile\n"
        "from std_msgs.msg import Int32\nimport os\n"
        "b = bytearray(8)\nprint(Int32(data=-2).pack_into(b, 0, 0), b[0], Node.__name__)\n"
        "print(os.listdir('/flash/lib/uros/client'))",
    )
    first, second = output.splitlines()
    assert first == "4 254 Node"
    assert f"node.{form}" in second and "parameters" not in second
    second_output = mpremote(*install, "uros")
    assert (
        "Exists: /flash/lib/uros/client/node" in second_output
        and "Installing: " not in second_output
    )


def test_a_built_program_is_installed_by_its_manifest(tmp_path: Path, mpremote: Mpremote) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(
        "from std_msgs.msg import Int32\nprint('main', Int32(data=7).data)\n"
    )
    out = tmp_path / "out"
    manifest = write_manifest(out, build(program, out, "mpy"))
    mpremote("mip", "install", "--target", ".", manifest)
    assert "main 7" in mpremote("exec", "import main")
