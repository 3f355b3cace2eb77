"""The lists of portable modules in other files agree with portable.py."""

import ast
import json
import re
import struct

from support.paths import ROOT

from uros.boards.builder.portable import FOLDERS, MODULES, portable_files


def test_the_linter_spares_the_portable_folders() -> None:
    """ruff does not ask for syntax that MicroPython lacks where boards' modules are."""
    settings = (ROOT / "pyproject.toml").read_text("utf-8")
    found = re.search(r'^"\{src/uros/\{([\w,]+)\}/.*= \[[^\]]*"UP007"', settings, re.MULTILINE)
    assert found is not None
    rooms = {name.split(".")[0] for name in MODULES if "." in name}
    assert set(found[1].split(",")) == set(FOLDERS) | rooms


def test_the_package_indexes_have_portable_modules_alone() -> None:
    """mip installs what these files list."""
    files = {str(path.relative_to(ROOT)) for path in portable_files()}
    for name in ("package.json", "package-all.json"):
        sources = {source for _, source in json.loads((ROOT / name).read_text("utf-8"))["urls"]}
        assert sources <= files | {"src/uros/__init__.py"}, name


def test_floats_can_be_frozen_into_firmware_with_32_bit_floats() -> None:
    """MicroPython's tool packs the constants of a frozen module, and the compiler accepts no 0."""
    for path in portable_files():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, float):
                packed = struct.pack("<f", node.value)
                assert any(packed) == bool(node.value), f"{path}:{node.lineno}: {node.value}"
