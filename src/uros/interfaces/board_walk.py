"""Common base of packing and loading a board's messages, see `emit_board`. Host only."""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

from . import registry
from .layout import Aliases, is_octets
from .parse import Message
from .walk import Attribute, Walker

HALVES: Final = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
"""Types with ``sec`` in two halves: the seconds since 1970 are no small integer on a board."""
INLINE_CHUNKS: Final = 12
"""Largest number of values and arrays in a nested message that is inlined."""


def is_doubles(message: Message) -> bool:
    """Whether the message is x, y, z and perhaps w, so that its class is a `compact.Doubles`."""
    names = "".join(f.name for f in message.fields)
    plain = all(f.type.name == "float64" and not f.type.array for f in message.fields)
    return plain and names in ("xyz", "xyzw")


@cache
def chunks(message: Message) -> int:
    """Count the numbers and arrays of a message, nested ones too; 1000 or more if a size varies."""
    if is_doubles(message):
        return 1
    count = 0
    for field in message.fields:
        type_ = field.type
        if type_.name in ("string", "wstring") or type_.array in ("bounded", "unbounded"):
            return 1000
        if not type_.primitive:
            count += 1000 if type_.array else chunks(registry.message(type_.name))
        elif type_.array and type_.name != "float64" and not is_octets(type_):
            return 1000
        else:
            count += 1
    return count or 1000


def in_place(name: str) -> Message | None:
    """Return the nested message if it is written and read with its holder, else None."""
    nested = registry.message(name)
    return nested if chunks(nested) <= INLINE_CHUNKS else None


def calls(message: Message) -> list[tuple[str, bool]]:
    """Return the types whose methods this message's call, each with whether an array holds it."""
    called: list[tuple[str, bool]] = []
    for field in message.fields:
        type_ = field.type
        if type_.primitive:
            continue
        if type_.array or in_place(type_.name) is None:
            called.append((type_.name, bool(type_.array)))
        else:
            called += calls(registry.message(type_.name))
    return called


class Names(NamedTuple):
    """The first lines of the methods, and the names of nested messages' methods."""

    size: str = "_size"
    pack: str = "_pack"
    size_head: str = "def _size(self, o):"
    pack_head: str = "def _pack(self, buf, o, start):"
    tell: str = ""
    """The arguments of errors that the methods raise."""
    once: frozenset[str] = frozenset()
    """Types nested at one place only: their code is inlined there."""
    lean: bool = False
    """Big-endian data counts as malformed; `InterfaceError` is ValueError."""


PUBLIC: Final = Names(
    "cdr_size",
    "pack_into",
    "def cdr_size(self, o=0):",
    "def pack_into(self, buf, o, start):",
    "(self._TYPE)",
    lean=True,
)
"""For classes without a base class that has the public methods."""


class BoardWalker(Walker):
    """Base of packing and loading."""

    def __init__(self, attribute: Attribute, aliases: Aliases, calls: Names) -> None:
        super().__init__(attribute, aliases)
        self.calls = calls

    def in_place(self, name: str) -> Message | None:
        """Return the nested message if it is written and read with its holder, else None."""
        return registry.message(name) if name in self.calls.once else in_place(name)
