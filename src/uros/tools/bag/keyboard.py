"""Single keys of the terminal, read without waiting for them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

SPACE: Final = " "
UP: Final = "up"
DOWN: Final = "down"
RIGHT: Final = "right"

_ARROWS: Final = {b"A": UP, b"B": DOWN, b"C": RIGHT}
_WINDOWS_ARROWS: Final = {"H": UP, "P": DOWN, "M": RIGHT}
# A control sequence (ECMA-48 5.4), or one of a keypad in application mode (SS3), or any octet.
_KEY: Final = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*|O)([@-~])|(.)", re.DOTALL)


class Keyboard:
    """The keys that were pressed since the last look.

    Attributes:
        is_open: Whether there is a terminal that this process may read.
    """

    def __init__(self, fileno: int | None, is_windows: bool = False) -> None:
        self._fileno = fileno
        self._is_windows = is_windows
        self.is_open = fileno is not None or is_windows

    def pressed(self) -> list[str]:
        """Return the keys, oldest first: a letter, or `UP`, `DOWN` or `RIGHT`."""
        if self._is_windows:
            return _pressed_on_windows()
        if self._fileno is None:
            return []
        import select

        if not select.select([self._fileno], [], [], 0)[0]:
            return []
        typed = os.read(self._fileno, 256)
        if not typed:  # the terminal is gone
            self._fileno = None
        return parse(typed)


def parse(typed: bytes) -> list[str]:
    """Return the keys of what a terminal sends; those without a meaning here are left out."""
    keys = []
    for match in _KEY.finditer(typed):
        if match[2] is None:
            keys += [_ARROWS[match[1]]] if match[1] in _ARROWS else []
        elif match[2].isascii() and match[2] != b"\x1b":
            keys.append(match[2].decode())
    return keys


def _pressed_on_windows() -> list[str]:
    import importlib

    console = importlib.import_module("msvcrt")  # which no other system has
    keys = []
    while console.kbhit():
        key = console.getwch()
        if key in ("\x00", "\xe0"):
            key = _WINDOWS_ARROWS.get(console.getwch(), "")
        keys += [key] if key else []
    return keys


@contextmanager
def open_keyboard(enabled: bool = True) -> Iterator[Keyboard]:
    """Have the terminal pass each key at once for the duration of a block.

    A process in the background leaves the terminal alone, since it would be stopped (SIGTTOU).

    Args:
        enabled: False gives a keyboard without keys.
    """
    before = None
    fileno = 0
    if enabled:
        try:
            import termios
            import tty

            fileno = sys.stdin.fileno()
            if os.isatty(fileno) and os.tcgetpgrp(fileno) == os.getpgrp():
                before = termios.tcgetattr(fileno)
        except ImportError:
            yield Keyboard(None, is_windows=sys.stdin.isatty())
            return
        except (OSError, ValueError):
            pass
    if before is None:
        yield Keyboard(None)
        return
    try:
        tty.setcbreak(fileno)
        yield Keyboard(fileno)
    finally:
        termios.tcsetattr(fileno, termios.TCSADRAIN, before)
