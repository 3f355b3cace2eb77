"""Values that several users share, created for the first user and destroyed after the last."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


class RefCounted(Generic[Key, Value]):
    """A reference-counted table.

    Args:
        create: Returns the value of a key for its first user.
        destroy: Called with the value when its last user has released it.
    """

    def __init__(self, create: Callable[[Key], Value], destroy: Callable[[Value], object]) -> None:
        self._create = create
        self._destroy = destroy
        self._values: dict[Key, tuple[Value, int]] = {}  # value, number of users

    def __len__(self) -> int:
        return len(self._values)

    def acquire(self, key: Key) -> Value:
        """Return the value of a key; each call needs one :meth:`release`."""
        entry = self._values.get(key)
        value, users = entry if entry is not None else (self._create(key), 0)
        self._values[key] = value, users + 1
        return value

    def release(self, key: Key) -> None:
        """Give back one reference."""
        value, users = self._values.pop(key)
        if users > 1:
            self._values[key] = value, users - 1
        else:
            self._destroy(value)
