"""The base class of all parts of a virtual board, and the list of them.

A part never reads a clock: :meth:`Part.advance` passes it the world's true time, in integer
microseconds since power-on. A part whose state changes with time integrates it there in fixed
steps, so that a run does not depend on when the part is advanced.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar


class Part:
    """One part of a board, or of its environment.

    ``FAULTS`` are the faults that can be injected and ``ACTS`` the actions of the user, each with a
    description. ``faults`` are the active ones. An action has a name and optionally a value:
    ``press``, ``level=20``.
    """

    FAULTS: ClassVar[dict[str, str]] = {}
    ACTS: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str) -> None:
        self.name = name
        self.faults: set[str] = set()

    def fault(self, kind: str) -> None:
        """Activate one of FAULTS."""
        self.faults.add(kind)

    def active(self, kind: str) -> bool:
        """Return whether this fault is active."""
        return kind in self.faults

    def heal(self) -> None:
        """Clear all faults of the part."""
        self.faults.clear()

    def act(self, kind: str, value: str = "") -> None:
        """Do one of ACTS.

        Raises:
            ValueError: The value is not valid; the text tells which values are.
        """

    def shows(self) -> str:
        """Return the visible state in a few words; "" for none."""
        return ""

    def advance(self, t_us: int) -> None:
        """Advance the part to ``t_us``, in microseconds of true time; it never decreases."""

    def reset(self) -> None:
        """Handle a reset of the microcontroller."""

    def close(self) -> None:
        """Release resources: the board is switched off."""


class Parts:
    """All parts of a board by name, in the order in which they were added."""

    def __init__(self) -> None:
        self._parts: dict[str, Part] = {}
        self.live: list[Part] = []  # parts that override advance()

    def add(self, part: Part) -> None:
        """Add a part.

        Raises:
            ValueError: The name is taken.
        """
        if part.name in self._parts:
            raise ValueError(f"there is a part {part.name} already")
        self._parts[part.name] = part
        if type(part).advance is not Part.advance:
            self.live.append(part)

    def __iter__(self) -> Iterator[Part]:
        return iter(self._parts.values())

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def __getitem__(self, name: str) -> Part:
        return self._parts[name]

    def advance(self, t_us: int) -> None:
        """Advance all parts to this time."""
        for part in self.live:
            part.advance(t_us)
