"""Tests that random programs print the same as text, as bytecode and without each pass."""

from collections.abc import Iterable
from pathlib import Path

import pytest
from mpy.harness import MicroPython, tree
from mpy.random_programs import Program

from uros.boards.builder import resolver
from uros.boards.builder.file_system import build
from uros.boards.builder.pipeline import PASSES

FORMS: dict[str, tuple[str, tuple[str, ...]]] = {
    "text": ("py", ()),
    "bytecode": ("mpy", ()),
    **{f"bytecode without {step.name}": ("mpy", (step.name,)) for step in PASSES},
}


def texts(numbers: Iterable[int], package: str) -> dict[str, str]:
    """Return the modules of some programs by path, and a main.py that runs them in turn."""
    files = {}
    main = []
    for number in numbers:
        first, second = f"{package}first{number}", f"second{number}"
        for name, text in Program(number).modules(first, second).items():
            files[f"{package.replace('.', '/')}{name}.py"] = text
        main.append(f"from {package}{second} import run_{number}\nrun_{number}()\n")
    files["main.py"] = "".join(main)
    return files


def write(files: dict[str, str], folder: Path) -> None:
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


def output(files: dict[str, str] | dict[str, bytes]) -> list[str]:
    """Return the output of the programs, a line each."""
    with MicroPython() as board:
        board.install(files)
        return board.run("import main").splitlines()


def compare(numbers: list[int], program: Path, out: Path, expected: list[str]) -> None:
    assert len(expected) == len(numbers)
    for form, (kind, without) in FORMS.items():
        build(program, out, kind, without=without)
        lines = output(tree(out))
        for number, line, expected_line in zip(numbers, lines, expected, strict=True):
            assert line == expected_line, f"program {number}, {form}"


def check_users(numbers: list[int], folder: Path) -> None:
    """Compare the outputs of programs that are modules of a user's program."""
    files = texts(numbers, "")
    write(files, folder / "program")
    compare(numbers, folder / "program", folder / "out", output(files))


def check_ours(numbers: list[int], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare the outputs of programs that are modules of uros, which the passes change."""
    files = texts(numbers, "uros.client.")
    write(files, folder / "source")
    (folder / "program").mkdir()
    (folder / "source" / "main.py").rename(folder / "program" / "main.py")
    (folder / "source" / "uros" / "client" / "__init__.py").touch()
    monkeypatch.setattr(resolver, "SOURCE", folder / "source" / "uros")
    compare(numbers, folder / "program", folder / "out", output(files))


@pytest.mark.slow
def test_users_programs(tmp_path: Path) -> None:
    check_users(list(range(6)), tmp_path)


def test_modules_of_uros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_ours([3, 9, 12, 21], tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("first", range(100, 300, 20))
def test_many_programs(first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_users(list(range(first, first + 4)), tmp_path / "users")
    check_ours(list(range(first, first + 20)), tmp_path / "ours", monkeypatch)
