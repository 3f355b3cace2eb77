"""Sizes, alignment and struct codes of fields, for the generator. Host only."""

from __future__ import annotations

from functools import cache
from typing import Final

from . import registry
from .parse import Message, Type

CODES: Final = {
    "bool": ("B", 1),
    "byte": ("B", 1),
    "char": ("B", 1),
    "uint8": ("B", 1),
    "int8": ("b", 1),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float32": ("f", 4),
    "float64": ("d", 8),
}
"""Struct code and size in octets of every number type."""

INLINE_LEAVES: Final = 128
"""Largest number of fields in a nested message that is inlined: limits the size of the code."""


def is_octets(type_: Type) -> bool:
    """Whether the value is bytes: an array of unsigned octets."""
    return bool(type_.array) and type_.name in ("uint8", "byte", "char")


@cache
def leaves(message: Message) -> int:
    """Return the number of fields with all single nested messages inlined."""
    count = 0
    for field in message.fields:
        if field.type.primitive or field.type.array:
            count += 1
        else:
            count += leaves(registry.message(field.type.name))
    return max(count, 1)


@cache
def first_alignment(message: Message) -> int:
    """Return the alignment of the first value on the wire."""
    if not message.fields:
        return 1
    type_ = message.fields[0].type
    if type_.array in ("bounded", "unbounded") or type_.name in ("string", "wstring"):
        return 4
    if type_.primitive:
        return CODES[type_.name][1]
    return first_alignment(registry.message(type_.name))


@cache
def fixed_size(message: Message) -> tuple[int, int] | None:
    """Return (octets, alignment) of a message of fixed size, of which arrays have no padding.

    None if the size varies, or depends on the offset at which the message starts.
    """
    size, widest = 0, 1
    for field in message.fields:
        type_ = field.type
        if type_.array in ("bounded", "unbounded") or type_.name in ("string", "wstring"):
            return None
        if type_.primitive:
            octets, alignment = CODES[type_.name][1], CODES[type_.name][1]
        else:
            inner = fixed_size(registry.message(type_.name))
            if inner is None:
                return None
            octets, alignment = inner
        size = -(-size // alignment) * alignment + octets * (type_.size if type_.array else 1)
        widest = max(widest, alignment)
    size = size or 1
    if first_alignment(message) != widest or size % widest:
        return None
    return size, widest


@cache
def least_size(message: Message) -> int:
    """Return the fewest octets the message can have on the wire; never 0."""
    size = 0
    for field in message.fields:
        type_ = field.type
        if type_.array in ("bounded", "unbounded"):
            size += 4
            continue
        if type_.name in ("string", "wstring"):
            octets = 4
        elif type_.primitive:
            octets = CODES[type_.name][1]
        else:
            octets = least_size(registry.message(type_.name))
        size += octets * (type_.size if type_.array else 1)
    return size or 1


class Alignment:
    """The known part of the offset from the payload's start: ``rest`` modulo ``modulus``."""

    def __init__(self) -> None:
        self.modulus = 1
        self.rest = 0

    def know(self, modulus: int) -> None:
        """Set the offset to an unknown multiple of ``modulus``."""
        self.modulus = modulus
        self.rest = 0

    def advance(self, octets: int) -> None:
        """Move the offset on by a known number of octets."""
        self.rest = (self.rest + octets) % self.modulus

    def padding(self, alignment: int) -> int | None:
        """Return the octets up to the next multiple, or None if known only at run time."""
        if alignment > self.modulus:
            return None
        return -self.rest % alignment


_TAKEN: Final = {"_Message", "_array", "_Doubles", "_Row"}


class Aliases:
    """The names of nested classes in a generated module.

    ``local`` has the classes that the module defines itself; all others are imported.
    """

    def __init__(self, local: dict[str, str] | None = None) -> None:
        self.names: dict[str, str] = dict(local or {})

    def __getitem__(self, type_name: str) -> str:
        if type_name not in self.names:
            package, _, plain = type_name.split("/")
            alias = "_" + plain
            if alias in self.names.values() or alias in _TAKEN:
                alias = f"_{package}__{plain}"
            self.names[type_name] = alias
        return self.names[type_name]
