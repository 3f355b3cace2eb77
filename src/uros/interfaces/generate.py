"""Generator: a definition → Python source of a module with its class (or classes, of a service).

There are two forms of the same class. A host's is fast: packing is straight-line, nested messages
are inlined, and one ``struct`` call packs a run of fixed-size fields, with the alignment modulo 8
tracked as far as it is known (`layout`); `emit` writes its codec. A board's is small, runs on
MicroPython 1.27 and on CPython unchanged, and makes no garbage; `emit_board` and `emit_load` write
its codec. Both forms encode the same octets.

Values in a class: ``uint8[]``, ``byte[]`` and ``char[]`` are bytes; sequences of other numbers are
``array.array``; fixed arrays of numbers and everything else are lists. Packing accepts any sequence
of valid values. Host only.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from . import registry
from .board_walk import HALVES, PUBLIC, Names, is_doubles
from .emit import packer, sizer, unpacker
from .emit_board import FROM, INTO, methods
from .emit_load import VIEW
from .layout import CODES, Aliases, is_octets
from .parse import Action, Field, Message, Scalar, Service, Type
from .typehash import hash_of

CANCEL_GOAL: Final = "action_msgs/srv/CancelGoal"
GOAL_STATUS: Final = "action_msgs/msg/GoalStatusArray"
"""Types common to all actions; each action has them in its ``Impl``, as in rclpy."""

_RCLPY_NAMES: Final = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}


def module_name(type_name: str) -> str:
    """Return the name of a type's module in its package's ``msg`` or ``srv``: ``_int32``."""
    return "_" + type_name.lower()


def generate(definition: Message | Service | Action, prefix: str = "") -> str:
    """Return the source of the module that holds the type's class.

    A service's module has ``Name_Request``, ``Name_Response`` and ``Name``, an action's the classes
    of its goal, result and feedback and of their services and message too.

    Args:
        definition: The parsed definition.
        prefix: Stands before the package names that the module imports: ``"uros.interfaces."`` for
            a host, ``""`` for a board.
    """
    own = _own_names([definition])
    aliases = Aliases(own)
    body = "\n\n\n".join(_classes(definition, aliases, None if prefix else Parts()))
    nested = []
    for name, alias in sorted(aliases.names.items()):
        if name not in own:
            package, kind, plain = name.split("/")
            module = module_name(registry.file_type(name).rpartition("/")[2])
            nested.append(f"from {prefix}{package}.{kind}.{module} import {plain} as {alias}")
    return _module(definition.type_name, nested, body)


class Parts(NamedTuple):
    """What is left out of a board's classes: names of types, and options."""

    unnamed: frozenset[str] = frozenset()
    """Types that occur only nested in others: nothing reads the name of such a type."""
    called: frozenset[str] = frozenset()
    """Types whose methods other types call. A type in neither set needs no methods."""
    elements: frozenset[str] = frozenset()
    """Types whose ``_size`` other types call, such as those of an array's elements."""
    once: frozenset[str] = frozenset()
    """Unnamed types nested at one place: their code is inlined there."""
    lean: bool = False
    """Classes have no base class with the public methods and error texts."""
    reused: bool = False
    """The program reads into existing messages (``unpack_into``)."""
    alike: str = ""
    """A type that adds nothing to its base, `compact.Doubles`."""
    checked: bool = False
    """Assignments to unknown attributes are rejected: see `checked`. Not together with ``lean``."""


def generate_together(definitions: Sequence[Message | Service | Action], parts: Parts) -> str:
    """Return the source of one board module, ``std_msgs.msg``, with the classes of many types.

    One module takes less memory on a board than a module for each type. A type comes after the
    types of the same module that it nests; types of other modules are imported.
    """
    package, kind, _ = definitions[0].type_name.split("/")
    aliases = Aliases(_own_names(definitions))
    classes: list[str] = []
    for definition in definitions:
        classes += _classes(definition, aliases, parts)
    nested = []
    for name, alias in sorted(aliases.names.items()):
        owner, owner_kind, plain = name.split("/")
        if (owner, owner_kind) != (package, kind):
            nested.append(f"from {owner}.{owner_kind} import {plain} as {alias}")
    return _module(f"{package}/{kind}", nested, "\n\n\n".join(classes))


