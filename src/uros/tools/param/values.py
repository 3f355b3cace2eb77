"""Values of parameters: from YAML, as messages, and as text.

What YAML means is for ``uros param set`` as for ``ros2 param set``: YAML 1.1 in PyYAML's reading,
and text for what no parameter can have. A file is read more strictly: what does not fit is refused,
and a string in quotes stays one.
"""

from __future__ import annotations

import base64
import binascii
import math
from typing import Any, Final, NamedTuple

from ...client.parameter import ParameterType, fit, kind_name, kind_of
from ...printable import printable
from ..errors import ToolError
from ..values.yaml_read import YamlError, compose, construct, fault_at

BINARY: Final = "tag:yaml.org,2002:binary"
# As ros2 names the types, by number.
TYPE_NAMES: Final = (
    "not set", "boolean", "integer", "double", "string",
    "byte array", "boolean array", "integer array", "double array", "string array",
)  # fmt: skip
_LABELS: Final = (
    "Parameter not set.", "Boolean value is:", "Integer value is:", "Double value is:",
    "String value is:", "Byte values are:", "Boolean values are:", "Integer values are:",
    "Double values are:", "String values are:",
)  # fmt: skip
_ARRAYS: Final = (
    (ParameterType.BOOL_ARRAY, bool),
    (ParameterType.INTEGER_ARRAY, int),
    (ParameterType.DOUBLE_ARRAY, float),
    (ParameterType.STRING_ARRAY, str),
)


class Typed(NamedTuple):
    """A value and the number of its type."""

    kind: int
    value: Any


# --- from YAML ----------------------------------------------------------------------------------


def from_text(text: str) -> Typed:
    """Return the value that a text on the command line means.

    Raises:
        ToolError: A number does not fit 64 bits, or the text cannot be sent.
    """
    try:
        node = compose(text, BINARY)
        typed = None if node is None else _typed(node)
    except YamlError:  # as ros2, which takes this for text
        typed = None
    if typed is None or typed.kind == ParameterType.NOT_SET:
        typed = Typed(ParameterType.STRING, text)
    return _fitted(typed)


def from_node(node: Any) -> Typed:
    """Return the value of a composed YAML node.

    Raises:
        YamlError: No parameter can have it; says where it stands, and what is expected.
    """
    typed = _typed(node)
    if typed is None:
        kinds = [type(construct(item)) if item.id == "scalar" else None for item in node.value]
        odd = next((o for o, k in zip(node.value, kinds, strict=True) if k != kinds[0]), node)
        raise fault_at(
            odd if kinds[0] in (bool, int, float, str) else node,
            "a list takes bools, integers, doubles (1.0 in place of 1) or strings, all of one kind",
        )
    try:
        return _fitted(typed)
    except ToolError as error:
        raise fault_at(node, str(error)) from None


def _typed(node: Any) -> Typed | None:
    """Return the value of a node; None for a list of several kinds, and for a mapping."""
    if node.id == "scalar":
        value = _octets(node) if node.tag == BINARY else construct(node)
        return Typed(kind_of(value), value)
    if node.id == "mapping":
        return None
    if node.value and all(item.tag == BINARY for item in node.value):
        return Typed(ParameterType.BYTE_ARRAY, b"".join(map(_octets, node.value)))
    values: list[Any] = [construct(item) if item.id == "scalar" else None for item in node.value]
    for kind, python in _ARRAYS:
        if all(isinstance(value, python) for value in values):
            return Typed(kind, [python(value) for value in values])  # an int of a bool, too
    return None


def _octets(node: Any) -> bytes:
    try:
        return base64.b64decode("".join(node.value.split()), validate=True)
    except (binascii.Error, ValueError):
        raise fault_at(node, "!!binary takes base64, such as !!binary AA==") from None


def _fitted(typed: Typed) -> Typed:
    """Return the value as a message takes it."""
    texts = [typed.value] if typed.kind == ParameterType.STRING else typed.value
    if typed.kind in (ParameterType.STRING, ParameterType.STRING_ARRAY):
        if any("\0" in text for text in texts):
            raise ToolError("text cannot hold a NUL, which ends it")
    try:
        return Typed(typed.kind + 0, fit(typed.value, typed.kind))
    except UnicodeEncodeError:
        raise ToolError("the value is not text in UTF-8") from None
    except ValueError as error:
        raise ToolError(str(error)) from None


def as_declared(typed: Typed, declared: int) -> Typed:
    """Return the value with the declared type of its parameter if it has no type: an empty list."""
    if not typed.value and typed.kind == ParameterType.BOOL_ARRAY and declared in range(5, 10):
        return Typed(declared, fit([], declared))
    return typed


# --- messages -----------------------------------------------------------------------------------


def to_message(typed: Typed) -> Any:
    """Return a ``rcl_interfaces/msg/ParameterValue``."""
    from ...interfaces import load

    message = load("rcl_interfaces/msg/ParameterValue")(type=typed.kind)
    if typed.kind:
        setattr(message, _field(typed.kind), typed.value)
    return message


def from_message(message: Any) -> Typed:
    """Return the value of a ``rcl_interfaces/msg/ParameterValue``.

    Raises:
        ToolError: It has an unknown type.
    """
    kind = message.type
    if kind >= len(TYPE_NAMES):
        raise ToolError(f"a parameter has the unknown type {kind}; is its node of a newer ROS?")
    value: Any = getattr(message, _field(kind)) if kind else None
    if kind == ParameterType.BYTE_ARRAY:
        return Typed(kind, bytes(value))
    return Typed(kind, list(value) if kind > ParameterType.BYTE_ARRAY else value)


def _field(kind: int) -> str:
    return kind_name(kind).lower() + "_value"


def type_name(kind: int) -> str:
    """Return the name of a type, such as ``double``."""
    return TYPE_NAMES[kind] if kind < len(TYPE_NAMES) else f"unknown type {kind}"


# --- text ---------------------------------------------------------------------------------------


def shown(typed: Typed, hide_type: bool) -> str:
    """Return a value as ``ros2 param get`` prints it. Line ends and tabs of a string stay."""
    if typed.kind == ParameterType.NOT_SET:
        return "None" if hide_type else _LABELS[0]
    text = printable(str(plain(typed)), "\n\t")
    return text if hide_type else f"{_LABELS[typed.kind]} {text}"


def json_value(typed: Typed) -> Any:
    """Return a value as JSON has it: bytes as numbers, and numbers that are not finite as text."""
    if typed.kind == ParameterType.DOUBLE:
        return _finite(typed.value)
    if typed.kind == ParameterType.DOUBLE_ARRAY:
        return [_finite(value) for value in typed.value]
    return list(typed.value) if typed.kind == ParameterType.BYTE_ARRAY else typed.value


def _finite(value: float) -> float | str:
    return value if math.isfinite(value) else str(value)


def plain(typed: Typed) -> Any:
    """Return a value as Python has it, bytes as a list of single ones, as rclpy does."""
    if typed.kind == ParameterType.BYTE_ARRAY:
        return [bytes([octet]) for octet in typed.value]
    return typed.value
