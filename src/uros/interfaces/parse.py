"""Parser of ROS 2 ``.msg``, ``.srv`` and ``.action`` text.

uros has its own parser since that of rosbags drops default values and loads numpy; rosbags is the
test oracle.

Names, bounds and values follow the ROS 2 interface definition rules: package and field names are
lower snake case, type names CamelCase, constants UPPER_CASE; ``char`` is an unsigned octet. Every
fault raises `InterfaceError`; its text has the file, the line, the fault and the remedy.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, NoReturn, Union

from .errors import InterfaceError

if TYPE_CHECKING:
    from collections.abc import Iterator

Scalar = Union[bool, int, float, str]
Value = Union[Scalar, "tuple[Scalar, ...]"]

INTEGERS: Final = {
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "byte": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
}
FLOATS: Final = ("float32", "float64")
STRINGS: Final = ("string", "wstring")
PRIMITIVES: Final = ("bool", *INTEGERS, *FLOATS, *STRINGS)
FLOAT32_MAX: Final = 3.4028235677973366e38
"""Magnitudes from this value on round to infinity in a float32."""

MAX_BOUND: Final = 2**32 - 1

_LOWER_SNAKE: Final = re.compile(r"[a-z](_?[a-z0-9])*")
_CAMEL: Final = re.compile(r"[A-Z][A-Za-z0-9]*")
_UPPER: Final = re.compile(r"[A-Z](_?[A-Z0-9])*")
_TYPE: Final = re.compile(
    r"(?P<base>[A-Za-z0-9_/]+)(<=(?P<str>[^\[\]<>=]*))?(?P<array>\[(?P<upper><=)?(?P<size>[^\]]*)\])?"
)
_ESCAPES: Final = {"n": "\n", "t": "\t", "r": "\r", "a": "\a", "b": "\b", "f": "\f", "v": "\v"}


@dataclass(frozen=True)
class Type:
    """The type of a field.

    ``name`` is a primitive (`PRIMITIVES`) or a message as ``pkg/msg/Name``. ``array`` is ``""``,
    ``"fixed"``, ``"bounded"`` or ``"unbounded"``, with its ``size`` in elements; ``string_bound``
    is 0 if a string has no bound.
    """

    name: str
    array: str = ""
    size: int = 0
    string_bound: int = 0

    @property
    def primitive(self) -> bool:
        """Whether the type is one of `PRIMITIVES`, and no message."""
        return "/" not in self.name

    @property
    def element(self) -> Type:
        """The type of one element of an array; the type itself if it is no array."""
        return replace(self, array="", size=0)

    def __str__(self) -> str:
        text = self.name + (f"<={self.string_bound}" if self.string_bound else "")
        if self.array:
            text += {"fixed": f"[{self.size}]", "bounded": f"[<={self.size}]"}.get(self.array, "[]")
        return text


@dataclass(frozen=True)
class Constant:
    """A named value of a primitive type."""

    type: Type
    name: str
    value: Scalar


@dataclass(frozen=True)
class Field:
    """A field; ``default`` is None if the text has none, a tuple for arrays."""

    type: Type
    name: str
    default: Value | None = None


@dataclass(frozen=True)
class Message:
    """One structure: of a .msg file, or one of those of a .srv or .action file.

    ``kind`` is the folder: ``msg``, ``srv`` or ``action``. ``source`` names the file in errors.
    """

    package: str
    kind: str
    name: str
    fields: tuple[Field, ...] = ()
    constants: tuple[Constant, ...] = ()
    source: str = field(default="", compare=False)

    @property
    def parts(self) -> tuple[Message]:
        """The message itself, as the only structure of its definition."""
        return (self,)

    @property
    def type_name(self) -> str:
        """The full name, such as ``std_msgs/msg/Int32``."""
        return f"{self.package}/{self.kind}/{self.name}"

    @property
    def nested(self) -> tuple[str, ...]:
        """The message types of its fields, without duplicates, in order."""
        return tuple(dict.fromkeys(f.type.name for f in self.fields if not f.type.primitive))


@dataclass(frozen=True)
class Service:
    """A .srv file: ``Name_Request`` and ``Name_Response``; ``kind`` is ``action`` in an action."""

    package: str
    name: str
    request: Message
    response: Message
    kind: str = "srv"

    @property
    def type_name(self) -> str:
        """The full name, such as ``std_srvs/srv/Trigger``."""
        return f"{self.package}/{self.kind}/{self.name}"

    @property
    def parts(self) -> tuple[Message, Message]:
        """Its structures."""
        return self.request, self.response

    @property
    def event(self) -> Message:
        """``Name_Event``, which service introspection publishes; the service's hash includes it."""
        request = Type(self.request.type_name, "bounded", 1)
        response = Type(self.response.type_name, "bounded", 1)
        fields = Field(_EVENT_INFO, "info"), Field(request, "request"), Field(response, "response")
        name, source = f"{self.name}_Event", self.request.source
        return Message(self.package, self.kind, name, fields, source=source)


