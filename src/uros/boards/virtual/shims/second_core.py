# mypy: disable-error-code="no-any-return"
"""The board's second core, which runs an interpreter of its own.

``start("sub")`` imports that module there, calls its ``start(inbox, outbox)`` once and its
``step()`` forever. The cores share two mailboxes only: `TO_SECOND` and `TO_FIRST`.
"""

import _board  # type: ignore[import-not-found]

try:
    from typing import Any
except ImportError:
    pass

TO_SECOND = 0
TO_FIRST = 1
_NUMBERS = {"nan": float("nan"), "inf": float("inf")}


class Mailbox:
    """A mailbox from one core to the other.

    It keeps the newest message of each number (1 to 255), so that its size is bounded; messages
    are received in the order of their numbers.
    """

    def __init__(self, box: int) -> None:
        self.value: Any = None
        self._box = box

    def send(self, number: int, value: "Any" = None) -> None:
        """Send a message: None, numbers, text, and tuples and lists of these."""
        text = repr(value).encode()
        _board.call(_board.MAIL_SEND, bytes((self._box, number)) + text)

    def receive(self) -> int:
        """Return the number of the next message and put it in ``value``; 0: there is none."""
        data = _board.call(_board.MAIL_RECEIVE, bytes((self._box,)))
        if not data:
            return 0
        self.value = eval(data[1:].decode(), _NUMBERS)  # what the other core has sent
        return data[0]


def start(module: str) -> None:
    """Start the second core; raise OSError where it runs already."""
    _board.call(_board.CORE_START, module.encode())
