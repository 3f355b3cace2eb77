"""The protocol of what a session calls for the content of messages."""

from __future__ import annotations

from typing import Final, Protocol


class Handler(Protocol):
    """What a session calls of the client it belongs to."""

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        """Handle one submessage; return False if there is no room and it must be given again."""

    def room(self, stream: int) -> None:
        """Note that a reliable stream can take messages again."""

    def fault(self, event: str, about: str) -> None:
        """Note that the client broke the protocol; the rest of its message is dropped."""

    def many_fragments(self, size: int, count: int) -> None:
        """Note that a message needs more than SAFE_FRAGMENTS fragments; once a session."""


class _Gone:
    """Replaces the client of a session that has ended, and does nothing."""

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        return True

    def room(self, stream: int) -> None:
        pass

    def fault(self, event: str, about: str) -> None:
        pass

    def many_fragments(self, size: int, count: int) -> None:
        pass


GONE: Final = _Gone()
