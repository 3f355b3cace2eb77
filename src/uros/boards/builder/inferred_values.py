"""The values that the type inference gives to expressions, and what follows from one.

A program's messages, their types and their fields are looked up among the interface types.
"""

from __future__ import annotations

from typing import Any, Final

from uros.interfaces import InterfaceError, registry
from uros.interfaces.generate import attribute_name
from uros.interfaces.parse import Action, Message, Service

Value = tuple[Any, ...] | None
"""The inferred value of an expression: ("message", type name); None if it is unknown.

The first element of the tuple is the kind of the value, the second its detail:

==============  ====================================================================================
``message``     An instance of a message type; the name of the type.
``class``       The class of a message, service or action type; the name of the type.
``package``     A package of interface types; its dotted name.
``own``         An instance of a class that the program defines; the node of the class.
``own class``   A class that the program defines; its node.
``function``    A function that the program defines; its node.
``sequence``    A sequence; the value that all its items have.
``client``      The client of a service; the name of the service type.
``future``      The future of a service call; the name of the response type.
``goal``        A goal handle of an action server; the name of the action type.
``nothing``     The program's value None; no detail.
==============  ====================================================================================
"""
NOTHING: Final = ("nothing",)


def imported_value(module: str, name: str) -> Value:
    """Return the value of ``name`` in a package of interface types."""
    parts = [*module.split("."), name]
    if not registry.has_package(parts[0]) or len(parts) > 3:
        return None
    if len(parts) == 2:
        return ("package", ".".join(parts)) if name in registry.KINDS else None
    full = "/".join(parts)
    return ("class", full) if definition(full) else None


def package(name: str) -> Value:
    """Return the value of a package of interface types by its dotted name; None for any other."""
    return ("package", name) if registry.has_package(name.partition(".")[0]) else None


def definition(name: str) -> Message | Service | Action | None:
    """Return the definition of an interface type; None if it is unknown or cannot be parsed."""
    try:
        return registry.definition(name) if registry.exists(name) else None
    except (InterfaceError, StopIteration):
        return None


def instance(name: str) -> Value:
    """Return the value of an instance of a message type; None if ``name`` is not a message."""
    return ("message", name) if isinstance(definition(name), Message) else None


def field_value(name: str, attribute: str) -> Value:
    """Return the value of an attribute of a message type; None if it is no message or sequence."""
    for field in registry.message(name).fields:
        if attribute_name(field.name) == attribute and not field.type.primitive:
            value = instance(field.type.name)
            return ("sequence", value) if field.type.array and value else value
    return None


def join(values: list[Value]) -> Value:
    """Return the value that all alternatives have; None if they differ or one is unknown.

    Alternatives that are the program's value None (``NOTHING``) are ignored. If there are no
    others, the result is ``NOTHING``.
    """
    certain = set(values) - {NOTHING}
    if len(certain) == 1:
        return certain.pop()
    return None if certain else NOTHING


def element_of(value: Value) -> Value:
    """Return the value that all items of a sequence have; None if it is no sequence."""
    element: Value = value[1] if value and value[0] == "sequence" else None
    return element
