"""Writes the folder of a build, whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from .errors import BuildError

_MARKER: Final = ".made-by-uros"


def is_built(folder: Path) -> bool:
    """Whether `build` wrote the folder."""
    return (folder / _MARKER).is_file()


def replace(out: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Replace a folder by these files, which are written beside it first.

    Args:
        out: The folder: new, empty, or an earlier build.
        files: The files by their path in it.

    Returns:
        The files, sorted.

    Raises:
        BuildError: The folder holds anything else.
        OSError: The disk refuses a file; ``out`` is unchanged.
    """
    if out.is_file() or (out.is_dir() and not (out / _MARKER).exists() and any(out.iterdir())):
        raise BuildError(f"{out} holds something else; give a new folder, or remove it")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=out.name + ".", dir=out.parent) as temporary:
        new = Path(temporary, "new")
        for path, data in files.items():
            file = new / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
        (new / _MARKER).touch()
        if out.exists():
            out.rename(Path(temporary, "old"))
        try:
            new.rename(out)
        except OSError:
            if Path(temporary, "old").exists():
                Path(temporary, "old").rename(out)
            raise
    return sorted(out / path for path in files)
