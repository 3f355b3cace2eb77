"""Standard output that a slow reader does not block, so that messages are still received."""

from __future__ import annotations

import io
import os
import select
import sys
import time
from typing import Final

from ...printable import printable, unguarded

# What the reader of a pipe has room for when the pipe is writable (PIPE_BUF of Linux).
_BLOCK: Final = 4096
# The most octets that wait for a slow reader.
_MOST: Final = 1 << 20
_CLEAR: Final = "\033[H\033[2J"


class Output:
    """Text for standard output, which waits here until its reader has room.

    Where standard output is no file of the system, and on Windows, text is written at once.
    """

    def __init__(self) -> None:
        self._stream = unguarded(sys.stdout)
        self._encoding = self._stream.encoding or "utf-8"
        self._waiting = bytearray()
        try:
            self._fileno = -1 if os.name == "nt" else self._stream.fileno()
        except (io.UnsupportedOperation, AttributeError):
            self._fileno = -1
        self._is_terminal = self._stream.isatty()

    @property
    def full(self) -> bool:
        """Whether so much text waits that more is not to be written now."""
        return len(self._waiting) >= _MOST

    @property
    def waiting(self) -> bool:
        """Whether text waits, which `flush` tries to write."""
        return bool(self._waiting)

    def write(self, text: str, clear: bool = False) -> None:
        """Add text, with escapes for what a terminal would obey.

        Args:
            text: The text.
            clear: Whether to clear the screen of a terminal before it.
        """
        text = printable(text, "\n\t")
        if clear and self._is_terminal:
            text = _CLEAR + text
        if self._fileno < 0:
            self._stream.write(text)
            self._stream.flush()
            return
        self._waiting += text.encode(self._encoding, "backslashreplace")

    def flush(self, seconds: float | None = 0.0) -> None:
        """Write what the reader has room for.

        Args:
            seconds: How long to wait for the reader to take all; None has no limit.
        """
        end = None if seconds is None else time.monotonic() + seconds
        while self._waiting:
            left = None if end is None else max(0.0, end - time.monotonic())
            if not select.select([], [self._fileno], [], left)[1]:
                return
            del self._waiting[: os.write(self._fileno, self._waiting[:_BLOCK])]
