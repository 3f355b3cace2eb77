"""Reads a TOML file, and finds the lines of its keys for messages about mistakes."""

from __future__ import annotations

import re
import sys
from bisect import bisect_left
from pathlib import Path
from typing import Any, Final

from .config_values import ConfigError

# The largest file that is read, in bytes, because a device file may never end.
MAX_FILE: Final = 1024 * 1024

_MISSING: Final = object()
# Where tomllib and tomli see a fault.
_AT_LINE: Final = re.compile(r"\(at line (\d+), column \d+\)$")


class TomlError(ConfigError):
    """A file is no TOML.

    Attributes:
        line: The line of the fault, from 1.
        reason: What is wrong, without the path.

    Args:
        path: The file.
        line: The line of the fault.
        reason: What is wrong.
    """

    def __init__(self, path: str, line: int, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.line = line
        self.reason = reason


def _parse(text: str) -> dict[str, Any]:
    # Most agents have no TOML file: they need not hold its parser.
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    tables: dict[str, Any] = tomllib.loads(text)
    return tables


class TomlFile:
    """A TOML file; it may begin with a byte order mark, as some editors write it.

    Attributes:
        path: Its path.
        content: The tables in it.

    Args:
        path: Its path.

    Raises:
        ConfigError: It cannot be read; the text has the path.
        TomlError: It is no TOML.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = str(path)
        try:
            with Path(path).open("rb") as file:
                raw = file.read(MAX_FILE + 1)
        except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
            why = getattr(error, "strerror", None) or str(error)
            raise ConfigError(f"{path}: {why}") from error
        if len(raw) > MAX_FILE:
            raise ConfigError(f"{path}: over {MAX_FILE} bytes")
        try:
            text = raw.decode("utf-8-sig")
            self.content: dict[str, Any] = _parse(text)
        except (ValueError, RecursionError) as error:  # also for a number of over 4300 digits
            raise TomlError(self.path, _line_of(error, raw), f"no TOML: {error}") from error
        self._lines = text.splitlines(keepends=True)

    def line(self, *keys: str | int) -> int:
        """Return the number of the line, from 1, on which a value begins.

        Args:
            keys: The way to the value: names of tables and keys, and indexes of arrays of tables.

        Returns:
            The line; that of the innermost table of the way that is in the file, if the rest is
            not; 1 if nothing is.
        """
        for depth in range(len(keys), 0, -1):
            if _at(self.content, keys[:depth]) is not _MISSING:
                return self._first_line(keys[:depth])
        return 1

    def _first_line(self, keys: tuple[str | int, ...]) -> int:
        """Return the line on which the statement begins that first mentions the value.

        The lines up to the end of any statement are TOML too. So the statement is found by parsing
        the beginning of the file, and needs no second parser.
        """
        last = bisect_left(
            range(len(self._lines)), True, key=lambda number: self._has(number, keys)
        )
        return self._whole(last - 1)[0] + 1

    def _has(self, number: int, keys: tuple[str | int, ...]) -> bool:
        """Return whether the statements that end within the first lines mention the value."""
        return _at(self._whole(number)[1], keys) is not _MISSING

    def _whole(self, number: int) -> tuple[int, dict[str, Any]]:
        """Return how many of the first lines are whole statements, and what is in these."""
        while number > 0:
            try:
                return number, _parse("".join(self._lines[:number]))
            except ValueError:
                number -= 1  # within an array or a text of several lines
        return 0, {}


def _line_of(error: Exception, raw: bytes) -> int:
    """Return the line of a fault in the bytes of a file; 1 if the error does not tell it."""
    if isinstance(error, UnicodeDecodeError):
        return raw.count(b"\n", 0, error.start) + 1
    if found := _AT_LINE.search(str(error)):
        return int(found[1])
    if str(error).endswith("(at end of document)"):
        return max(1, len(raw.splitlines()))
    return 1


def _at(content: Any, keys: tuple[str | int, ...]) -> Any:
    """Return the value that the keys lead to, or _MISSING."""
    for key in keys:
        try:
            content = content[key]
        except (KeyError, IndexError, TypeError):
            return _MISSING
    return content
