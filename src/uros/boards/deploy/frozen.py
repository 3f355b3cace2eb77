"""Writes what MicroPython's build needs to freeze a program, or uros alone, into a firmware.

Frozen modules are in the flash of the microcontroller: they take no memory for their code, and need
no file system. Two manifests, in the language of MicroPython's ``tools/manifestfile.py``:

- `write_manifest` lists the files of one program that `uros.boards.builder.file_system` built as
  text. The firmware's own mpy-cross compiles them.
- ``manifest.py`` in the root of this project lists all modules of uros that boards may have.

``python -m uros.boards.deploy.mip`` in a clone rewrites the second one.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import uros

MANIFEST: Final = "manifest.py"
_MADE: Final = "# Made by 'uros board build --freeze'"
_HEAD: Final = f"""\
{_MADE}. Freezes this program into a firmware of MicroPython:
#   make -C micropython/ports/PORT BOARD=BOARD FROZEN_MANIFEST={{path}}
include("$(PORT_DIR)/boards/manifest.py")  # what the port itself freezes
"""
_PROJECT: Final = """\
# All modules of uros for boards. Freeze them by this line in a manifest of your own:
#   include("path/to/uros/manifest.py")
# ruff: noqa: D100, F821
metadata(description="micro-ROS in Python: the client for boards", version="{version}")
package(
    "uros",
    files=(
{files}
    ),
    base_path="src",
    opt=3,
)
"""
# The level of mpy-cross that removes asserts and line numbers, for modules of uros.
_OPT: Final = 3


def write_manifest(out: Path, files: Iterable[Path], program: Path) -> tuple[Path, list[str]]:
    """Write ``manifest.py`` into a program's build folder.

    Args:
        out: The build folder.
        files: Its files.
        program: The program's folder, whose modules keep asserts and line numbers.

    Returns:
        The manifest's path, and the files that cannot be frozen, since they are no modules.
    """
    lines, left = [], []
    for path in sorted(file.relative_to(out).as_posix() for file in files):
        if not path.endswith(".py"):
            left.append(path)
        elif (program / path).is_file():
            lines.append(f"module({path!r})")
        else:
            lines.append(f"module({path!r}, opt={_OPT})")
    manifest = out / MANIFEST
    head = _HEAD.format(path=manifest.resolve())
    manifest.write_text("\n".join([*head.splitlines(), *lines, ""]), encoding="utf-8")
    return manifest, left


def is_manifest(path: Path) -> bool:
    """Whether `write_manifest` wrote a file."""
    return path.name == MANIFEST and path.read_text("utf-8", "replace").startswith(_MADE)


def project_manifest(paths: Iterable[str]) -> str:
    """Return the text of the project's ``manifest.py`` for these files below ``src``."""
    files = "\n".join(f'        "{path.removeprefix("uros/")}",' for path in sorted(paths))
    return _PROJECT.format(version=uros.__version__, files=files)
