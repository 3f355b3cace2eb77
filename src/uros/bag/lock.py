"""The lock of a bag that is recorded or recovered, which keeps others from replacing its files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..file_lock import lock
from .errors import BagError


class FolderLock:
    """The lock of a bag's folder, until :meth:`release` or the end of the process.

    Nothing is locked if the folder cannot be opened, as on Windows, where nobody can replace a file
    that is open.

    Args:
        folder: The folder.

    Raises:
        BlockingIOError: Another process, or another lock of this one, has it.
    """

    def __init__(self, folder: Path) -> None:
        self._fd = -1
        try:
            self._fd = os.open(folder, os.O_RDONLY)
        except OSError:
            return
        try:
            lock(self._fd)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Release the lock; idempotent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a bag's folder within the block.

    Raises:
        BagError: Another program records or recovers the bag.
    """
    try:
        held = FolderLock(folder)
    except BlockingIOError as error:
        raise BagError(in_use(folder)) from error
    try:
        yield
    finally:
        held.release()


def in_use(folder: str | os.PathLike[str]) -> str:
    """Return the text for a bag that another program writes."""
    return (
        f"{folder}: another program is recording or recovering this bag; wait for its end, or end"
        " the recording with Ctrl-C"
    )


def is_locked(folder: Path) -> bool:
    """Return whether another program records or recovers a bag."""
    try:
        FolderLock(folder).release()
    except BlockingIOError:
        return True
    return False
