r"""Types from the text of their definitions, on a board at run time.

::

    Reading = load("my_msgs/msg/Reading", "std_msgs/Header header\nfloat32[<=8] values")
    others = {"my_msgs/msg/Reading": Reading}
    Store = load("my_msgs/srv/Store", "Reading reading\n---\nbool kept", others)

The classes (see `table`) are used as generated classes are, and encode the same octets. The rules
for definitions are those of `parse`, except that a name has at most 200 characters. The errors of
`parse` and of ``uros interface show`` say more.

The module is not needed once the types are loaded: a program that imports it in a function frees
4 kB by `forget`. Runs on MicroPython.
"""

import sys

from .errors import InterfaceError
from .table import MESSAGE, Table, write

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# Each primitive type, its struct code (or a code of `table`), and its name in rclpy.
_TYPES: Final = (
    "bool:?:boolean byte:B:octet char:B:uint8 uint8:B:uint8 int8:b:int8 int16:h:int16"
    " uint16:H:uint16 int32:i:int32 uint32:I:uint32 int64:q:int64 uint64:Q:uint64 float32:f:float"
    " float64:d:double string:s:string wstring:w:wstring"
)
# The kinds of characters in a name, see _is; a name begins with the first kind.
_LOWER: Final = "a0_"
_UPPER: Final = "A0_"
_CAMEL: Final = "Aa0"
# Some boards do not support longer attribute names.
_LONGEST_NAME: Final = 200
# Whether assignments to unknown attributes are rejected: the build of a virtual board sets True.
_CHECKED: Final = False


def load(name: str, text: str, others: "dict[str, Any] | None" = None) -> "Any":
    """Return the class of a message, or of a service if ``name`` is ``pkg/srv/Name``.

    The class has all that generated classes have, except ``_HASH``.

    Args:
        name: The full type name, ``pkg/msg/Name`` or ``pkg/srv/Name``.
        text: The definition.
        others: The nested types, by name: each a class, from this function or generated, or a text,
            which is replaced by its class. Types that are not in it are imported from ``pkg.msg``.

    Raises:
        InterfaceError: For a fault in a text, with the line.
    """
    return _Maker(name, {} if others is None else others, ()).load(text)


def forget() -> None:
    """Free this module if nothing else refers to it; the next import loads it again."""
    sys.modules.pop(__name__, None)
    parent, _, name = __name__.rpartition(".")
    if hasattr(sys.modules.get(parent), name):
        delattr(sys.modules[parent], name)


