"""Values that the agent's owner writes, in files and on the command line: what they may be, and
what is said else.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any


class ConfigError(ValueError):
    """A rule that cannot be; the text says where, what, and what would be right."""


def only(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    for key in table:
        if key not in known:
            close = get_close_matches(key, known, 1, 0.6)
            hint = f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(known)}"
            raise ConfigError(f"{what} has no {key!r}{hint}")


def shown(value: Any) -> str:
    """A value of the file, as short as a line can bear."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no number of over 4300 digits
        return "a very long number"
    return text if len(text) <= 100 else f"{text[:100]}..."


def typed(text: str) -> int | str:
    """A value of the command line, where numbers are texts too."""
    # No longer ones: they are nothing that is meant, and Python refuses those of 4300 digits.
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else text


def listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def table_of(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(f"{what} is {shown(value)}, not a table such as {{ … = … }}")
    return value


def key_of(value: Any) -> int:
    """A client's key, as the log writes it or as a number."""
    if isinstance(value, str) and re.fullmatch(r"0[xX][0-9A-Fa-f]{1,8}", value):
        return int(value, 16)
    return whole(value, "key", 0, 0xFFFFFFFF, ' or a text such as "0x4B0CBE99"')


def whole(value: Any, what: str, low: int, high: int, also: str = "") -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(
            f"{what} is {shown(value)}, not a whole number from {low} to {high}{also}"
        )
    return value
