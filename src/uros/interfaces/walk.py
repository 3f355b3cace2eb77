"""What all who write a class's codec methods share, see `emit` and `emit_board`. Host only."""

from __future__ import annotations

from collections.abc import Callable

from .layout import Aliases, Alignment
from .parse import Message, Type

Attribute = Callable[[str], str]
"""A field's name in the class, by that in the definition."""


class Run:
    """A method's lines so far, and behind them a run: values whose places are known from its start,
    gathered until `flush` writes them down as one.
    """

    def __init__(self, aliases: Aliases) -> None:
        self.aliases = aliases
        self.lines: list[str] = []
        self.at = Alignment()
        self.names = 0
        self.codes: list[str] = []  # of struct
        self.octets = 0

    def name(self, letter: str) -> str:
        self.names += 1
        return f"{letter}{self.names}"

    def local(self, letter: str, expression: str) -> str:
        var = self.name(letter)
        self.lines.append(f"{var} = {expression}")
        return var

    def flush(self) -> None:
        """Write down what the run has gathered."""
        raise NotImplementedError

    def pad(self, alignment: int) -> None:
        """Align at run time."""
        raise NotImplementedError

    def align(self, alignment: int) -> None:
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
        """Take room in the run; gives its place, from the run's start."""
        self.align(alignment)
        place = self.octets
        self.codes += codes
        self.octets += octets
        self.at.advance(octets)
        return place


class Walker(Run):
    """Goes over a message's fields, one after the other, each by the path that leads to it."""

    def __init__(self, attribute: Attribute, aliases: Aliases) -> None:
        super().__init__(aliases)
        self.attribute = attribute

    def walk(self, message: Message, path: str) -> None:
        for field in message.fields:
            self.value(field.type, f"{path}.{self.attribute(field.name)}")
        if not message.fields:
            self.nothing()

    def value(self, type_: Type, path: str) -> None:
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
        """The one octet of a message without fields."""
        raise NotImplementedError

    def fixed(self, type_: Type, path: str) -> None:
        """An array whose length the type says."""
        raise NotImplementedError

    def sequence(self, type_: Type, path: str) -> None:
        """An array whose length stands before it."""
        raise NotImplementedError

    def text(self, type_: Type, path: str) -> None:
        raise NotImplementedError

    def number(self, name: str, path: str) -> None:
        raise NotImplementedError

    def nested(self, type_: Type, path: str) -> None:
        raise NotImplementedError
