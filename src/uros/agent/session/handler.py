"""Who hears of what is in a client's messages."""

from __future__ import annotations

from typing import Final, Protocol


class Handler(Protocol):
    """What a session needs of the client it belongs to."""

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        """Handle one submessage. False: no room for it now, give it again."""

    def room(self, stream: int) -> None:
        """A reliable stream can take messages again."""

    def fault(self, what: str, about: str) -> None:
        """The client broke the protocol; the rest of its message is dropped."""

    def many_fragments(self, size: int, count: int) -> None:
        """For the first time, a message needs more fragments than SAFE_FRAGMENTS of a session."""


class _Gone:
    """In a client's place after its end: nothing may be made, and nothing is told."""

    def submessage(self, kind: int, flags: int, stream: int, payload: memoryview) -> bool:
        return True

    def room(self, stream: int) -> None:
        pass

    def fault(self, what: str, about: str) -> None:
        pass

    def many_fragments(self, size: int, count: int) -> None:
        pass


GONE: Final = _Gone()