def _own_names(definitions: Sequence[Message | Service | Action]) -> dict[str, str]:
    """Return the structures that a module defines, with the class name of each."""
    return {part.type_name: part.name for whole in definitions for part in whole.parts}


def _classes(
    definition: Message | Service | Action, aliases: Aliases, board: Parts | None
) -> list[str]:
    classes = [_message_class(part, aliases, board) for part in definition.parts]
    if isinstance(definition, Service):
        classes.append(_service_class(definition))
    elif isinstance(definition, Action):
        classes += _action_classes(definition, aliases)
    return classes


def _module(name: str, nested: list[str], body: str) -> str:
    lines = [f'"""{name}, generated from its definition."""', ""]
    used = set(re.findall(r"(?<![.\w])_?[A-Za-z]\w*", body))
    if struct := [name for name in ("pack_into", "unpack_from") if f" {name}(" in body]:
        lines.append(f"from struct import {', '.join(struct)}")
    if "_array" in used:
        lines.append("from array import array as _array")
    lines += ["", *nested]
    modules = (("checked", ("checked",)), ("compact", _COMPACT), ("runtime", _HELPERS))
    for module, helpers in modules:
        if imported := [f"{name} as _{name}" for name in helpers if "_" + name in used]:
            lines.append(f"from uros.interfaces.{module} import (")
            lines += [f"    {name}," for name in imported]
            lines.append(")")
    lines += ["", "", body, ""]
    return "\n".join(lines)


_COMPACT: Final = (
    "Doubles",
    "Row",
    "align",
    "fill",
    "get",
    "load_row",
    "load_text",
    "new_text",
    "pack_into",
    "put_numbers",
    "room",
    "row",
    "unpack_from",
)
_HELPERS: Final = (
    "Message",
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
    "utf8_of",
    "wide",
    "wire_bytes",
)
_METHODS: Final = {
    "self", "cdr_size", "pack_into", "unpack_from", "unpack_into", "get_fields_and_field_types",
}  # fmt: skip


def attribute_name(field_name: str) -> str:
    """Return the attribute of a field; a keyword or method name gets an underscore appended."""
    if keyword.iskeyword(field_name) or field_name in _METHODS:
        return field_name + "_"
    return field_name


def field_type_name(type_: Type) -> str:
    """Return a field's type as rclpy's ``get_fields_and_field_types`` spells it."""
    if type_.primitive:
        name = _RCLPY_NAMES.get(type_.name, type_.name)
    else:
        package, _, plain = type_.name.split("/")
        name = f"{package}/{plain}"
    if type_.string_bound:
        name += f"<{type_.string_bound}>"
    if type_.array == "fixed":
        return f"{name}[{type_.size}]"
    if type_.array:
        return f"sequence<{name}, {type_.size}>" if type_.size else f"sequence<{name}>"
    return name


def _identity(definition: Message | Service | Action) -> list[str]:
    package, kind, name = definition.type_name.split("/")
    return [
        f'    _TYPE = "{definition.type_name}"',
        f'    _DDS_TYPE = "{package}::{kind}::dds_::{name}_"',
        f'    _HASH = "{hash_of(definition)}"',
    ]


def _service_class(service: Service) -> str:
    lines = [f"class {service.name}:", *_identity(service)]
    lines += [f"    Request = {service.request.name}", f"    Response = {service.response.name}"]
    return "\n".join(lines)


