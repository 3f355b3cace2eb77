"""Writes the folder of a new program for boards: the program, its README and its test.

The files are the texts of this folder. ``NAME`` stands for the node's name in them, ``FOLDER`` for
the path as it was given.
"""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path
from typing import Final

from ...client.node import check_name

_HERE: Final = Path(__file__).parent
FILES: Final = {
    "main.txt": "main.py",
    "readme.txt": "README.md",
    "test.txt": "tests/test_program.py",
    "ignored.txt": ".gitignore",
}
"""The texts, and the files that are made of them."""


class ProjectError(ValueError):
    """The project cannot be written; the text names the reason and the remedy."""


def node_name(folder: Path) -> str:
    """Return the name of the node for a folder: the folder's name, with _ in place of -.

    Raises:
        ProjectError: ROS allows no such name.
    """
    name = folder.name.replace("-", "_")
    try:
        return check_name(name, "a node's name", 0)
    except ValueError as error:
        raise ProjectError(f"{error}; give another name, such as my_board") from None


def write(folder: Path) -> list[Path]:
    """Write a new project; return its files.

    Args:
        folder: The folder, which must not exist. Its name becomes that of the node.

    Raises:
        ProjectError: The folder exists, or its name is no name of a node; nothing is written.
        OSError: The disk refuses a file; the folder is removed.
    """
    name = node_name(folder)
    texts = {
        path: (_HERE / text)
        .read_text(encoding="utf-8")
        .replace("FOLDER", shlex.quote(str(folder)))
        .replace("NAME", name)
        for text, path in FILES.items()
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        folder.mkdir()
    except FileExistsError:
        raise ProjectError(
            f"{folder} exists already, and nothing was written: give another name, or remove it"
        ) from None
    try:
        for path, text in texts.items():
            file = folder / path
            file.parent.mkdir(exist_ok=True)
            file.write_text(text, encoding="utf-8")
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return [folder / path for path in texts]
