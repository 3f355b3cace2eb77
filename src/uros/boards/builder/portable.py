"""Names the modules of uros that boards may have: the one place that knows.

The folder tells: every module in one of `FOLDERS` runs on MicroPython, except those whose name
ends in ``_host``, which stand beside the board's modules of the same kind. `MODULES` are single
modules of rooms that hosts and boards share. The builder, the package index for mip and the tests
on MicroPython take it from here; a test holds pyproject.toml to it.
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
"""How the name of a module ends that stands in one of `FOLDERS` and is for hosts alone."""


def is_portable(name: str) -> bool:
    """Whether a board may have the module of this full name, such as ``uros.wire.cdr``.

    It need not exist.
    """
    inside = name.partition(".")[2]
    room = inside.partition(".")[0]
    return inside in MODULES or (room in FOLDERS and not inside.endswith(HOST_SUFFIX))


def portable_files() -> list[Path]:
    """The files of all modules that boards may have, sorted."""
    found = [path for room in FOLDERS for path in (SOURCE / room).glob("*.py")]
    for name in MODULES:
        path = SOURCE.joinpath(*name.split("."))
        found.append(path / "__init__.py" if path.is_dir() else path.with_suffix(".py"))
    return sorted(path for path in found if not path.stem.endswith(HOST_SUFFIX))
