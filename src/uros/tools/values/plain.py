"""Converts messages to plain values and to CSV, as ``topic echo`` prints them.

The conversions are those of ROS 2's rosidl_runtime_py: a ``byte`` is a character, long values are
cut and end with ``...``, and arrays and strings that are left out are described.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Final

from ...printable import printable
from ..errors import did_you_mean
from .yaml_text import Value

_ARRAY: Final = re.compile(r"(?P<inner>.+)\[(?P<size>\d+)\]")
_SEQUENCE: Final = re.compile(r"sequence<(?P<inner>.+?)(?:, (?P<bound>\d+))?>")
_CODES: Final = {
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "double": "d",
}
_CUT: Final = "..."
_NUMBER: Final = r"(?:-?\d{1,9})?"
_INDEX: Final = rf"\[(?:-?\d{{1,9}}|{_NUMBER}(?::{_NUMBER}){{1,2}})\]"
_STEP: Final = re.compile(rf"(?P<name>[A-Za-z]\w*)(?P<indices>(?:{_INDEX})*)", re.ASCII)
# The structures of services, which no message has in a field but the events of introspection.
_SERVICE_PART: Final = re.compile(r"\w+?(?P<of_action>_SendGoal|_GetResult)?_(Request|Response)")


@dataclass(frozen=True)
class Show:
    """How to print.

    Attributes:
        truncate: The length to which strings and arrays are cut; None for no cut.
        no_arr: Whether arrays are left out.
        no_str: Whether strings are left out.
    """

    truncate: int | None = 128
    no_arr: bool = False
    no_str: bool = False


def plain(message: Any, show: Show) -> dict[str, Value]:
    """Return a message as nested dicts and lists of numbers and strings."""
    return {name: _plain(value, kind, show) for name, kind, value in fields(message)}


def fields(message: Any) -> list[tuple[str, str, Any]]:
    """Return ``(name, type, value)`` of each field, with the type as rclpy spells it."""
    return [
        (name, kind, getattr(message, slot))
        for (name, kind), slot in zip(message._FIELDS, message.__slots__, strict=True)
    ]


def _plain(value: Any, kind: str, show: Show) -> Value:
    inner = element(kind)
    if inner:
        if show.no_arr:
            return describe_array(kind, len(value))
        cut = show.truncate is not None and len(value) > show.truncate
        items: list[Value] = [_plain(item, inner, show) for item in value[: show.truncate]]
        return [*items, _CUT] if cut else items
    if kind == "octet":
        return _cut(chr(value), show)
    if isinstance(value, str):
        return describe_string(value) if show.no_str else _cut(value, show)
    if isinstance(value, (bool, int, float)):
        return value
    return plain(value, show)


@lru_cache(maxsize=1024)
def element(kind: str) -> str:
    """Return the type of an array's elements; empty for other types."""
    match = _ARRAY.fullmatch(kind) or _SEQUENCE.fullmatch(kind)
    return match["inner"] if match else ""


def describe_array(kind: str, length: int) -> str:
    """Return the text in place of an array that is left out."""
    match = _ARRAY.fullmatch(kind)
    if match:
        return f"<array type: {_type_name(match['inner'])}[{match['size']}]>"
    match = _SEQUENCE.fullmatch(kind)
    assert match, "only arrays are described"
    bound = f"[{match['bound']}]" if match["bound"] else ""
    return f"<sequence type: {_type_name(match['inner'])}{bound}, length: {length}>"


def _type_name(kind: str) -> str:
    package, slash, name = kind.partition("/")
    if not slash or "/" in name:
        return kind.partition("<")[0]
    service = _SERVICE_PART.fullmatch(name)
    folder = "msg" if service is None else "action" if service["of_action"] else "srv"
    return f"{package}/{folder}/{name}"


def describe_string(text: str) -> str:
    """Return the text in place of a string that is left out."""
    return f"<string length: <{len(text)}>>"


def _cut(text: str, show: Show) -> str:
    if show.truncate is None or len(text) <= show.truncate:
        return text
    return text[: show.truncate] + _CUT


# --- CSV ------------------------------------------------------------------------


def csv(message: Any, show: Show) -> str:
    """Return all values of a message, at any depth, separated by commas."""
    return ",".join([_csv(value, kind, show) for _name, kind, value in fields(message)])


def _csv(value: Any, kind: str, show: Show) -> str:
    inner = element(kind)
    if inner:
        if show.no_arr:
            return describe_array(kind, len(value))
        cells = [_csv(item, inner, show) for item in value[: show.truncate]]
        if show.truncate is not None and len(value) > show.truncate:
            cells.append(_CUT)
        return ",".join(cells)
    if kind == "octet":
        return str(bytes([value]))
    if isinstance(value, str):
        # One line a message, whatever is in its strings.
        return describe_string(value) if show.no_str else printable(_cut(value, show))
    if isinstance(value, (bool, int, float)):
        return str(value)
    return csv(value, show)


