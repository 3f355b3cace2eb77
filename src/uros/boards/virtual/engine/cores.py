"""A board's second core: the mailboxes between the cores, and `engine_host` for them.

Its program is a module of the firmware with ``start(inbox, outbox)`` and ``step()``, which runs in
an interpreter of its own, in a thread of the engine. The cores share the board and the mailboxes.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable
from typing import Final

from ..shims import _ops as ops

BOXES: Final = 2
MOST_NUMBERS: Final = 16  # of one box, so that a program in a loop fills nothing


class Mail:
    """The mailboxes. The newest message of each number waits; they are taken in the order of their
    numbers.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[dict[int, bytes]] = [{} for _ in range(BOXES)]

    def send(self, box: int, number: int, data: bytes) -> None:
        """Raises OSError for a box that is not there, or too many numbers."""
        if box >= BOXES or not number:
            raise OSError(errno.EINVAL, "there is no such mailbox, or number")
        with self._lock:
            waiting = self._waiting[box]
            if number not in waiting and len(waiting) >= MOST_NUMBERS:
                raise OSError(errno.ENOMEM, "the mailbox has no room for one more number")
            waiting[number] = data

    def receive(self, box: int) -> bytes:
        """The next message's number, an octet, and its data; b"": there is none."""
        if box >= BOXES:
            raise OSError(errno.EINVAL, "there is no such mailbox")
        with self._lock:
            waiting = self._waiting[box]
            if not waiting:
                return b""
            number = min(waiting)
            return bytes((number,)) + waiting.pop(number)

    def clear(self) -> None:
        with self._lock:
            for waiting in self._waiting:
                waiting.clear()


class CoreHost:
    """The operations. ``start`` starts the second core with a module; None: this is that core."""

    def __init__(self, mail: Mail, start: Callable[[str], None] | None) -> None:
        self._mail = mail
        self._start = start
        self.operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.CORE_START: self._started,
            ops.MAIL_SEND: self._send,
            ops.MAIL_RECEIVE: lambda data: self._mail.receive(data[0]),
        }

    def _started(self, data: bytes) -> bytes:
        if self._start is None:
            raise OSError(errno.ENODEV, "this board has two cores, and both are running")
        self._start(data.decode())
        return b""

    def _send(self, data: bytes) -> bytes:
        self._mail.send(data[0], data[1], data[2:])
        return b""
