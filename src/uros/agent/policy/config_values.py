"""Checks values of rule files and of the command line, with errors that have the remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any


class ConfigError(ValueError):
    """A value is invalid; the text has its place, the value, and what is allowed.

    Attributes:
        key: The key that should not be there; None if the fault is another.
    """

    def __init__(self, text: str, key: str | None = None) -> None:
        super().__init__(text)
        self.key = key


def only(table: Mapping[str, Any], names: tuple[str, ...], about: str) -> None:
    """Raise ConfigError, which names ``about``, if ``table`` has a key that is not in ``names``."""
    for key in table:
        if key not in names:
            close = get_close_matches(key, names, 1, 0.6)
            hint = f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(names)}"
            raise ConfigError(f"{about} has no {key!r}{hint}", key)


def shown(value: Any) -> str:
    """Return a value as text, short enough for a line of the log."""
    try:
        text = repr(value)
    except ValueError:  # Python converts no number of over 4300 digits
        return "a very long number"
    return text if len(text) <= 100 else f"{text[:100]}..."


def typed(text: str) -> int | str:
    """Convert a value of the command line: decimal numbers to int."""
    # Longer numbers are never valid, and Python refuses those of over 4300 digits.
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else text


def listed(value: Any) -> list[Any]:
    """Return a list as it is, another value as the only one of a list."""
    return value if isinstance(value, list) else [value]


def table_of(value: Any, about: str) -> dict[str, Any]:
    """Return a table; raises ConfigError for another value."""
    if not isinstance(value, dict):
        raise ConfigError(f"{about} is {shown(value)}, not a table such as {{ … = … }}")
    return value


def key_of(value: Any) -> int:
    """Return a client key that is written as in the log or as a number; raises ConfigError."""
    if isinstance(value, str) and re.fullmatch(r"0[xX][0-9A-Fa-f]{1,8}", value):
        return int(value, 16)
    return whole(value, "key", 0, 0xFFFFFFFF, ' or a text such as "0x4B0CBE99"')


def whole(value: Any, about: str, low: int, high: int, also: str = "") -> int:
    """Return a whole number from ``low`` to ``high``; raises ConfigError for another value.

    ``also`` names other values that are allowed, for the text of the error.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(
            f"{about} is {shown(value)}, not a whole number from {low} to {high}{also}"
        )
    return value
