"""Finds fields of messages that a program names and their types do not have.

On a board a misspelt field raises no error: MicroPython gives the message a new attribute, and the
field is sent as zero. `check_fields` therefore checks each expression of a program that is inferred
to be a message (`uros.boards.builder.type_inference`)::

    battery = BatteryState()
    battery.volts = 7.4            # sensor_msgs/msg/BatteryState has no field volts

Where no type can be inferred, `uros board run` finds the fault at run time
(`uros.interfaces.checked`).
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from uros.interfaces import InterfaceError, registry
from uros.interfaces.checked import meant
from uros.interfaces.generate import attribute_name, field_type_name
from uros.interfaces.runtime import check_value

from .inferred_values import Value, instance
from .modules import Module
from .scopes import walk
from .type_inference import Program, last

_METHODS: Final = {
    "cdr_size", "pack_into", "unpack_from", "unpack_into", "get_fields_and_field_types",
}  # fmt: skip
_LITERAL_NODES: Final = (ast.Constant, ast.UnaryOp)
_CATCH_ATTRIBUTE_ERROR: Final = {"AttributeError", "Exception", "BaseException"}
_TYPES_WITH_HALVES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def check_fields(modules: Iterable[Module]) -> list[str]:
    """Return a line for each fault in the program's own modules, with file and line number."""
    own = [module for module in modules if module.own]
    return list(dict.fromkeys(_Faults(own)))


class _Faults:
    """Iterates over the faults in modules, one line each."""

    def __init__(self, modules: list[Module]) -> None:
        self.modules = modules
        self.program = Program(modules)

    def __iter__(self) -> Iterator[str]:
        for module in self.modules:
            for node in walk(module.tree):
                place = f"{module.source}:{getattr(node, 'lineno', 0)}"
                if isinstance(node, ast.Attribute):
                    yield from self._unknown_field(node, place)
                elif isinstance(node, ast.Call):
                    yield from self._unknown_keywords(node, place)
                elif isinstance(node, ast.Assign) and isinstance(node.value, _LITERAL_NODES):
                    for target in node.targets:
                        if isinstance(target, ast.Attribute):
                            value = self.program.infer(target.value)
                            yield from _value_fault(value, target.attr, node.value, place)

    def _unknown_field(self, node: ast.Attribute, place: str) -> Iterator[str]:
        value = self.program.infer(node.value)
        if not value or value[0] != "message" or _allowed(value[1], node.attr):
            return
        if node.attr in self.program.dynamic_names or self._guarded(node):
            return
        yield f"{place}: {_missing_field(value[1], node.attr)}"

    def _unknown_keywords(self, node: ast.Call, place: str) -> Iterator[str]:
        value = self.program.infer(node.func)
        if not value or value[0] != "class" or not instance(value[1]):
            return
        fields = _fields(value[1])
        for keyword in node.keywords:
            if keyword.arg is not None and keyword.arg not in fields:
                yield f"{place}: {_missing_field(value[1], keyword.arg)}"
            elif keyword.arg is not None:
                yield from _value_fault(instance(value[1]), keyword.arg, keyword.value, place)

    def _guarded(self, node: ast.AST) -> bool:
        """Whether the attribute is read in a ``try`` that catches AttributeError."""
        if not isinstance(getattr(node, "ctx", None), ast.Load):
            return False
        inner, outer = node, self.program.parents.get(node)
        while outer is not None:
            if isinstance(outer, ast.Try) and inner in outer.body:
                for handler in outer.handlers:
                    caught = handler.type
                    types = caught.elts if isinstance(caught, ast.Tuple) else [caught]
                    if any(
                        exception is None or last(exception) in _CATCH_ATTRIBUTE_ERROR
                        for exception in types
                    ):
                        return True
            inner, outer = outer, self.program.parents.get(outer)
        return False


def _fields(name: str) -> dict[str, str]:
    """Return the type of each field of a message, as `uros.interfaces.runtime` names types."""
    definition = registry.message(name)
    return {attribute_name(field.name): field_type_name(field.type) for field in definition.fields}


def _allowed(name: str, attribute: str) -> bool:
    definition = registry.message(name)
    return (
        attribute.startswith("_")
        or attribute in _METHODS
        or attribute in _fields(name)
        or any(constant.name == attribute for constant in definition.constants)
        or (name in _TYPES_WITH_HALVES and attribute in ("high", "low"))
    )


def _missing_field(name: str, attribute: str) -> str:
    fields = _fields(name)
    nested = [
        f"{field.name}.{attribute}"
        for field in registry.message(name).fields
        if not field.type.primitive
        and not field.type.array
        and attribute in _fields(field.type.name)
    ]
    return f"{name} has no field {attribute}{meant(attribute, list(fields), nested)}"


def _value_fault(value: Value, attribute: str, node: ast.expr, place: str) -> Iterator[str]:
    """Yield the fault of a literal number or text that does not fit the field it is assigned to."""
    if not value or value[0] != "message":
        return
    kind = _fields(value[1]).get(attribute, "")
    try:
        literal = ast.literal_eval(node)
    except (ValueError, TypeError, SyntaxError):
        return
    if not isinstance(literal, (bool, int, float, str)) or "/" in kind or not kind:
        return
    if kind.endswith((">", "]")) and not kind.startswith(("string<", "wstring<")):
        return
    try:
        check_value(literal, kind, f"{value[1]}.{attribute}")
    except (TypeError, InterfaceError) as error:
        yield f"{place}: {error}"