@dataclass(frozen=True)
class Action:
    """A .action file: ``Name_Goal``, ``Name_Result`` and ``Name_Feedback``.

    The wire has structures derived from these: two services and the message of a topic.
    """

    package: str
    name: str
    goal: Message
    result: Message
    feedback: Message

    @property
    def type_name(self) -> str:
        """The full name, such as ``example_interfaces/action/Fibonacci``."""
        return f"{self.package}/action/{self.name}"

    @property
    def send_goal(self) -> Service:
        """``Name_SendGoal``: the request is a goal and its id, the response acceptance and time."""
        accepted = Field(Type("bool"), "accepted"), Field(_TIME, "stamp")
        return self._service("SendGoal", (_GOAL_ID, self._field("goal")), accepted)

    @property
    def get_result(self) -> Service:
        """``Name_GetResult``: the request is a goal's id, the response its status and result."""
        response = Field(Type("int8"), "status"), self._field("result")
        return self._service("GetResult", (_GOAL_ID,), response)

    @property
    def feedback_message(self) -> Message:
        """``Name_FeedbackMessage``: a goal's id and its feedback."""
        return self._message("FeedbackMessage", (_GOAL_ID, self._field("feedback")))

    @property
    def parts(self) -> tuple[Message, ...]:
        """All its structures, each after those of them that it nests."""
        services = self.send_goal.parts + self.get_result.parts
        return self.goal, self.result, self.feedback, *services, self.feedback_message

    def _field(self, section: str) -> Field:
        return Field(Type(f"{self.type_name}_{section.capitalize()}"), section)

    def _message(self, suffix: str, fields: tuple[Field, ...]) -> Message:
        name, source = f"{self.name}_{suffix}", self.goal.source
        return Message(self.package, "action", name, fields, source=source)

    def _service(
        self, suffix: str, request: tuple[Field, ...], response: tuple[Field, ...]
    ) -> Service:
        return Service(
            self.package,
            f"{self.name}_{suffix}",
            self._message(suffix + "_Request", request),
            self._message(suffix + "_Response", response),
            "action",
        )


_TIME: Final = Type("builtin_interfaces/msg/Time")
_EVENT_INFO: Final = Type("service_msgs/msg/ServiceEventInfo")
_GOAL_ID: Final = Field(Type("unique_identifier_msgs/msg/UUID"), "goal_id")


def parse_msg(text: str, package: str, name: str, source: str = "") -> Message:
    """Parse the text of one .msg file of ``package``; ``source`` names the file in errors."""
    where = _Place(source or f"{package}/msg/{name}.msg")
    where.check_names(package, name)
    return _message(_lines(text), package, "msg", name, where)


def parse_srv(text: str, package: str, name: str, source: str = "") -> Service:
    """Parse the text of one .srv file: two sections, divided by a line of three dashes."""
    where = _Place(source or f"{package}/srv/{name}.srv")
    where.check_names(package, name)
    request, response = _sections(text, where, ("request", "response"))
    return Service(
        package,
        name,
        _message(request, package, "srv", name + "_Request", where),
        _message(response, package, "srv", name + "_Response", where),
    )


def parse_action(text: str, package: str, name: str, source: str = "") -> Action:
    """Parse the text of one .action file: three sections, divided by lines of three dashes."""
    where = _Place(source or f"{package}/action/{name}.action")
    where.check_names(package, name)
    goal, result, feedback = _sections(text, where, ("goal", "result", "feedback"))
    return Action(
        package,
        name,
        _message(goal, package, "action", name + "_Goal", where),
        _message(result, package, "action", name + "_Result", where),
        _message(feedback, package, "action", name + "_Feedback", where),
    )


