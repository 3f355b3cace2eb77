"""The error of bags."""

from __future__ import annotations

import os


class BagError(RuntimeError):
    """A bag cannot be read or written. The text names the file, the fault and the remedy."""


class Reported:
    """Reports errors of the system and of SQLite within a ``with`` as `BagError`.

    Args:
        path: The file, for the error.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None:
            return
        import sqlite3

        if isinstance(error, OSError):
            raise BagError(f"{self._path}: {error.strerror or error}") from error
        if isinstance(error, sqlite3.Error):
            raise BagError(f"{self._path}: {error}") from error
