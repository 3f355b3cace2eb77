"""Generator: a definition → Python source of a module with its class (or classes, of a service).

There are two forms of the same class. A host's is fast: packing is straight-line, nested messages
are inlined, and runs of fixed-size fields go by one ``struct`` call, with the alignment modulo 8
tracked as far as it is known (`layout`); `emit` writes its codec. A board's is small, runs on
MicroPython 1.27 and on CPython unchanged, and makes no garbage; `emit_board` and `emit_load` write
its codec. The octets are the same.

Values in a class: ``uint8[]``, ``byte[]`` and ``char[]`` are bytes; sequences of other numbers are
``array.array``; fixed arrays of numbers and everything else are lists. When packed, any sequence of
the right values will do. Host only.
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
"""What all actions share, and each has in its ``Impl``, as in rclpy."""

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


def generate(definition: Message | Service | Action, prefix: str = "") -> str:
    """The source of the module that holds the type's class.

    ``prefix`` stands before the package names it imports (``"uros.interfaces."`` on a host, nothing
    on a board). A service's module has ``Name_Request``, ``Name_Response`` and ``Name``, an
    action's those of all that it makes.
    """
    own = _own_names([definition])
    aliases = Aliases(own)
    body = "\n\n\n".join(_classes(definition, aliases, None if prefix else Parts()))
    nested = []
    for name, alias in sorted(aliases.names.items()):
        if name not in own:
            package, kind, plain = name.split("/")
            nested.append(
                f"from {prefix}{package}.{kind}.{module_name(plain)} import {plain} as {alias}"
            )
    return _module(definition.type_name, nested, body)


class Parts(NamedTuple):
    """What classes of a board can do without, by the names of their types."""

    unnamed: frozenset[str] = frozenset()
    """Only ever parts of others: nobody asks for the type's name."""
    called: frozenset[str] = frozenset()
    """Types whose methods others call. Who is neither named nor called needs none."""
    elements: frozenset[str] = frozenset()
    """Those whose size others ask for: as of an array's elements."""
    once: frozenset[str] = frozenset()
    """Not named, and nested at one place: they are written and read there."""
    lean: bool = False
    """Without a base class that has the public methods and puts words to errors."""
    reused: bool = False
    """The program reads into messages that it has."""
    alike: str = ""
    """A type that needs nothing which its base, `compact.Doubles`, has not."""
    checked: bool = False
    """Attributes that are no fields are refused: see `checked`. Not together with ``lean``."""


def generate_together(definitions: Sequence[Message | Service | Action], parts: Parts) -> str:
    """The source of one board module, ``std_msgs.msg``, with the classes of many of its types.

    It costs a board less than a module for each. Types come after those of the same module that
    they nest; the others are imported from modules of this kind.
    """
    package, kind, _ = definitions[0].type_name.split("/")
    aliases = Aliases(_own_names(definitions))
    classes: list[str] = []
    for definition in definitions:
        classes += _classes(definition, aliases, parts)
    nested = []
    for name, alias in sorted(aliases.names.items()):
        other, other_kind, plain = name.split("/")
        if (other, other_kind) != (package, kind):
            nested.append(f"from {other}.{other_kind} import {plain} as {alias}")
    return _module(f"{package}/{kind}", nested, "\n\n\n".join(classes))


def _own_names(definitions: Sequence[Message | Service | Action]) -> dict[str, str]:
    """The structures that a module defines, and its names for them."""
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
    """The attribute of a field; a keyword or method name gets an underscore appended."""
    if keyword.iskeyword(field_name) or field_name in _METHODS:
        return field_name + "_"
    return field_name


def field_type_name(type_: Type) -> str:
    """A field's type as rclpy's ``get_fields_and_field_types`` spells it."""
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
        kept = "doubles" if doubles else "halves" if halves else ""
        what = f'"{message.type_name}", {_tuple(map(repr, names))}, "{kept}"'
        lines.append(f"    __setattr__ = _checked({what})")
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


# On a board seconds are kept in halves: those since 1970 are no small integer there. What writes
# or reads the halves runs on a host, too.
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
    """Of a `compact.Doubles` what its base has not."""
    blocks = []
    names = [f.name for f in message.fields]
    given = [f.default for f in message.fields]
    defaults = [0.0 if isinstance(value, tuple) else value or 0.0 for value in given]
    if part:
        if len(names) > 3 or any(defaults):  # whole numbers take less memory
            plain = [int(it) if it == int(it) else it for it in map(float, defaults)]
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
    """``part``: of messages that are made without arguments, as those that occur in others."""
    arguments, lines = [], []
    for name, field in zip(names, message.fields):
        default, fresh = _defaults(field, aliases)
        if board and field.type.array == "fixed" and field.type.name == "float64":
            given = name
            if isinstance(field.default, tuple):
                given = f"{_tuple(map(_literal, field.default))} if {name} is None else {name}"
            lines.append(f"        self.{name} = _row({given}, {field.type.size})")
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
            value = f"{name} or {fresh}"  # shorter there; messages are always true
        lines.append(f"        self.{name} = {value}")
    if part:
        arguments.clear()
    return "\n".join([f"    def __init__({', '.join(['self', *arguments])}):", *lines])


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
