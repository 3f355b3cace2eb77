"""The secrets of a program: kept out of builds, and out of every message."""

import pytest

from uros.boards.builder.errors import BuildError, SourceError
from uros.boards.builder.file_system import build
from uros.boards.builder.secrets_file import first_import, read_secrets
from uros.boards.virtual.engine.runner import RunningBoard, StartError
from uros.tools import cli

PASSWORD = "hush-hush-42"


@pytest.fixture
def program(tmp_path):
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text("import secrets\nprint('is', secrets.WIFI_PASSWORD[:4])\n")
    (folder / "secrets.py").write_text(f"WIFI_PASSWORD = {PASSWORD!r}\n")
    return folder


@pytest.mark.parametrize("options", [[], ["--mpy", "--mip"]])
def test_a_build_has_no_secrets_and_says_how_they_get_to_the_board(
    program, tmp_path, options, capsys
):
    out = tmp_path / "out"
    assert cli.main(["board", "build", str(program), str(out), *options]) == 0
    said = capsys.readouterr()
    assert "main.py:1 imports secrets, which a build leaves out" in said.out
    assert "'uros board deploy\n--secrets FILE'" in said.out
    assert PASSWORD not in said.out + said.err
    files = {path.name: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert "secrets.py" not in files and "main.py" in files
    assert not any(PASSWORD.encode() in data or b"secrets.py" in data for data in files.values())


def test_the_file_in_the_folder_or_the_one_that_is_given(program, tmp_path):
    other = tmp_path / "lab.py"
    other.write_text("WIFI_PASSWORD = 'other'\n")
    assert PASSWORD.encode() in read_secrets(program, None)
    assert read_secrets(program, other) == b"WIFI_PASSWORD = 'other'\n"
    (program / "secrets.py").unlink()
    assert read_secrets(program, None) is None
    with pytest.raises(SourceError, match=r"none\.py: No such file"):
        read_secrets(program, tmp_path / "none.py")


@pytest.mark.parametrize("text", [b"A = 1\nP = 'hush-hush-42\n", b"\xff\xfehush-hush-42", b"a\0b"])
def test_a_file_that_is_no_python_is_named_and_not_quoted(program, text, tmp_path, capsys):
    (program / "secrets.py").write_bytes(text)
    with pytest.raises(BuildError, match="this is no Python") as error:
        read_secrets(program, None)
    assert "hush" not in str(error.value) and error.value.__cause__ is None
    assert cli.main(["board", "deploy", str(program), "--port", "/dev/none"]) == 1
    assert "hush" not in capsys.readouterr().err
    build(program, tmp_path / "out")  # which does not read it


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("import time, secrets\n", "main.py:1"),
        ("def f():\n    from secrets import KEY\n", "main.py:2"),
        ("try:\n    import secrets\nexcept ImportError:\n    secrets = None\n", ""),
        ("import my_secrets\n", ""),
        ("import (\n", ""),
    ],
)
def test_where_a_program_imports_its_secrets(program, text, place):
    (program / "tests").mkdir()
    (program / "tests" / "test_it.py").write_text("import secrets\n")
    (program / "main.py").write_text(text)
    assert first_import(program) == place


def test_a_virtual_board_has_the_secrets_or_says_what_is_missing(program, tmp_path):
    with RunningBoard(program, "esp32_publisher") as board:
        board.wait("is hush")
    (tmp_path / "lab.py").write_text("WIFI_PASSWORD = 'other'\n")
    with RunningBoard(program, "esp32_publisher", secrets=tmp_path / "lab.py") as board:
        board.wait("is othe")
    (program / "secrets.py").unlink()
    with pytest.raises(StartError, match=r"main.py:1 imports secrets: put a secrets.py beside"):
        RunningBoard(program, "esp32_publisher").start()
