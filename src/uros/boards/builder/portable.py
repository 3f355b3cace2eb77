"""Defines which modules of uros boards may have; no other module does.

Every module in one of `FOLDERS` runs on MicroPython, except those whose name ends in ``_host``:
these are for hosts. `MODULES` are single modules of folders that hosts and boards share. The
builder, the package index for mip and the tests on MicroPython use these definitions; a test checks
pyproject.toml against them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import uros

SOURCE: Final = Path(uros.__file__).parent
"""The folder of the package ``uros``."""
FOLDERS: Final = ("wire", "client", "control", "drivers", "transport")
MODULES: Final = (
    "qos",
    "ticks",
    "interfaces",
    "interfaces.checked",
    "interfaces.codec",
    "interfaces.compact",
    "interfaces.dynamic",
    "interfaces.errors",
    "interfaces.runtime",
    "interfaces.table",
)
HOST_SUFFIX: Final = "_host"
"""Suffix of the names of modules in `FOLDERS` that are for hosts alone."""


def is_portable(name: str) -> bool:
    """Whether a board may have the module of this full name, such as ``uros.wire.cdr``.

    Modules that do not exist count as well.
    """
    relative_name = name.partition(".")[2]
    folder = relative_name.partition(".")[0]
    return relative_name in MODULES or (
        folder in FOLDERS and not relative_name.endswith(HOST_SUFFIX)
    )


def portable_files() -> list[Path]:
    """Return the files of all modules that boards may have, sorted."""
    files = [path for folder in FOLDERS for path in (SOURCE / folder).glob("*.py")]
    for name in MODULES:
        path = SOURCE.joinpath(*name.split("."))
        files.append(path / "__init__.py" if path.is_dir() else path.with_suffix(".py"))
    return sorted(path for path in files if not path.stem.endswith(HOST_SUFFIX))
