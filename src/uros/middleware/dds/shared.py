"""Things with several users: made for the first, unmade after the last."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

Key = TypeVar("Key")
Thing = TypeVar("Thing")


class Shared(Generic[Key, Thing]):
    """``make(key)`` makes a thing, ``unmake(thing)`` is told when nobody uses it."""

    def __init__(self, make: Callable[[Key], Thing], unmake: Callable[[Thing], object]) -> None:
        self._make = make
        self._unmake = unmake
        self._things: dict[Key, tuple[Thing, int]] = {}

    def __len__(self) -> int:
        return len(self._things)

    def get(self, key: Key) -> Thing:
        """The thing of that key; every get has its :meth:`release`."""
        known = self._things.get(key)
        thing, users = known if known is not None else (self._make(key), 0)
        self._things[key] = thing, users + 1
        return thing

    def release(self, key: Key) -> None:
        """One user less."""
        thing, users = self._things.pop(key)
        if users > 1:
            self._things[key] = thing, users - 1
        else:
            self._unmake(thing)
