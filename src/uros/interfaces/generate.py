"""Generator: a definition → Python source of a module with its class (or classes, of a service).

The source runs on MicroPython 1.27 and on CPython unchanged. Packing is straight-line: nested
messages are inlined, and runs of fixed-size fields go by one ``struct`` call, with the alignment
modulo 8 tracked here as far as it is known (`layout`). `emit` writes the three codec methods.

Values in a class: ``uint8[]``, ``byte[]`` and ``char[]`` are bytes; sequences of other numbers are
``array.array``; fixed arrays of numbers and everything else are lists. When packed, any sequence of
the right values will do. Host only.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Sequence
from typing import Final

from . import registry
from .emit import packer, sizer, unpacker
from .layout import CODES, Aliases, is_octets
from .parse import Field, Message, Scalar, Service, Type
from .typehash import type_hash

_RCLPY_NAMES: Final = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}


def module_name(type_name: str) -> str:
    """The module of a type in its package's ``msg`` or ``srv``: ``Int32`` → ``_int32``."""
    return "_" + type_name.lower()


def generate(definition: Message | Service, prefix: str = "") -> str:
    """The source of the module that holds the type's class.

    ``prefix`` stands before the package names it imports (``"uros.interfaces."`` on a host, nothing
    on a board). A service's module has ``Name_Request``, ``Name_Response`` and ``Name``.
    """
    aliases = Aliases()
    body = "\n\n\n".join(_classes(definition, aliases))
    nested = []
    for name, alias in sorted(aliases.names.items()):
        package, kind, plain = name.split("/")
        nested.append(
            f"from {prefix}{package}.{kind}.{module_name(plain)} import {plain} as {alias}"
        )
    return _module(definition.type_name, nested, body)


def generate_together(definitions: Sequence[Message | Service]) -> str:
    """The source of one board module, ``std_msgs.msg``, with the classes of many of its types.

    It costs a board less than a module for each. Types come after those of the same module that
    they nest; the others are imported from modules of this kind.
    """
    package, kind, _ = definitions[0].type_name.split("/")
    aliases = Aliases({d.type_name: d.name for d in definitions})
    classes: list[str] = []
    for definition in definitions:
        classes += _classes(definition, aliases)
    nested = []
    for name, alias in sorted(aliases.names.items()):
        other, other_kind, plain = name.split("/")
        if (other, other_kind) != (package, kind):
            nested.append(f"from {other}.{other_kind} import {plain} as {alias}")
    return _module(f"{package}/{kind}", nested, "\n\n\n".join(classes))


def _classes(definition: Message | Service, aliases: Aliases) -> list[str]:
    if isinstance(definition, Message):
        return [_message_class(definition, aliases)]
    parts = (definition.request, definition.response)
    return [*(_message_class(part, aliases) for part in parts), _service_class(definition)]


def _module(name: str, nested: list[str], body: str) -> str:
    lines = [f'"""{name}, generated from its definition."""', ""]
    lines.append("from struct import pack_into, unpack_from")
    if "_array(" in body:
        lines.append("from array import array as _array")
    lines += ["", *nested]
    helpers = sorted(name for name in _HELPERS if f"_{name}(" in body)
    imported = ["Message as _Message", *(f"{name} as _{name}" for name in helpers)]
    lines.append("from uros.interfaces.runtime import (")
    lines += [f"    {name}," for name in imported]
    lines += [")", "", "", body, ""]
    return "\n".join(lines)


_HELPERS: Final = (
    "fault",
    "get_array",
    "get_bools",
    "get_bytes",
    "get_text",
    "get_texts",
    "get_wide",
    "long",
    "octet",
    "octets",
    "put_array",
    "put_bytes",
    "put_text",
    "put_texts",
    "short",
    "size_texts",
    "utf8",
    "wide",
    "wire_bytes",
)
_METHODS: Final = {"self", "cdr_size", "pack_into", "unpack_from", "get_fields_and_field_types"}


def attribute_name(field_name: str) -> str:
    """The attribute of a field; a keyword or method name gets an underscore appended."""
    if keyword.iskeyword(field_name) or field_name in _METHODS:
        return field_name + "_"
    return field_name


