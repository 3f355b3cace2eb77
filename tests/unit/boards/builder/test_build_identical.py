"""Tests that every Python version and hash seed builds the same bytecode."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from uros.boards.builder.file_system import build

BUILD = """
import sys
sys.path += sys.argv[3:]
from pathlib import Path
from uros.boards.builder.file_system import build
build(Path(sys.argv[1]), Path(sys.argv[2]), "mpy")
"""


def digest(folder: Path) -> str:
    hash_ = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        hash_.update(file.relative_to(folder).as_posix().encode() + file.read_bytes())
    return hash_.hexdigest()


def interpreters() -> list[str]:
    """Return this Python, and those of other versions that are installed and start."""
    paths = [sys.executable]
    for minor in range(10, 14):
        path = shutil.which(f"python3.{minor}")
        if path and subprocess.run([path, "-V"], capture_output=True).returncode == 0:
            paths.append(path)
    return paths


@pytest.mark.slow
def test_every_python_builds_the_same(tmp_path: Path) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text("import app\n")
    (program / "app.py").write_text(
        "from sensor_msgs.msg import Imu\nfrom uros.client import Node\n"
        "from uros.transport.serial import StreamTransport\n"
        "def run(port):\n    Node('n', StreamTransport(port)).create_publisher(Imu, 'imu', 10)\n"
    )
    build(program, tmp_path / "here", "mpy")
    expected = digest(tmp_path / "here")
    for number, python in enumerate(interpreters()):
        out = tmp_path / f"out{number}"
        environment = {**os.environ, "PYTHONHASHSEED": str(number + 1)}
        command = [python, "-c", BUILD, str(program), str(out), *sys.path]
        process = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert process.returncode == 0, f"{python}: {process.stderr}"
        assert digest(out) == expected, python
