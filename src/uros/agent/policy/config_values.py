"""Checks values of rule files and of the command line, with errors that have the remedy."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any


class ConfigError(ValueError):
    """Values are invalid; the text is about the first: its place, the value, and what is allowed.

    Attributes:
        place: The way to the value in its table: keys, and indexes of arrays of tables.
        others: The further faults that were found.

    Args:
        text: What is wrong, and the remedy.
        place: The way to the value.
    """

    def __init__(self, text: str, *place: str | int) -> None:
        super().__init__(text)
        self.place = place
        self.others: list[ConfigError] = []

    @property
    def faults(self) -> list[ConfigError]:
        """All faults that were found, this one first."""
        return [self, *self.others]

    @property
    def all_faults(self) -> str:
        """The texts of all faults in one line."""
        return "; ".join(map(str, self.faults))


class Faults(list[ConfigError]):
    """Collects the faults of several values, so that one error has them all."""

    @contextmanager
    def at(self, *place: str | int, about: str = "") -> Iterator[None]:
        """Collect the faults that end the block.

        Args:
            place: The way to the value that the block reads; it goes before the places of faults.
            about: What has the value; it goes before the texts of faults.
        """
        try:
            yield
        except ConfigError as error:
            for fault in error.faults:
                text = f"{about}: {fault}" if about else str(fault)
                self.append(ConfigError(text, *place, *fault.place))

    def check(self) -> None:
        """Raise ConfigError if there are faults: the first one, with the others in it."""
        if self:
            first = self[0]
            first.others = self[1:]
            raise first


@contextmanager
def faults_of(about: str) -> Iterator[None]:
    """Put ``about``, what has the values, before the texts of all faults that end the block."""
    faults = Faults()
    with faults.at(about=about):
        yield
    faults.check()


def only(table: Mapping[str, Any], names: tuple[str, ...], about: str) -> None:
    """Raise ConfigError, which names ``about``, if ``table`` has keys that are not in ``names``."""
    faults = Faults()
    for key in table:
        if key not in names:
            close = get_close_matches(key, names, 1, 0.6)
            hint = f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(names)}"
            faults.append(ConfigError(f"{about} has no {key!r}{hint}", key))
    faults.check()


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
    if isinstance(value, str) and re.fullmatch(r"[0-9A-Fa-f]{8}", value):
        raise ConfigError(f'key is {shown(value)}; did you mean "0x{value}"?')
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