def field_type_name(type_: Type) -> str:
    """A field's type as rclpy's ``get_fields_and_field_types`` spells it."""
    if type_.primitive:
        name = _RCLPY_NAMES.get(type_.name, type_.name)
    else:
        name = type_.name.replace("/msg/", "/")
    if type_.string_bound:
        name += f"<{type_.string_bound}>"
    if type_.array == "fixed":
        return f"{name}[{type_.size}]"
    if type_.array:
        return f"sequence<{name}, {type_.size}>" if type_.size else f"sequence<{name}>"
    return name


def _identity(definition: Message | Service) -> list[str]:
    package, kind, name = definition.type_name.split("/")
    return [
        f'    _TYPE = "{definition.type_name}"',
        f'    _DDS_TYPE = "{package}::{kind}::dds_::{name}_"',
        f'    _HASH = "{type_hash(definition)}"',
    ]


def _service_class(service: Service) -> str:
    lines = [f"class {service.name}:", *_identity(service)]
    lines += [f"    Request = {service.request.name}", f"    Response = {service.response.name}"]
    return "\n".join(lines)


def _message_class(message: Message, aliases: Aliases) -> str:
    registry.closure(message)  # all nested types exist and none is recursive
    names = [attribute_name(f.name) for f in message.fields]
    lines = [f"class {message.name}(_Message):", f"    __slots__ = {_tuple(map(repr, names))}"]
    lines += _identity(message)
    pairs = [f'("{f.name}", "{field_type_name(f.type)}")' for f in message.fields]
    lines.append(f"    _FIELDS = {_tuple(pairs)}")
    lines += [f"    {c.name} = {_literal(c.value)}" for c in message.constants]
    blocks = ["\n".join(lines)]
    if names:
        blocks.append(_init(message, names, aliases))
    blocks += [
        sizer(message, attribute_name),
        packer(message, attribute_name, aliases),
        unpacker(message, aliases),
    ]
    return "\n\n".join(blocks)


def _init(message: Message, names: list[str], aliases: Aliases) -> str:
    arguments, lines = [], []
    for name, field in zip(names, message.fields):
        default, fresh = _defaults(field, aliases)
        arguments.append(f"{name}={default}")
        value = f"{fresh} if {name} is None else {name}" if fresh else name
        lines.append(f"        self.{name} = {value}")
    return "\n".join([f"    def __init__(self, {', '.join(arguments)}):", *lines])


def _defaults(field: Field, aliases: Aliases) -> tuple[str, str]:
    """The default in the signature, and for what must be made anew the expression that does."""
    type_, given = field.type, field.default
    if not type_.array:
        if not type_.primitive:
            return "None", f"{aliases[type_.name]}()"
        if not isinstance(given, tuple) and given is not None:
            return _literal(given), ""
        return {"bool": "False", "string": '""', "wstring": '""'}.get(
            type_.name, "0.0" if type_.name.startswith("float") else "0"
        ), ""
    values = given if isinstance(given, tuple) else ()
    if is_octets(type_):
        if values:
            return repr(bytes(int(v) for v in values)), ""
        return (f"bytes({type_.size})" if type_.array == "fixed" else 'b""'), ""
    text = ", ".join(_literal(v) for v in values)
    if type_.array != "fixed":
        if type_.primitive and type_.name not in ("bool", "string", "wstring"):
            code = CODES[type_.name][0]
            return "None", f'_array("{code}", ({text},))' if values else f'_array("{code}")'
        return "None", f"[{text}]"
    if values:
        return "None", f"[{text}]"
    element, fresh = _defaults(Field(type_.element, field.name), aliases)
    if fresh:
        return "None", f"[{fresh} for _ in range({type_.size})]"
    return "None", f"[{element}] * {type_.size}"


def _tuple(items: Iterable[str]) -> str:
    texts = list(items)
    return "(" + ", ".join(texts) + ("," if len(texts) == 1 else "") + ")"


def _literal(value: Scalar) -> str:
    if isinstance(value, float) and (value != value or value in (float("inf"), -float("inf"))):
        return f'float("{value}")'
    return repr(value)
