"""The module ``secrets`` of a board: names and passwords that are no part of the program.

A program imports it like any other module, but builds, package indexes and messages never have its
content: `uros.boards.deploy.deploy` copies it, and virtual boards get it, from a file of its own.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Final

from .errors import SourceError
from .modules import Module, imports

MODULE: Final = "secrets"
FILE: Final = "secrets.py"
"""Its file on the board, and its usual name beside a main.py."""
TESTS: Final = "tests"
"""The folder of a program whose files stay on the host."""


def read_secrets(program: Path, file: Path | None) -> bytes | None:
    """Return the content of a program's secrets.

    Args:
        program: The program's folder.
        file: The file to read; None: the one in the folder, if there is one.

    Returns:
        The content, or None without such a file.

    Raises:
        SourceError: The file cannot be read, or is no Python. The text quotes nothing of it.
    """
    if file is None:
        file = program / FILE
        if not file.is_file():
            return None
    try:
        data = file.read_bytes()
    except OSError as error:
        raise SourceError(f"{file}: {error.strerror}") from None
    try:
        ast.parse(data)
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None) or 1
        raise SourceError(
            f'{file}:{line}: this is no Python; write lines like WIFI_PASSWORD = "..."'
        ) from None
    return data


def first_import(program: Path) -> str:
    """Return where a program imports its secrets, such as ``main.py:3``; "" if it does not.

    An import in a ``try`` that catches ImportError does not count.
    """
    for file in sorted(program.rglob("*.py")):
        path = file.relative_to(program)
        if path.parts[0] == TESTS or path.as_posix() == FILE:
            continue
        try:
            text = file.read_text(encoding="utf-8")
            module = Module("", False, str(file), text, ast.parse(text))
        except (SyntaxError, ValueError):
            continue  # the build reports it
        for wanted in imports(module):
            if wanted.module == MODULE and not wanted.optional:
                return f"{path.as_posix()}:{wanted.line}"
    return ""
