"""Fills messages with values in YAML, as ``ros2 topic pub`` does.

The type of a field decides what a value means: ``1`` is true for a bool and text for a string, and
``yes`` is text for a string, where ros2 would send ``True``. A value that does not fit is refused
with the field's name, and never rounded or cut.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any, Final

from ..errors import ToolError, did_you_mean
from . import plain
from .yaml_read import Node, Plain, YamlError, read, read_all, resolve

_RANGES: Final = {
    "octet": (0, 0xFF),
    "int8": (-0x80, 0x7F),
    "uint8": (0, 0xFF),
    "int16": (-0x8000, 0x7FFF),
    "uint16": (0, 0xFFFF),
    "int32": (-0x80000000, 0x7FFFFFFF),
    "uint32": (0, 0xFFFFFFFF),
    "int64": (-(1 << 63), (1 << 63) - 1),
    "uint64": (0, (1 << 64) - 1),
}
_HEADER: Final = "std_msgs/Header"
_TIME: Final = "builtin_interfaces/Time"
_SIZE: Final = re.compile(r".+\[(\d+)\]")
_BOUND: Final = re.compile(r"sequence<.+, (\d+)>")
# A field and its value without the blank between them, which YAML takes for one text.
_GLUED: Final = re.compile(r"(\w+):\S")
_MOST_SHOWN: Final = 40


class Filled:
    """A message filled with the values of a YAML text.

    Args:
        message_class: The message's class.
        text: The values; empty for the defaults.

    Raises:
        ToolError: The text is not YAML, or does not fit the message.
    """

    def __init__(self, message_class: Any, text: str) -> None:
        try:
            node = read(text)
        except YamlError as error:
            raise ToolError(f"the values are not YAML: {error}") from error
        self._set(message_class, node)

    @classmethod
    def each(cls, message_class: Any, text: str) -> list[Filled]:
        """Return a filled message for each document of a YAML text, without the empty ones.

        Raises:
            ToolError: The text is not YAML, or a document does not fit the message.
        """
        try:
            nodes = read_all(text)
        except YamlError as error:
            raise ToolError(f"this is not YAML: {error}") from error
        messages = []
        for number, node in enumerate(nodes, 1):
            filled = cls.__new__(cls)
            try:
                filled._set(message_class, node)
            except ToolError as error:
                raise ToolError(f"message {number}: {error}") from error
            messages.append(filled)
        return messages

    def _set(self, message_class: Any, node: Node) -> None:
        self.message = message_class()
        self._stamps: list[Any] = []
        if isinstance(node, Plain) and not node:
            node = {}
        if not isinstance(node, dict):
            fields = plain.fields(self.message)
            glued = _GLUED.match(node) if isinstance(node, Plain) else None
            if glued and glued[1] in [name for name, _kind, _value in fields]:
                raise ToolError(
                    f"{message_class._TYPE}: a blank is missing behind the colon of {_shown(node)};"
                    f" write '{glued[1]}: ...'"
                )
            example = f"{{{fields[0][0]}: ...}}" if fields else "{}"
            raise ToolError(
                f"{message_class._TYPE}: the values are fields by name, such as {example}, not"
                f" {_shown(node)}"
            )
        self._fill(self.message, node, message_class._TYPE)

    def stamp(self, nanoseconds: int) -> None:
        """Set the fields whose value is ``now`` or ``auto`` to a time since 1970."""
        for stamp in self._stamps:
            stamp.sec, stamp.nanosec = divmod(nanoseconds, 1_000_000_000)

    def _fill(self, message: Any, node: dict[str, Node], where: str) -> None:
        known = {
            name: (slot, kind, getattr(message, slot))
            for (name, kind), slot in zip(message._FIELDS, message.__slots__, strict=True)
        }
        for name, value in node.items():
            if name not in known:
                raise ToolError(
                    f"{where} has no field {name!r}; it has {', '.join(known) or 'none'}"
                    f"{did_you_mean(name, known)}"
                )
            slot, kind, now = known[name]
            setattr(message, slot, self._value(value, kind, now, f"{where}.{name}"))

    def _value(self, node: Node, kind: str, now: Any, where: str) -> Any:
        """Convert a value for a field of type ``kind``. ``now`` is the field's present value."""
        inner = plain.element(kind)
        if inner:
            return self._items(node, kind, inner, where)
        if kind in _RANGES:
            return _whole(node, kind, where)
        if kind == "boolean":
            return _bool(node, where)
        if kind in ("float", "double"):
            return _real(node, kind, where)
        if kind.startswith(("string", "wstring")):
            return _text(node, kind, where)
        if kind == _HEADER and node == "auto":
            self._stamps.append(now.stamp)
        elif kind == _TIME and node == "now":
            self._stamps.append(now)
        elif isinstance(node, dict):
            self._fill(now, node, where)
        else:
            also = {_HEADER: ", or auto", _TIME: ", or now"}.get(kind, "")
            names = ", ".join(name for name, _kind, _value in plain.fields(now))
            raise _wrong(where, f"{kind} in braces ({names}){also}", node)
        return now

    def _items(self, node: Node, kind: str, inner: str, where: str) -> Any:
        if not isinstance(node, list):
            raise _wrong(where, f"a list in brackets ({kind})", node)
        size, bound = _SIZE.fullmatch(kind), _BOUND.fullmatch(kind)
        if size and len(node) != int(size[1]):
            raise ToolError(f"{where} takes {size[1]} elements ({kind}), not {len(node)}")
        if bound and len(node) > int(bound[1]):
            raise ToolError(f"{where} takes at most {bound[1]} elements, not {len(node)}")
        make = _maker(inner)
        return [
            self._value(item, inner, make(), f"{where}[{number}]")
            for number, item in enumerate(node)
        ]


