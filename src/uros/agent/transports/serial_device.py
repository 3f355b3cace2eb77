"""A serial device by its name, or by a file that holds the name; by whatever opens it."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import Final

from .base import ERROR, INFO
from .line import LineServer

# Bytes of a file that holds a device name: the file could be endless.
_MAX_NAME: Final = 4096


def is_url(device: str) -> bool:
    """Return whether ``device`` is a URL: ``socket://host:port``, ``rfc2217://host:port``."""
    return "://" in device


def is_path(device: str) -> bool:
    """Return whether ``device`` is the path of a file: no URL, and no name of Windows as COM3."""
    return os.name == "posix" and not is_url(device) and not re.fullmatch(r"(?i)COM\d+", device)


def _name_in(path: str) -> str:
    """Read the device name in a file without blocking, as it may be a pipe."""

    def without_waiting(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    with open(path, "rb", buffering=0, opener=without_waiting) as file:
        content = file.read(_MAX_NAME + 1) or b""  # None: a pipe with nothing in it
    if len(content) > _MAX_NAME:
        raise OSError(errno.EINVAL, "too long for a name")
    return content.decode("utf-8").strip()


class DeviceServer(LineServer):
    """A serial device by its name, or by a file that holds the name (``is_file``).

    ``dtr`` and ``rts`` raise (True) or drop (False) these lines after opening; None leaves them to
    the system, which is right for most boards (see :mod:`.terminal`).
    """

    def __init__(
        self, device: str, baud: int, is_file: bool, dtr: bool | None, rts: bool | None
    ) -> None:
        super().__init__(device)
        self._baud = self.line.baud = baud
        self._is_file = is_file
        self._dtr = dtr
        self._rts = rts

    def _path(self) -> str:
        if not self._is_file:
            return self.device
        try:
            return _name_in(self.device)
        except UnicodeDecodeError:
            raise OSError(errno.EINVAL, "not a text file") from None

    def _wait(self, number: int, why: str) -> None:
        """Log the reason of a failed opening, and try again later."""
        if number == errno.ENOENT and self._is_file and not Path(self.device).exists():
            why = "errno: 2, the file with the name of the device does not exist"
        missing = number == errno.ENOENT
        self._failed(
            INFO if missing else ERROR,
            "waiting for device" if missing else "open device error",
            why,
        )
