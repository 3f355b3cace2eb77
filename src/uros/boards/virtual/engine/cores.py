"""A board's second core: the mailboxes between the cores, and their system calls.

The second core's program is a module of the firmware with ``start(inbox, outbox)`` and ``step()``.
It runs in an interpreter of its own, in a thread of the engine. The cores share the board and the
mailboxes.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable
from typing import Final

from ..shims import _ops as ops

BOXES: Final = 2
MOST_NUMBERS: Final = 16  # of one mailbox; limits the memory that a program in a loop takes


class Mail:
    """The mailboxes between the cores.

    A mailbox holds the newest message of each number; messages are received in the order of their
    numbers.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[dict[int, bytes]] = [{} for _ in range(BOXES)]

    def send(self, box: int, number: int, data: bytes) -> None:
        """Put a message into a mailbox; it replaces a message of the same number.

        Raises:
            OSError: There is no such mailbox or number (EINVAL), or the mailbox holds
                `MOST_NUMBERS` other numbers (ENOMEM).
        """
        if box >= BOXES or not number:
            raise OSError(errno.EINVAL, "there is no such mailbox, or number")
        with self._lock:
            waiting = self._waiting[box]
            if number not in waiting and len(waiting) >= MOST_NUMBERS:
                raise OSError(errno.ENOMEM, "the mailbox has no room for one more number")
            waiting[number] = data

    def receive(self, box: int) -> bytes:
        """Take the next message: its number, an octet, and its data; b"" if there is none.

        Raises:
            OSError: There is no such mailbox (EINVAL).
        """
        if box >= BOXES:
            raise OSError(errno.EINVAL, "there is no such mailbox")
        with self._lock:
            waiting = self._waiting[box]
            if not waiting:
                return b""
            number = min(waiting)
            return bytes((number,)) + waiting.pop(number)

    def clear(self) -> None:
        """Discard all messages."""
        with self._lock:
            for waiting in self._waiting:
                waiting.clear()


class CoreHost:
    """The system calls of the second core and the mailboxes.

    Args:
        mail: The mailboxes.
        start: Starts the second core with a module; None on the second core itself.
    """

    def __init__(self, mail: Mail, start: Callable[[str], None] | None) -> None:
        self._mail = mail
        self._start = start
        self.operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.CORE_START: self._start_core,
            ops.MAIL_SEND: self._send,
            ops.MAIL_RECEIVE: lambda data: self._mail.receive(data[0]),
        }

    def _start_core(self, data: bytes) -> bytes:
        if self._start is None:
            raise OSError(errno.ENODEV, "this board has two cores, and both are running")
        self._start(data.decode())
        return b""

    def _send(self, data: bytes) -> bytes:
        self._mail.send(data[0], data[1], data[2:])
        return b""