def _maker(kind: str) -> Callable[[], Any]:
    """Return what makes a nested message of this kind, or None for other kinds."""
    if "/" not in kind:
        return lambda: None
    from ...interfaces import load

    made: Callable[[], Any] = load(kind)
    return made


# --- scalars --------------------------------------------------------------------------------


def _resolved(node: Node) -> None | bool | int | float | str | Node:
    """Resolve quoted values too, as ros2 does."""
    return resolve(node) if isinstance(node, str) else node


def _bool(node: Node, where: str) -> bool:
    value = _resolved(node)
    if isinstance(value, bool):
        return value
    if isinstance(value, int) and value in (0, 1):
        return value == 1
    raise _wrong(where, "true or false, 1 or 0 (bool)", node)


def _whole(node: Node, kind: str, where: str) -> int:
    value = _resolved(node)
    if kind == "octet" and isinstance(node, str) and len(node) == 1 and ord(node) <= 0xFF:
        if isinstance(value, str) or not isinstance(node, Plain):  # as `topic echo` prints it
            return ord(node)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    low, high = _RANGES[kind]
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        name = "byte" if kind == "octet" else kind
        raise _wrong(where, f"a whole number from {low} to {high} ({name})", node)
    return value


def _real(node: Node, kind: str, where: str) -> float:
    value = _resolved(node)
    if isinstance(value, str):  # 1e-3, which is not a number in YAML 1.1
        try:
            value = float(value)
        except ValueError:
            pass
    name = "float32" if kind == "float" else "float64"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _wrong(where, f"a number ({name})", node)
    try:
        struct.pack("<f" if kind == "float" else "<d", value)
        return float(value)
    except OverflowError:
        raise _wrong(where, f"a number that a {name} can hold", node) from None


def _text(node: Node, kind: str, where: str) -> str:
    if not isinstance(node, str):
        raise _wrong(where, f"text ({kind}), in quotes where it holds any of {{}}[],:#", node)
    text = str(node)
    if "\0" in text:
        raise ToolError(f"{where}: text cannot hold a NUL, which ends it")
    bound = kind[kind.find("<") + 1 : -1] if kind.endswith(">") else ""
    length = len(text.encode("utf-16-le")) // 2 if kind.startswith("w") else len(text.encode())
    if bound and length > int(bound):
        raise ToolError(f"{where} takes text of at most {bound} ({kind}), not {length}")
    return text


def _wrong(where: str, takes: str, node: Node) -> ToolError:
    return ToolError(f"{where} takes {takes}, not {_shown(node)}")


def _shown(node: Node) -> str:
    """Return the value roughly as it was written."""
    if isinstance(node, Plain):
        text = str(node) or "nothing"
    elif isinstance(node, list):
        text = "[" + ", ".join(map(_shown, node[:_MOST_SHOWN])) + "]"
    elif isinstance(node, dict):
        text = "{" + ", ".join(f"{key}: {_shown(value)}" for key, value in node.items()) + "}"
    else:
        text = repr(node)
    return text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
