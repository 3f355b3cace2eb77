"""``uros agent ament``: the package is where ROS 2 looks, and starts the agent."""

import ast
import os
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from uros import __version__
from uros.tools import cli

PACKAGE = "micro_ros_agent"


@pytest.fixture
def prefix(tmp_path):
    folder = tmp_path / "a prefix"
    assert cli.main(["agent", "ament", str(folder)]) == 0
    return folder


def run(*command, **environment):
    return subprocess.run(
        [str(word) for word in command],
        env={**os.environ, **environment}, capture_output=True, text=True,
    )  # fmt: skip


def test_the_package_is_in_the_index_with_its_manifest(prefix):
    """REP 122: an empty file of the package's name marks it; ros2 pkg reads the manifest."""
    marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / PACKAGE
    assert marker.is_file() and marker.read_bytes() == b""
    manifest = ElementTree.parse(prefix / "share" / PACKAGE / "package.xml").getroot()
    assert manifest.findtext("name") == PACKAGE and manifest.findtext("version") == __version__


def test_ros2_run_finds_one_program_and_it_is_the_agent(prefix):
    """ros2 run looks for executable files below lib/PACKAGE."""
    (program,) = (prefix / "lib" / PACKAGE).iterdir()
    assert program.name == PACKAGE and os.access(program, os.X_OK)
    done = run(program, "udp4", "--port", "70000", "--ros-args", "-r", "__node:=agent")
    assert done.returncode == 2 and "70000" in done.stderr


def test_the_launch_file_is_python_that_starts_the_package(prefix):
    (file,) = (prefix / "share" / PACKAGE / "launch").iterdir()
    assert file.name == f"{PACKAGE}_launch.py"
    names = {
        node.name
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.FunctionDef)
    }
    assert "generate_launch_description" in names


@pytest.mark.parametrize("shell", ["sh", "bash"])
def test_setup_puts_the_prefix_first(prefix, shell):
    command = '. "$0" && printf %s "$AMENT_PREFIX_PATH"'
    setup = prefix / f"setup.{shell}"
    assert run(shell, "-c", command, setup, AMENT_PREFIX_PATH="/opt/ros/kilted").stdout == (
        f"{prefix}:/opt/ros/kilted"
    )
    assert run(shell, "-c", command, setup, AMENT_PREFIX_PATH="").stdout == str(prefix)


def test_a_second_time_it_is_updated(prefix):
    program = prefix / "lib" / PACKAGE / PACKAGE
    program.write_text("of an older Python")
    assert cli.main(["agent", "ament", str(prefix)]) == 0
    assert sys.executable in program.read_text()


def test_a_package_of_others_is_not_replaced(tmp_path, capsys):
    manifest = tmp_path / "share" / PACKAGE / "package.xml"
    manifest.parent.mkdir(parents=True)
    manifest.write_text("<package><name>micro_ros_agent</name></package>")
    assert cli.main(["agent", "ament", str(tmp_path)]) == 1
    assert "is the prefix of another micro_ros_agent" in capsys.readouterr().err
    assert not (tmp_path / "lib").exists()


def test_a_workspace_of_others_keeps_its_setup_files(tmp_path, capsys):
    (tmp_path / "setup.bash").write_text("# generated from colcon")
    assert cli.main(["agent", "ament", str(tmp_path)]) == 1
    assert "is the prefix of a workspace" in capsys.readouterr().err
    assert (tmp_path / "setup.bash").read_text() == "# generated from colcon"


def test_a_folder_that_cannot_be_made_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["agent", "ament", str(tmp_path / "file" / "below")]) == 1
    error = capsys.readouterr().err
    assert "Not a directory" in error and error.count("\n") == 1
