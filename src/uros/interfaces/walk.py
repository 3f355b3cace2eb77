"""Base of the emitters of a class's codec methods, see `emit` and `emit_board`. Host only."""

from __future__ import annotations

from collections.abc import Callable

from .layout import Aliases, Alignment
from .parse import Message, Type

Attribute = Callable[[str], str]
"""Returns a field's name in the class for its name in the definition."""


class Run:
    """A method's lines so far, and the current run.

    A run is a row of values at known offsets from its start, which `flush` writes by one call.
    """

    def __init__(self, aliases: Aliases) -> None:
        self.aliases = aliases
        self.lines: list[str] = []
        self.at = Alignment()
        self.names = 0
        self.codes: list[str] = []  # of struct
        self.octets = 0

    def name(self, letter: str) -> str:
        """Return a new variable name that begins with ``letter``."""
        self.names += 1
        return f"{letter}{self.names}"

    def local(self, letter: str, expression: str) -> str:
        """Write the assignment of an expression to a new variable; returns its name."""
        var = self.name(letter)
        self.lines.append(f"{var} = {expression}")
        return var

    def flush(self) -> None:
        """Write the current run."""
        raise NotImplementedError

    def pad(self, alignment: int) -> None:
        """Align at run time."""
        raise NotImplementedError

    def align(self, alignment: int) -> None:
        """Align the run: by padding where the offset is known, else at run time."""
        padding = self.at.padding(alignment)
        if padding is None:
            self.flush()
            self.pad(alignment)
            self.at.know(alignment)
            return
        self.codes += ["x"] * padding
        self.octets += padding
        self.at.advance(padding)

    def advance(self, codes: list[str], octets: int, alignment: int) -> int:
        """Reserve octets in the run; returns their offset from the run's start."""
        self.align(alignment)
        place = self.octets
        self.codes += codes
        self.octets += octets
        self.at.advance(octets)
        return place


class Walker(Run):
    """Visits a message's fields in order, each with its path such as ``self.pose.position``."""

    def __init__(self, attribute: Attribute, aliases: Aliases) -> None:
        super().__init__(aliases)
        self.attribute = attribute

    def walk(self, message: Message, path: str) -> None:
        """Write the code of all fields of the message at ``path``."""
        for field in message.fields:
            self.value(field.type, f"{path}.{self.attribute(field.name)}")
        if not message.fields:
            self.nothing()

    def value(self, type_: Type, path: str) -> None:
        """Write the code of one field, by the method for its type."""
        if type_.array == "fixed":
            self.fixed(type_, path)
        elif type_.array:
            self.sequence(type_, path)
        elif type_.name in ("string", "wstring"):
            self.text(type_, path)
        elif type_.primitive:
            self.number(type_.name, path)
        else:
            self.nested(type_, path)

    def nothing(self) -> None:
        """Write the code of the one octet of a message without fields."""
        raise NotImplementedError

    def fixed(self, type_: Type, path: str) -> None:
        """Write the code of a fixed array."""
        raise NotImplementedError

    def sequence(self, type_: Type, path: str) -> None:
        """Write the code of a sequence, whose length comes first."""
        raise NotImplementedError

    def text(self, type_: Type, path: str) -> None:
        """Write the code of a string or wstring."""
        raise NotImplementedError

    def number(self, name: str, path: str) -> None:
        """Write the code of a number or bool."""
        raise NotImplementedError

    def nested(self, type_: Type, path: str) -> None:
        """Write the code of a nested message."""
        raise NotImplementedError
