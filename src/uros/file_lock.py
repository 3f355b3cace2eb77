"""Locks a file or a folder that one process writes, so that another one is refused."""

from __future__ import annotations

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def lock(file: int) -> None:
    """Lock a file or a folder while it is open, where the system and its file system have locks.

    Args:
        file: Its descriptor.

    Raises:
        BlockingIOError: Another process, or another descriptor of this one, has the lock.
    """
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass  # a file system without locks