def _action_classes(action: Action, aliases: Aliases) -> list[str]:
    name, send_goal, get_result = action.name, action.send_goal, action.get_result
    impl = [
        f"class {name}_Impl:",
        f"    SendGoalService = {send_goal.name}",
        f"    GetResultService = {get_result.name}",
        f"    FeedbackMessage = {action.feedback_message.name}",
        f"    CancelGoalService = {aliases[CANCEL_GOAL]}",
        f"    GoalStatusMessage = {aliases[GOAL_STATUS]}",
        f"    Status = {aliases[GOAL_STATUS.removesuffix('Array')]}",  # rclpy's has none
    ]
    lines = [f"class {name}:", *_identity(action), f"    Impl = {name}_Impl"]
    lines += [f"    {part} = {name}_{part}" for part in ("Goal", "Result", "Feedback")]
    services = [_service_class(send_goal), _service_class(get_result)]
    return [*services, "\n".join(impl), "\n".join(lines)]


def _message_class(message: Message, aliases: Aliases, board: Parts | None) -> str:
    registry.closure(message)  # all nested types exist and none is recursive
    names = [attribute_name(f.name) for f in message.fields]
    doubles = board is not None and is_doubles(message)
    halves = message.type_name in HALVES
    slots = names
    if doubles:
        slots = []
    elif board is not None and halves:
        slots = ["high", "low", "nanosec"]
    base = "(_Doubles)" if doubles else "(_Message)"
    if board is not None and board.lean and not doubles:
        base = ""
    lines = [f"class {message.name}{base}:", f"    __slots__ = {_tuple(map(repr, slots))}"]
    if slots is not names:
        lines.append(f"    _NAMES = {_tuple(map(repr, names))}")
    if board is None or message.type_name not in board.unnamed:
        lines += _identity(message)
    pairs = [f'("{f.name}", "{field_type_name(f.type)}")' for f in message.fields]
    lines.append(f"    _FIELDS = {_tuple(pairs)}")
    lines += [f"    {c.name} = {_literal(c.value)}" for c in message.constants]
    if board is not None and board.checked:
        storage = "doubles" if doubles else "halves" if halves else ""
        arguments = f'"{message.type_name}", {_tuple(map(repr, names))}, "{storage}"'
        lines.append(f"    __setattr__ = _checked({arguments})")
    blocks = ["\n".join(lines)]
    part = board is not None and board.lean and message.type_name in board.unnamed
    if board is not None and message.type_name == board.alike:
        return f"{message.name} = _Doubles"
    if doubles:
        blocks += _doubles(message, part)
    elif names and not (halves and board is not None):
        blocks.append(_init(message, names, aliases, board is not None, part))
    if halves:
        blocks += [_SECONDS] if board is None else [_ZERO if part else _GIVEN, _HALVES]
    if board is None:
        blocks += [
            sizer(message, attribute_name),
            packer(message, attribute_name, aliases),
            unpacker(message, aliases),
            _unpack_into(names),
        ]
    else:
        blocks += _methods(message, aliases, board)
    return "\n\n".join(blocks)


def _methods(message: Message, aliases: Aliases, board: Parts) -> list[str]:
    named = message.type_name not in board.unnamed
    called = message.type_name in board.called
    if not board.lean:
        if not named and not called:
            return []
        return methods(message, attribute_name, aliases, Names(), "_load")
    names = PUBLIC._replace(once=board.once, tell=PUBLIC.tell if named else f'("{message.name}")')
    if called:
        blocks = methods(message, attribute_name, aliases, names, "_load")
        if named:
            return [*blocks, INTO.replace("[:end]", VIEW), FROM]
        return blocks if message.type_name in board.elements else blocks[1:]
    if not named:
        return []
    load = "unpack_into" if board.reused else "unpack_from"
    blocks = methods(message, attribute_name, aliases, names, load)
    return [*blocks, FROM] if board.reused else blocks


def _unpack_into(names: list[str]) -> str:
    return "\n".join(
        [
            "    def unpack_into(self, buf, offset, start, end, little=True):",
            "        message, o = self.unpack_from(buf, offset, start, end, little)",
            *(f"        self.{name} = message.{name}" for name in names),
            "        return o",
        ]
    )


