"""Finds the number in a message that a path names, such as ``pose/position/x`` or ``cells[0]``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

from ..errors import ToolError, did_you_mean
from ..values import plain

_PART: Final = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)")
_NUMBERS: Final = {
    "boolean", "octet", "float", "double", "int8", "uint8", "int16", "uint16", "int32", "uint32",
    "int64", "uint64",
}  # fmt: skip
# Fields that an error names at most, and how deep they are looked for.
_MOST: Final = 12
_DEPTH: Final = 4


def getter(message_class: Any, path: str) -> Callable[[Any], float | None]:
    """Return a function that takes a number out of a message.

    It returns None where a sequence is too short.

    Args:
        message_class: The message's class.
        path: Fields, separated by ``/`` or ``.``, with indexes.

    Raises:
        ToolError: The path names no number; the text names the fields that can be plotted.
    """
    steps: list[Callable[[Any], Any]] = []
    kind, seen = message_class, ""
    for part in re.split(r"[/.]", path):
        match = _PART.fullmatch(part)
        known = _fields(kind)
        if match is None or match[1] not in known:
            close = did_you_mean(part.partition("[")[0], known)
            where = seen or message_class._TYPE
            raise ToolError(f"{where} has no field {part!r}{close or _there(message_class)}")
        kind, slot = known[match[1]]
        seen += f"/{part}" if seen else part
        steps.append(lambda value, slot=slot: getattr(value, slot))  # type: ignore[misc]
        for index in re.findall(r"\d+", match[2]):
            inner = plain.element(kind) if isinstance(kind, str) else ""
            if not inner:
                raise ToolError(f"{seen} has one index too many{_there(message_class)}")
            kind = inner
            steps.append(lambda value, at=int(index): value[at])  # type: ignore[misc]
    if isinstance(kind, str) and plain.element(kind):
        raise ToolError(f"{seen} is an array: name one of its numbers, such as {seen}[0]")
    if kind not in _NUMBERS:
        raise ToolError(f"{seen} is no number{_there(message_class)}")

    def get(message: Any) -> float | None:
        value = message
        try:
            for step in steps:
                value = step(value)
        except IndexError:
            return None
        return float(value)

    return get


def _fields(kind: Any) -> dict[str, tuple[str, str]]:
    """Return the type and the attribute of each field of a message; none of other types."""
    from ...interfaces import load

    if isinstance(kind, str):
        if kind in _NUMBERS or "/" not in kind or plain.element(kind):
            return {}
        kind = load(kind)
    return {
        name: (type_, slot)
        for (name, type_), slot in zip(kind._FIELDS, kind.__slots__, strict=True)
    }


def numbers(kind: Any, before: str = "", depth: int = _DEPTH) -> Iterator[str]:
    """Yield the paths of a message that can be plotted."""
    for name, (type_, _) in _fields(kind).items():
        path = f"{before}{name}"
        inner = plain.element(type_)
        if type_ in _NUMBERS:
            yield path
        elif inner in _NUMBERS:
            yield f"{path}[0]"
        elif depth and not inner:
            yield from numbers(type_, f"{path}/", depth - 1)


def _there(message_class: Any) -> str:
    some = list(numbers(message_class))
    if not some:
        return f"; {message_class._TYPE} has no numbers"
    more = " …" if len(some) > _MOST else ""
    return f"; numbers of {message_class._TYPE}: {', '.join(some[:_MOST])}{more}"