class _Maker:
    """Makes the classes of one definition."""

    def __init__(self, name: str, others: "dict[str, Any]", within: "tuple[str, ...]") -> None:
        self.name = name
        self.others = others
        self.within = within + (name,)
        self.at = 0  # the number of the line, and its text
        self.line = name

    def bad(self, part: str) -> InterfaceError:
        return InterfaceError(
            "%s:%d: bad %s in %r; on a host, 'uros interface show' says more"
            % (self.name, self.at, part, self.line)
        )

    def load(self, text: str) -> "Any":
        parts = self.name.split("/")
        kind = parts[1] if len(parts) == 3 else ""
        if not (kind in ("msg", "srv") and _is(_LOWER, parts[0])):
            raise self.bad("name")
        if not _is(_CAMEL, parts[2]):
            raise self.bad("name")
        constants = {}  # type: dict[str, Any]
        plan = []  # type: list[Any]
        sections = [(constants, plan)]
        for line in text.split("\n"):
            self.at += 1
            self.line = line = _uncommented(line.replace("\t", " ").strip("\ufeff\r ")).strip()
            if line == "---":
                constants = {}
                plan = []
                sections.append((constants, plan))
            elif line:
                self.statement(line, constants, plan)
        if len(sections) != (2 if kind == "srv" else 1):
            raise self.bad("number of lines '---'")
        if kind == "msg":
            return _class(self.name, constants, plan)
        request = _class(self.name + "_Request", *sections[0])
        response = _class(self.name + "_Response", *sections[1])
        return type(
            parts[2], (), {"_TYPE": self.name, "_DDS_TYPE": _dds(self.name), "Request": request,
                           "Response": response},
        )  # fmt: skip

    def statement(self, line: str, constants: "dict[str, Any]", plan: "list[Any]") -> None:
        """Add the line's constant to ``constants``, or its field to ``plan``."""
        kind, _, rest = line.partition(" ")
        entry, word = self.kind(kind)
        code = entry[0]
        name, _, value = rest.partition("=")
        name = name.strip()
        if "=" in rest and _all("Aa0_", name):
            # The word of a bounded type or of an array ends with a bracket.
            if not _is(_UPPER, name) or name in constants or word[-1] in ">]" or code == MESSAGE:
                raise self.bad("constant")
            constants[name] = self.scalar(entry, value.strip())
            return
        name, _, value = rest.strip().partition(" ")
        if not _is(_LOWER, name) or [1 for field in plan if field[0] == name]:
            raise self.bad("name")
        value = value.strip()
        plan.append((name, word, self.default(entry, value) if value else None) + entry)

    def kind(self, text: str) -> "tuple[tuple[Any, str, int, int], str]":
        """Parse a type: (code, array, size, bound of strings or class), and its name in rclpy.

        ``array`` is "" for none, "[" for one of a fixed size and "<" for a sequence.
        """
        base, _, inner = text.partition("[")
        base, bounded, limit = base.partition("<=")
        code = ""
        of = size = 0  # type: Any
        for row in _TYPES.split(" "):
            primitive = row.split(":")
            if primitive[0] == base:
                _, code, word = primitive
        if bounded:
            if code not in ("s", "w"):
                raise self.bad("type")
            of = self.size(limit)
            word += "<%d>" % of
        elif not code:
            code = MESSAGE
            of = self.nested(base)
            word = of._TYPE.replace("/msg/", "/")
        if "[" not in text:
            return (code, "", 0, of), word
        if inner[-1:] != "]":
            raise self.bad("type")
        inner = inner[:-1]
        if inner and inner[:2] != "<=":
            size = self.size(inner)
            return (code, "[", size, of), "%s[%d]" % (word, size)
        if inner:
            size = self.size(inner[2:])
            word += ", %d" % size
        return (code, "<", size, of), "sequence<%s>" % word

    def size(self, text: str) -> int:
        # Attack: the conversion of a number of many digits takes long, and CPython rejects it.
        if len(text) > 10 or not _all("0", text) or not 0 < int(text) < 1 << 32:
            raise self.bad("size")
        return int(text)

    def nested(self, text: str) -> "Any":
        """Return the class of a message that the definition names."""
        parts = text.split("/")
        if len(parts) == 3 and parts[1] == "msg":
            del parts[1]
        if len(parts) == 1:
            parts.insert(0, self.name.split("/")[0])
        if len(parts) != 2 or not (_is(_LOWER, parts[0]) and _is(_CAMEL, parts[1])):
            raise self.bad("type")
        package, plain = parts
        package += ".msg"
        name = parts[0] + "/msg/" + plain
        if name in self.within:
            raise self.bad("ring of types")
        message = self.others.get(name)
        if isinstance(message, str):
            message = _Maker(name, self.others, self.within).load(message)
            self.others[name] = message
        for place in (package, "uros.interfaces." + package):
            if message is None:
                try:
                    message = getattr(__import__(place, None, None, (plain,)), plain)
                except (ImportError, AttributeError):
                    pass
        if message is None:
            raise InterfaceError(
                "%s:%d: no %s; give load its class or text" % (self.name, self.at, name)
            )
        return message

    def default(self, entry: "tuple[Any, str, int, int]", text: str) -> "Any":
        code, array, size, _ = entry
        if not array:
            return self.scalar(entry, text)
        if text[0] != "[" or text[-1] != "]":
            raise self.bad("default")
        text = text[1:-1].strip()
        values = []
        while text:
            at = _closing(text, 0) if text[0] in "\"'" else 0
            if at < 0:
                raise self.bad("default")
            comma = text.find(",", at)
            item = text if comma < 0 else text[:comma].strip()
            text = "" if comma < 0 else text[comma + 1 :].strip()
            if not item or comma >= 0 and not text:
                raise self.bad("default")
            values.append(self.scalar(entry, item))
        if array == "[" and len(values) != size or 0 < size < len(values):
            raise self.bad("default")
        return bytes(values) if code == "B" else values

    def scalar(self, entry: "tuple[Any, str, int, int]", text: str) -> "Any":
        """Parse the value of a constant or a default, or of one element of a default."""
        code = entry[0]
        value = None  # type: Any
        if code in ("s", "w"):
            value = text
            if text[:1] in ("'", '"'):
                if _closing(text, 0) != len(text) - 1:
                    raise self.bad("text")
                value = ""
                escaped = False
                for char in text[1:-1]:
                    if char == "\\" and not escaped:
                        escaped = True
                    else:
                        special = "ntrabfv".find(char)
                        if escaped and special >= 0:
                            char = "\n\t\r\a\b\f\v"[special]
                        value += char
                        escaped = False
            try:
                write(code, entry[3], value, None, 0, 0)
            except ValueError:
                raise self.bad("default")
            return value
        word = text.lower()
        try:
            if code == "?":
                if word in ("true", "false", "1", "0"):
                    return word in ("true", "1")
            elif "_" not in text and code != MESSAGE:
                if code in "fd":
                    value = float(text)
                else:
                    digits = word.lstrip("+-")
                    base = digits[1:2]
                    if len(digits) > (82 if base == "b" else 42 if base in ("x", "o") else 40):
                        raise ValueError
                    value = int(text, 0 if base in ("x", "o", "b") else 10)
                write(code, 0, value, None, 0, 0)
                # Half of the limit, which also fits where floats have 32 bits.
                if code != "f" or not 1.7014117838986683e38 <= abs(value) / 2 < float("inf"):
                    return value
        except ValueError:
            pass
        raise self.bad("value")