class _Place:
    """The parser's position, for its errors."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.line = 0

    def fail(self, fault: str, remedy: str) -> NoReturn:
        at = f"{self.source}:{self.line}" if self.line else self.source
        raise InterfaceError(f"{at}: {fault}; {remedy}")

    def check_names(self, package: str, name: str) -> None:
        if not _LOWER_SNAKE.fullmatch(package):
            self.fail(
                f"bad package name {package!r}",
                "use lower case letters, digits and single underscores, a letter first",
            )
        if not _CAMEL.fullmatch(name):
            self.fail(
                f"bad type name {name!r}", "name the file in CamelCase (letters and digits only)"
            )


def _lines(text: str) -> list[tuple[int, str]]:
    return [
        (number, line)
        for number, raw in enumerate(text.lstrip("\ufeff").splitlines(), 1)
        if (line := strip_comment(raw.replace("\t", " ")).strip())
    ]


def strip_comment(line: str) -> str:
    """Remove a comment; a # inside a quoted default or constant belongs to the value."""
    cut = line.find("#")
    if cut < 0:
        return line
    if line.lstrip().startswith(STRINGS):
        quote, last, escaped = "", "", False
        for index, char in enumerate(line):
            if escaped:
                escaped = False
            elif char == "\\" and quote:
                escaped = True
            elif quote:
                quote = "" if char == quote else quote
            elif char in "\"'" and last in " =[,":
                quote = char
            elif char == "#":
                return line[:index]
            last = char
        if not quote:
            return line
    return line[:cut]


def _sections(text: str, where: _Place, names: tuple[str, ...]) -> Iterator[list[tuple[int, str]]]:
    sections: list[list[tuple[int, str]]] = [[]]
    for number, line in _lines(text):
        if line == "---":
            sections.append([])
        else:
            sections[-1].append((number, line))
    if len(sections) != len(names):
        where.fail(
            f"{len(sections) - 1} lines of '---', expected {len(names) - 1}",
            f"divide {' and '.join(names)} by a line of three dashes",
        )
    return iter(sections)


def _message(
    lines: list[tuple[int, str]], package: str, kind: str, name: str, where: _Place
) -> Message:
    fields: dict[str, Field] = {}
    constants: dict[str, Constant] = {}
    for where.line, line in lines:
        type_text, _, rest = line.partition(" ")
        rest = rest.strip()
        if not rest:
            where.fail(f"{line!r} has no name", "write 'type name'")
        type_ = _type(type_text, package, where)
        if match := re.match(r"(\w+)\s*=\s*(.*)", rest):
            constant = _constant(type_, match[1], match[2], where)
            if constant.name in constants:
                where.fail(f"duplicate constant {constant.name!r}", "rename one of the two")
            constants[constant.name] = constant
            continue
        field_name, _, default = rest.partition(" ")
        if not _LOWER_SNAKE.fullmatch(field_name):
            where.fail(
                f"bad field name {field_name!r}",
                "use lower case letters, digits and single underscores, a letter first",
            )
        if field_name in fields:
            where.fail(f"duplicate field {field_name!r}", "rename one of the two")
        default = default.strip()
        fields[field_name] = Field(
            type_, field_name, _default(type_, default, where) if default else None
        )
    where.line = 0
    return Message(
        package, kind, name, tuple(fields.values()), tuple(constants.values()), where.source
    )


def _type(text: str, package: str, where: _Place) -> Type:
    match = _TYPE.fullmatch(text)
    if match is None:
        where.fail(f"bad type {text!r}", "write type, type[], type[n], type[<=n] or string<=n")
    base, string_bound = match["base"], 0
    if match["str"] is not None:
        if base not in STRINGS:
            where.fail(f"{base!r} cannot have a length bound", "only string and wstring can")
        string_bound = _bound(match["str"], text, where)
    if base not in PRIMITIVES:
        base = _nested(base, package, where)
    if match["array"] is None:
        return Type(base, string_bound=string_bound)
    if not match["size"]:
        if match["upper"]:
            where.fail(f"bad type {text!r}", "give the bound a number, as in [<=8]")
        return Type(base, "unbounded", 0, string_bound)
    size = _bound(match["size"], text, where)
    return Type(base, "bounded" if match["upper"] else "fixed", size, string_bound)


def _bound(text: str, whole: str, where: _Place) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and 0 < int(text) <= MAX_BOUND):
        where.fail(f"bad size {text!r} in {whole!r}", f"give a number from 1 to {MAX_BOUND}")
    return int(text)