# A board stores seconds as two 16-bit halves: the seconds since 1970 are no small integer in
# MicroPython. Host classes have the halves as properties, so the same code runs there.
_GIVEN: Final = """\
    def __init__(self, sec=0, nanosec=0):
        self._set_sec(sec)
        self.nanosec = nanosec"""
_ZERO: Final = """\
    def __init__(self):
        self.high = self.low = self.nanosec = 0"""
_HALVES: Final = """\
    def _set_sec(self, value):
        self.high = value >> 16
        self.low = value & 65535

    sec = property(lambda self: self.high << 16 | self.low, _set_sec)"""
_SECONDS: Final = """\
    def _set_high(self, value):
        self.sec = value << 16 | self.sec & 65535

    def _set_low(self, value):
        self.sec = self.sec & -65536 | value

    high = property(lambda self: self.sec >> 16, _set_high)
    low = property(lambda self: self.sec & 65535, _set_low)"""


def _doubles(message: Message, part: bool) -> list[str]:
    """Return what the class of x, y and z (and w) adds to its base `compact.Doubles`."""
    blocks = []
    names = [f.name for f in message.fields]
    values = [f.default for f in message.fields]
    defaults = [0.0 if isinstance(value, tuple) else value or 0.0 for value in values]
    if part:
        if len(names) > 3 or any(defaults):  # whole numbers take less memory
            numbers = map(float, defaults)
            plain = [int(number) if number == int(number) else number for number in numbers]
            blocks.append(f"    _made = {_tuple(map(_literal, plain))}")
    else:
        arguments = [f"{name}={_literal(value)}" for name, value in zip(names, defaults)]
        init = f"    def __init__(self, {', '.join(arguments)}):\n"
        blocks.append(init + f'        self._d = _array("d", ({", ".join(names)}))')
    if len(names) > 3:
        blocks.append("    w = _Doubles._w")
    return blocks


def _init(
    message: Message, names: list[str], aliases: Aliases, board: bool, part: bool = False
) -> str:
    """Return the source of ``__init__``, without arguments if ``part``: if only nested."""
    arguments, lines = [], []
    for name, field in zip(names, message.fields):
        default, fresh = _defaults(field, aliases)
        if board and field.type.array == "fixed" and field.type.name == "float64":
            values = name
            if isinstance(field.default, tuple):
                values = f"{_tuple(map(_literal, field.default))} if {name} is None else {name}"
            lines.append(f"        self.{name} = _row({values}, {field.type.size})")
            if part:
                lines[-1] = lines[-1].replace(f" if {name} is None else {name}", "")
                lines[-1] = lines[-1].replace(f"_row({name},", "_row(None,")
            arguments.append(f"{name}=None")
            continue
        if part:
            lines.append(f"        self.{name} = {fresh or default}")
            continue
        arguments.append(f"{name}={default}")
        value = f"{fresh} if {name} is None else {name}" if fresh else name
        if board and fresh and not field.type.primitive and not field.type.array:
            value = f"{name} or {fresh}"  # shorter code; a message is always true
        lines.append(f"        self.{name} = {value}")
    if part:
        arguments.clear()
    return "\n".join([f"    def __init__({', '.join(['self', *arguments])}):", *lines])


def _defaults(field: Field, aliases: Aliases) -> tuple[str, str]:
    """Return the default in the signature, and the expression that makes a mutable value anew."""
    type_, default = field.type, field.default
    if not type_.array:
        if not type_.primitive:
            return "None", f"{aliases[type_.name]}()"
        if not isinstance(default, tuple) and default is not None:
            return _literal(default), ""
        return {"bool": "False", "string": '""', "wstring": '""'}.get(
            type_.name, "0.0" if type_.name.startswith("float") else "0"
        ), ""
    values = default if isinstance(default, tuple) else ()
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
