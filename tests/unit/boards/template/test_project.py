"""A new project: its files, its test, and folders that are left as they are."""

import os
import subprocess
import sys

import pytest

from uros.boards.builder.file_system import build
from uros.boards.template.project import FILES, ProjectError, node_name, write
from uros.tools import cli


def contents(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_project_has_its_files_and_its_test_passes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["board", "new", "lab/green-house"]) == 0
    out = capsys.readouterr().out
    folder = tmp_path / "lab" / "green-house"
    assert set(contents(folder)) == set(FILES.values())
    assert all(f"lab/green-house/{path}\n" in out for path in FILES.values())
    assert "uros board run esp32_publisher --firmware lab/green-house\n" in out
    for path, data in contents(folder).items():
        text = data.decode()
        assert "NAME" not in text and "FOLDER" not in text, path
        assert max(map(len, text.splitlines())) <= 100, path
    assert b"uros board deploy lab/green-house --port" in (folder / "README.md").read_bytes()
    assert b'Node("green_house"' in (folder / "main.py").read_bytes()

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "lab/green-house"],
        capture_output=True, text=True, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.slow
def test_the_test_of_a_project_fails_if_its_program_does_nothing(tmp_path):
    folder = tmp_path / "idle"
    write(folder)
    main = folder / "main.py"
    main.write_text(main.read_text().replace("node.create_timer(", "print("))
    test = folder / "tests" / "test_program.py"
    test.write_text(test.read_text().replace('"two counts"', '"two counts", 3'))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", str(folder)], capture_output=True, text=True
    )
    assert done.returncode == 1 and "waited 3 s for two counts" in done.stdout
    assert "client_key" in done.stdout  # the agent's log


def test_the_board_gets_the_program_and_not_its_test(tmp_path):
    write(tmp_path / "blinker")
    (tmp_path / "blinker" / "tests" / "helper.py").write_text("import numpy\n")
    build(tmp_path / "blinker", tmp_path / "out")
    files = contents(tmp_path / "out")
    assert "main.py" in files and "uros/client/node.py" in files
    assert not [path for path in files if path.startswith("tests") or "README" in path]


@pytest.mark.parametrize("kind", ["full", "empty", "file"])
def test_what_exists_is_refused_and_left_as_it_is(tmp_path, kind, capsys):
    folder = tmp_path / "mine"
    if kind == "file":
        folder.write_text("precious")
    else:
        folder.mkdir()
    if kind == "full":
        (folder / "main.py").write_text("print('mine')\n")
    before = contents(tmp_path)
    assert cli.main(["board", "new", str(folder)]) == 1
    assert "exists already, and nothing was written: give another name" in capsys.readouterr().err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["2nd", "grüner", "a b", "a__b", "x" * 300])
def test_names_that_ros_does_not_allow_are_refused_with_the_rule(tmp_path, name, capsys):
    assert cli.main(["board", "new", str(tmp_path / name)]) == 1
    said = capsys.readouterr().err
    assert "a node's name" in said and "give another name, such as my_board" in said
    assert not list(tmp_path.iterdir())


def test_the_current_folder_has_no_name(tmp_path):
    with pytest.raises(ProjectError):
        node_name(tmp_path / "..")


def test_a_disk_that_refuses_a_file_leaves_no_folder(tmp_path, monkeypatch, capsys):
    from pathlib import Path

    written = Path.write_text

    def refuse(self, text, **options):
        if self.name == "test_program.py":
            raise OSError(28, "No space left on device", str(self))
        return written(self, text, **options)

    monkeypatch.setattr(Path, "write_text", refuse)
    assert cli.main(["board", "new", str(tmp_path / "mine")]) == 1
    assert "test_program.py: No space left on device" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
