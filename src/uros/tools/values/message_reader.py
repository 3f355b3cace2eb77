"""Reads messages, and warns about those that cannot be read."""

from __future__ import annotations

from typing import Any

from ..waiting import warn


class MessageReader:
    """Reads the messages of one class, and counts those that it cannot read.

    Args:
        message_class: The class.
    """

    def __init__(self, message_class: Any) -> None:
        self._class = message_class
        self.unread = 0
        self._say_at = 1

    def read(self, cdr: bytes) -> Any:
        """Return the message of some CDR; None if it cannot be read.

        A warning is printed at the first one, then each time at ten times as many.
        """
        from ...interfaces import InterfaceError, codec

        try:
            return codec.from_cdr(self._class, cdr)
        except InterfaceError as error:
            self.unread += 1
            if self.unread == self._say_at:
                self._say_at *= 10
                warn(
                    f"{self.unread} message{'s' if self.unread > 1 else ''} could not be read:"
                    f" {error}; is this the publisher's definition?"
                    " uros topic echo --raw prints the bytes"
                )
            return None