# --- one field --------------------------------------------------------------------


class FieldError(ValueError):
    """A message does not have a field. The text lists its fields."""


FieldPath = Sequence[str | int | slice]


def parse_path(text: str) -> FieldPath:
    """Return the steps of a path such as ``poses[0].position`` or ``ranges[2:5]``.

    Raises:
        ValueError: It is not a path.
    """
    path: list[str | int | slice] = []
    for part in filter(None, text.split(".")):
        match = _STEP.fullmatch(part)
        if match is None:
            raise ValueError(f"{part!r} is not a field, with an index such as [0] or [2:5]")
        path.append(match["name"])
        for inside in re.findall(r"[-\d:]+", match["indices"]):
            numbers = [int(number) if number else None for number in inside.split(":")]
            if 0 in numbers[2:]:
                raise ValueError(f"[{inside}] has a step of 0")
            path.append(slice(*numbers) if ":" in inside else int(inside))
    if not path:
        raise ValueError("it names no field")
    return path


def select(message: Any, path: FieldPath) -> tuple[Any, str]:
    """Return the value that a path leads to, and its type ("" for a message).

    The steps after a slice are taken in each of its elements; the value is then a list.

    Raises:
        FieldError: There is no such field, or no such element.
    """
    value, kind = message, ""
    for depth, step in enumerate(path):
        if not isinstance(step, str):
            value, kind = _element(value, kind, step, path_text(path[:depth]))
        elif is_message(value):
            value, kind = field(value, step), field_type(value, step)
        elif "/" in kind and isinstance(path[depth - 1], slice):
            found = [select(item, path[depth:]) for item in value]
            inner = found[0][1] if found else "elements"
            return [item for item, _ in found], f"sequence<{inner or 'messages'}>"
        else:
            raise FieldError(f"{path_text(path[:depth])} is a {kind}, which has no fields")
    return value, "" if is_message(value) else kind


def _element(value: Any, kind: str, index: int | slice, where: str) -> tuple[Any, str]:
    inner = element(kind)
    if not inner:
        raise FieldError(f"{where} is a {kind or value._TYPE}, which has no elements")
    if isinstance(index, slice):
        return value[index], f"sequence<{inner}>"
    try:
        return value[index], inner
    except IndexError:
        raise FieldError(f"{where} has {len(value)} elements, and so no [{index}]") from None


def path_text(path: FieldPath) -> str:
    """Return a path as it is written."""
    text = ""
    for step in path:
        if isinstance(step, str):
            text += f".{step}" if text else step
        elif isinstance(step, int):
            text += f"[{step}]"
        else:
            ends = [step.start, step.stop] + [step.step] * (step.step is not None)
            text += f"[{':'.join('' if end is None else str(end) for end in ends)}]"
    return text


@cache
def _slots(message_class: Any) -> dict[str, tuple[str, str]]:
    """Return the attribute and the type of each field."""
    return {
        name: (slot, kind)
        for (name, kind), slot in zip(message_class._FIELDS, message_class.__slots__, strict=True)
    }


def field(value: Any, name: str) -> Any:
    """Return the value of a field.

    Raises:
        FieldError: ``value`` is no message, or has no such field.
    """
    if not is_message(value):
        raise FieldError(f"a {type(value).__name__} has no field {name!r}")
    known = _slots(value.__class__)
    if name not in known:
        raise FieldError(
            f"{value._TYPE} has no field {name!r}; it has {', '.join(known) or 'none'}"
            f"{did_you_mean(name, known)}"
        )
    return getattr(value, known[name][0])


def field_type(message: Any, name: str) -> str:
    """Return the type of a field that the message has."""
    return _slots(message.__class__)[name][1]


def is_message(value: Any) -> bool:
    """Return whether a value is a message, or a message class."""
    return hasattr(value, "_FIELDS")


def text(value: Any, kind: str) -> str:
    """Return a single value as rclpy prints it. Line ends and tabs of a string stay."""
    if kind == "octet":
        return str(bytes([value]))
    match = _SEQUENCE.fullmatch(kind)
    if match and match["inner"] in _CODES:
        return str(array(_CODES[match["inner"]], value))
    return printable(_constructed(value, kind) if element(kind) else str(value), "\n\t")


def constructed(message: Any) -> str:
    """Return the message as rclpy's ``repr`` prints it, but without numpy's name for arrays."""
    parts = [f"{name}={_constructed(value, kind)}" for name, kind, value in fields(message)]
    return f"{message._TYPE.replace('/', '.')}({', '.join(parts)})"


def _constructed(value: Any, kind: str) -> str:
    inner = element(kind)
    if inner:
        return "[" + ", ".join([_constructed(item, inner) for item in value]) + "]"
    if kind == "octet":
        return repr(bytes([value]) if isinstance(value, int) else bytes(value))
    return constructed(value) if is_message(value) else repr(value)
