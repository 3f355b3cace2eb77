"""Manifests for MicroPython's build: each file that they name is there, and nothing else is."""

from pathlib import Path

import pytest
from support.paths import ROOT

from uros.boards.builder.portable import portable_files
from uros.tools import cli
from uros.tools.board.deploy import _read


class Manifest:
    """Carries out a manifest with the functions of MicroPython's tools/manifestfile.py."""

    def __init__(self, path):
        self.folder = path.parent
        self.included = []
        self.files = {}  # target: (source, opt)
        self.described = {}
        functions = {
            "include": self.included.append, "module": self.module, "package": self.package,
            "metadata": lambda **what: self.described.update(what),
        }  # fmt: skip
        exec(path.read_text(), functions)

    def module(self, module_path, base_path=".", opt=None):
        assert module_path.endswith(".py")
        self.files[module_path] = self.folder / base_path / module_path, opt

    def package(self, package_path, files=None, base_path=".", opt=None):
        for file in files:
            self.module(f"{package_path}/{file}", base_path, opt)


@pytest.fixture
def program(tmp_path):
    folder = tmp_path / "program"
    (folder / "kit").mkdir(parents=True)
    (folder / "main.py").write_text(
        "import kit.part\nfrom std_msgs.msg import Int32\nfrom uros.client import Node\n"
    )
    (folder / "kit" / "part.py").write_text("import secrets\n")
    (folder / "table.json").write_text("{}")
    return folder


def test_a_program_is_frozen_with_what_it_imports(program, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["board", "build", str(program), str(out), "--freeze"]) == 0
    manifest = Manifest(out / "manifest.py")
    assert manifest.included == ["$(PORT_DIR)/boards/manifest.py"]
    built = {path.relative_to(out).as_posix() for path in out.rglob("*.py")} - {"manifest.py"}
    assert set(manifest.files) == built and "uros/client/node.py" in built
    assert all(source.is_file() for source, _ in manifest.files.values())
    own = {"main.py", "kit/part.py"}  # which keep their asserts and line numbers
    assert {path for path, (_, opt) in manifest.files.items() if opt is None} == own
    assert {opt for path, (_, opt) in manifest.files.items() if path not in own} == {3}
    said = capsys.readouterr().out
    assert f"FROZEN_MANIFEST={out}/manifest.py" in said
    assert "copy them to the board: table.json" in said and "imports secrets" in said


def test_a_board_does_not_get_the_manifest(program, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["board", "build", str(program), str(out), "--freeze"]) == 0
    assert "manifest.py" not in _read(out) and "main.py" in _read(out)
    (out / "manifest.py").write_text("# a module of the program\n")
    assert "manifest.py" in _read(out)


@pytest.mark.parametrize("option", ["--mpy", "--mip"])
def test_what_does_not_go_together_is_refused(program, tmp_path, option, capsys):
    command = ["board", "build", str(program), str(tmp_path / "out"), "--freeze"]
    assert cli.main([*command, option]) == 1
    assert "--freeze takes the program as text, which" in capsys.readouterr().err
    (program / "manifest.py").write_text("")
    assert cli.main(command) == 1
    assert "manifest.py has the name of the file that --freeze writes" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_projects_manifest_has_every_module_of_boards():
    manifest = Manifest(ROOT / "manifest.py")
    source = ROOT / "src"
    wanted = {file.relative_to(source).as_posix() for file in portable_files()}
    assert set(manifest.files) == wanted and "uros/__init__.py" not in wanted
    assert all(Path(path).is_file() for path, _ in manifest.files.values())
    assert manifest.described["version"]