def _nested(text: str, package: str, where: _Place) -> str:
    parts = text.split("/")
    if len(parts) == 3 and parts[1] == "msg":
        del parts[1]
    if len(parts) == 1:
        parts.insert(0, package)
    if len(parts) == 2 and _LOWER_SNAKE.fullmatch(parts[0]) and _CAMEL.fullmatch(parts[1]):
        return f"{parts[0]}/msg/{parts[1]}"
    if text in ("time", "duration", "Header"):
        where.fail(f"unknown type {text!r}", "ROS 2 names it builtin_interfaces or std_msgs/Header")
    where.fail(
        f"unknown type {text!r}",
        f"use one of {', '.join(PRIMITIVES)}, Name or package/Name",
    )


def _constant(type_: Type, name: str, text: str, where: _Place) -> Constant:
    if not type_.primitive or type_.array or type_.string_bound:
        where.fail(f"a constant cannot be of type {type_}", "use a plain primitive type")
    if not _UPPER.fullmatch(name):
        where.fail(f"bad constant name {name!r}", "use UPPER_CASE with single underscores")
    return Constant(type_, name, _scalar(type_, text.strip(), where))


def _default(type_: Type, text: str, where: _Place) -> Value:
    if not type_.primitive:
        where.fail(f"{type_} cannot have a default value", "only primitive fields can")
    if not type_.array:
        return _scalar(type_, text, where)
    if not (text.startswith("[") and text.endswith("]")):
        where.fail(f"bad array default {text!r}", "write it as [a, b, c]")
    values = tuple(_scalar(type_.element, item, where) for item in _items(text[1:-1], where))
    if type_.array == "fixed" and len(values) != type_.size:
        where.fail(
            f"{type_} needs {type_.size} default values, not {len(values)}",
            "give one for each element, or none at all",
        )
    if type_.array == "bounded" and len(values) > type_.size:
        where.fail(f"{len(values)} default values in {type_}", f"give at most {type_.size}")
    return values


def _items(text: str, where: _Place) -> list[str]:
    """Split at the commas outside quotes."""
    if not text.strip():
        return []
    items, start, quote, escaped = [], 0, "", False
    for index, char in enumerate(text):
        if escaped:
            escaped = False
        elif char == "\\" and quote:
            escaped = True
        elif quote:
            quote = "" if char == quote else quote
        elif char in "\"'" and not text[start:index].strip():
            quote = char
        elif char == ",":
            items.append(text[start:index].strip())
            start = index + 1
    items.append(text[start:].strip())
    if "" in items:
        where.fail(f"empty element in [{text}]", "remove the spare comma")
    return items


def _scalar(type_: Type, text: str, where: _Place) -> Scalar:
    name = type_.name
    if name in STRINGS:
        value = _string(text, where)
        if type_.string_bound:
            length = (
                len(value.encode("utf-16-le")) // 2 if name == "wstring" else len(value.encode())
            )
            if length > type_.string_bound:
                where.fail(
                    f"default of {length} characters in {type_}",
                    f"use at most {type_.string_bound}",
                )
        return value
    if name == "bool":
        if text.lower() not in ("true", "false", "1", "0"):
            where.fail(f"bad bool {text!r}", "write true or false")
        return text.lower() in ("true", "1")
    if name in FLOATS:
        try:
            number = float(text)
        except ValueError:
            where.fail(f"bad {name} {text!r}", "write a number such as -1.5e3, inf or nan")
        if name == "float32" and FLOAT32_MAX <= abs(number) < float("inf"):
            where.fail(f"{text} is out of range for float32", "use float64")
        return number
    if re.fullmatch(r"[+-]?[0-9]{1,40}", text):
        integer = int(text)  # 007 is 7
    elif re.fullmatch(r"[+-]?0([xX][0-9a-fA-F]{1,40}|[oO][0-7]{1,40}|[bB][01]{1,80})", text):
        integer = int(text, 0)
    else:
        where.fail(f"bad {name} {text!r}", "write a whole number such as -5 or 0x1F")
    low, high = INTEGERS[name]
    if not low <= integer <= high:
        where.fail(f"{text} is out of range for {name}", f"use {low} to {high}, or a wider type")
    return integer


def _string(text: str, where: _Place) -> str:
    """Decode quotes and escapes; text without quotes is taken literally."""
    quote = text[:1]
    if quote not in ("'", '"'):
        return text
    out, escaped = [], False
    for index, char in enumerate(text[1:], 1):
        if escaped:
            out.append(_ESCAPES.get(char, char))
            escaped = False
        elif char == "\\":
            escaped = True
        elif char == quote:
            if index != len(text) - 1:
                where.fail(f"text after the closing quote in {text}", "escape inner quotes by \\")
            return "".join(out)
        else:
            out.append(char)
    where.fail(f"no closing quote in {text}", "close it, or leave both quotes out")
