"""What every part of a virtual board has in common, and the world that they share.

A part is told the time and never asks for it: :meth:`Part.advance` brings it to a moment of the
world's true time, in integer microseconds since power-on. What has a state that changes by itself
integrates it there in fixed steps, so that a run is the same in whatever rhythm it is asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar


class Part:
    """One thing on a board, or around it.

    ``FAULTS`` is what can go wrong with it and ``ACTS`` what a hand can do to it, each with a text.
    ``faults`` are those that are planted. An act has a name and perhaps a value: ``press``,
    ``level=20``.
    """

    FAULTS: ClassVar[dict[str, str]] = {}
    ACTS: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str) -> None:
        self.name = name
        self.faults: set[str] = set()

    def fault(self, kind: str) -> None:
        """One of FAULTS happens."""
        self.faults.add(kind)

    def active(self, kind: str) -> bool:
        """Whether this fault is planted."""
        return kind in self.faults

    def heal(self) -> None:
        """All of its faults are over."""
        self.faults.clear()

    def act(self, kind: str, value: str = "") -> None:
        """One of ACTS is done. Raises ValueError with a text that tells which values there are."""

    def shows(self) -> str:
        """What a person sees of it, in a few words; "" for nothing."""
        return ""

    def advance(self, t_us: int) -> None:
        """The world's time is ``t_us`` now. It never runs backwards."""

    def reset(self) -> None:
        """The microcontroller was reset."""

    def close(self) -> None:
        """The board is switched off for good."""


class Parts:
    """All parts of a board by name, in the order in which they came."""

    def __init__(self) -> None:
        self._parts: dict[str, Part] = {}
        self.live: list[Part] = []  # those that time changes

    def add(self, part: Part) -> None:
        """Raises ValueError where the name is taken."""
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
        """Bring all of them to this time."""
        for part in self.live:
            part.advance(t_us)