def _all(kinds: str, text: str) -> bool:
    """Whether all characters of a text are of these kinds: a, A, 0, _.

    A regular expression (module re) would overflow a board's stack on a long text.
    """
    for char in text:
        for kind, last in ("az", "AZ", "09"):
            if kind <= char <= last:
                char = kind
        if char not in kinds:
            return False
    return text != ""


def _is(kinds: str, name: str) -> bool:
    """Whether this is a name of these kinds: underscores are single, and not at an end."""
    if len(name) > _LONGEST_NAME or not _all(kinds, name) or not _all(kinds[0], name[0]):
        return False
    return name[-1] != "_" and "__" not in name


def _dds(name: str) -> str:
    package, kind, plain = name.split("/")
    return "%s::%s::dds_::%s_" % (package, kind, plain)


def _closing(text: str, at: int) -> int:
    """Return where the quote at ``at`` is closed, or -1."""
    quote = text[at]
    at += 1
    while at < len(text):
        if text[at] == quote:
            return at
        at += 2 if text[at] == "\\" else 1
    return -1


def _uncommented(line: str) -> str:
    """Return a line without its comment; a # within quotes belongs to a string."""
    if "#" not in line:  # the loop below is slow on a board
        return line
    at = 0
    last = " "
    while at < len(line):
        if line[at] == "#":
            return line[:at]
        if line[at] in "\"'" and last in " =[," and line[:6] in ("string", "wstrin"):
            at = _closing(line, at)
            if at < 0:
                return line.partition("#")[0]
        last = line[at]
        at += 1
    return line


def _class(name: str, members: "dict[str, Any]", plan: "list[Any]") -> "Any":
    attributes = []
    for i in range(len(plan)):
        word = plan[i][0]
        try:
            exec(word + " = 0", {})
            if hasattr(Table, word) or word == "self":
                word += "_"
        except SyntaxError:
            word += "_"
        attributes.append(word)
    members["_TYPE"] = name
    members["_DDS_TYPE"] = _dds(name)
    members["_FIELDS"] = tuple([field[:2] for field in plan])
    members["__slots__"] = tuple(attributes)
    members["_plan"] = [field[2:] for field in plan]
    if _CHECKED:
        from .checked import checked

        members["__setattr__"] = checked(name, members["__slots__"], "")
    return type(name.split("/")[2], (Table,), members)
