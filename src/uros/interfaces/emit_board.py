"""Writes the codec methods of a board's class, which `runtime.Message` calls. Host only.

The methods are small and make no garbage (those of a host are fast, see `emit`):

``_size(o)`` – returns the end offset; ``_pack(buf, o, start)`` – writes, and passes on any error;
``_load(buf, o, start, end, little)`` – reads a memoryview into this message.

A nested message of a few numbers is written and read in place, so a type that occurs only nested
needs no methods (`board_walk.calls` lists the types that do). Larger nested messages are handled by
a call of their own methods. See `compact` for the storage of float64 values.
"""

from __future__ import annotations

from typing import Final

from . import registry
from .board_walk import HALVES, BoardWalker, Names, is_doubles
from .emit import RUN_VALUES, Sizer, range_of, runs
from .emit_load import Loader
from .layout import CODES, Aliases, fixed_size, is_octets
from .parse import Message, Type
from .walk import Attribute


def methods(
    message: Message, attribute: Attribute, aliases: Aliases, names: Names, load: str
) -> list[str]:
    """Return the sources of the three methods.

    Args:
        message: The definition.
        attribute: Returns the attribute of a field name.
        aliases: The names of nested classes in the module.
        names: The names and heads of the methods.
        load: The name of the method that reads: ``_load``, or the public method if nothing calls
            ``_load``.
    """
    return [
        _Sizer(attribute, aliases, names).method(message),
        _Packer(attribute, aliases, names).method(message),
        Loader(attribute, aliases, names).method(message, load),
    ]


INTO: Final = """\
    def unpack_into(self, buf, o, start, end, little=True):
        buf = memoryview(buf)[:end]
        return self._load(buf, o, start, len(buf), little)"""
FROM: Final = """\
    @classmethod
    def unpack_from(cls, buf, o, start, end, little=True):
        self = cls()
        return self, self.unpack_into(buf, o, start, end, little)"""
"""The public methods above ``_load``."""


class _Sizer(Sizer):
    """Writes ``_size``: as `Sizer`, but without the names of faulty fields."""

    def __init__(self, attribute: Attribute, aliases: Aliases, names: Names) -> None:
        super().__init__(attribute, aliases)
        self.tell = names.tell
        self.called = names.size
        self.head = names.size_head

    def method(self, message: Message) -> str:
        self.walk(message, "self")
        lines, tail = self.lines, "o"
        if self.octets:
            tail = f"o + {self.octets}"
            if len(lines) == 1 and lines[0].startswith("o = "):
                lines, tail = [], f"({lines[0][4:]}) + {self.octets}"
        if lines and self.tell and lines[-1].startswith("o = ") and tail.startswith("o + "):
            tail = f"({lines.pop()[4:]}){tail[1:]}"
        body = [f"        {line}" for line in lines]
        return "\n".join(["    " + self.head, *body, f"        return {tail}"])

    def nested(self, type_: Type, path: str) -> None:
        # cdr_size runs before pack_into, and no caller converts an AttributeError.
        if self.tell and fixed_size(registry.message(type_.name)) is None:
            self.lines += [
                f"if {path}.__class__ is not {self.aliases[type_.name]}:",
                f"    raise TypeError{self.tell}",
            ]
        super().nested(type_, path)


def _beyond(var: str, low: int, high: int) -> str:
    """Return an expression that is not 0 if an integer is out of its range.

    On MicroPython a literal that is no small integer takes 16 bytes at each place in the code, so
    the limits are tested by shifts.
    """
    bits = high.bit_length()
    if not low:
        return f"{var} >> {bits}"
    return f"{var} + {high + 1} >> {bits + 1}" if bits < 30 else f"({var} >> {bits}) + 1 >> 1"


class _Packer(BoardWalker):
    def __init__(self, attribute: Attribute, aliases: Aliases, calls: Names) -> None:
        super().__init__(attribute, aliases, calls)
        self.args: list[str] = []
        self.types: dict[str, list[str]] = {}  # by class, the variables that must be of it
        self.beyond: list[str] = []  # expressions that are true if a value is out of range
        self.late = calls.lean  # classes are checked only before the last run
        self.rows: dict[int, list[str]] = {}
        self.zeros: tuple[int, str] | None = None  # the line of a string's NUL, and its offset
        self.padded: tuple[int, int] | None = None  # the line of the padding, and its mask

    def method(self, message: Message) -> str:
        self.walk(message, "self")
        self.late = False
        self.flush()
        tail = "return o"
        if self.lines[-1].startswith("o += "):
            tail = "return o + " + self.lines.pop()[5:]
        elif self.lines[-1].startswith("o = "):
            tail = "return " + self.lines.pop()[4:]
        return "\n".join(
            [
                "    " + self.calls.pack_head,
                *(f"        {line}" for line in self.lines),
                f"        {tail}",
            ]
        )

    def nothing(self) -> None:
        self.put("B", "0", 1, 1)

    def align(self, alignment: int) -> None:
        if self.calls.lean and not self.codes and self.at.padding(alignment) is None:
            self.pad(alignment)  # the checks wait for the values
            self.at.know(alignment)
        else:
            super().align(alignment)

    def pad(self, alignment: int) -> None:
        if not self.calls.lean:
            self.check()
        mask = alignment - 1
        if self.zeros and not any(
            line.lstrip().startswith("o ") for line in self.lines[self.zeros[0] + 3 :]
        ):
            # One call writes the NUL and the padding if at least 7 octets follow, see flush.
            self.padded = len(self.lines), mask
        self.lines += self.zero(mask)

    def zero(self, mask: int) -> list[str]:
        if self.calls.lean:
            return [f"while o - start & {mask}:", "    buf[o] = 0", "    o += 1"]
        return [f"if o - start & {mask}:", f"    o = _align(buf, o, start, {mask})"]

    def put(self, code: str, arg: str, octets: int, alignment: int) -> None:
        self.advance([code], octets, alignment)
        self.args.append(arg)
        if len(self.args) >= RUN_VALUES:
            self.flush()

    def check(self) -> None:
        types = []
        if not self.late:
            for alias, variables in self.types.items():
                types.append(" is ".join([*(f"{var}.__class__" for var in variables), alias]))
            self.types.clear()
        if types:
            wrong = f"not ({' and '.join(types)})"
            if len(types) == 1 and types[0].count(" is ") == 1:
                wrong = types[0].replace(" is ", " is not ")
            self.lines += [f"if {wrong}:", f"    raise TypeError{self.calls.tell}"]
        if self.beyond:
            wrong = " or ".join(self.beyond)
            self.lines += [f"if {wrong}:", f"    raise ValueError{self.calls.tell}"]
            self.beyond.clear()

    def flush(self) -> None:
        self.check()
        if self.zeros and self.padded and self.octets >= 7:
            (nul, place), (line, mask) = self.zeros, self.padded
            self.lines[nul] = f'_pack_into("8s", buf, {place}, b"")'
            self.lines[line : line + len(self.zero(mask))] = [f"o += start - o & {mask}"]
        self.zeros = self.zeros if not self.octets else None
        self.padded = None
        for size, rows in self.rows.items():
            classes = " is ".join([*(f"{row}.__class__" for row in rows), "_Row"])
            sizes = " == ".join([*(f"{row}.n" for row in rows), str(size)])
            self.lines.append(f"if not ({classes} and {sizes}):")
            self.lines += [f"    {row} = _row({row}, {size})" for row in rows]
        self.rows.clear()
        if self.codes:
            call = f'_pack_into("<{runs(self.codes)}", buf, o, {", ".join(self.args)})'
            self.lines += [call, f"o += {self.octets}"]
            self.codes, self.args, self.octets = [], [], 0

    def number(self, name: str, path: str) -> None:
        code, octets = CODES[name]
        if limits := range_of(name):
            path = self.local("i", f"_octet({path})" if name == "byte" else path)
            self.beyond.append(_beyond(path, *limits))
        self.put(code, path, octets, octets)

    def nested(self, type_: Type, path: str) -> None:
        var = self.local("m", path)
        # No heirs: isinstance takes longer, and there are many.
        self.types.setdefault(self.aliases[type_.name], []).append(var)
        nested = self.in_place(type_.name)
        if nested is None:
            self.late = False
            self.flush()
            self.late = self.calls.lean
            self.lines.append(f"o = {var}.{self.calls.pack}(buf, o, start)")
            self.at.know(1)
        elif is_doubles(nested):
            octets = 8 * len(nested.fields)
            self.put(f"{octets}s", f"{var}._d", octets, 8)
        elif nested.type_name in HALVES:
            self.halves(var)
        else:
            self.walk(nested, var)

    def halves(self, var: str) -> None:
        high = self.local("i", f"{var}.high")
        self.beyond.append(f"{high} + 32768 >> 16")
        self.put("H", f"{var}.low", 2, 4)
        self.put("h", high, 2, 2)
        self.number("uint32", f"{var}.nanosec")

    def text(self, type_: Type, path: str) -> None:
        wide = type_.name == "wstring"
        # The lookup in the cache saves a call for a string that is sent repeatedly.
        octets = f"_wide({path})" if wide else f"_utf8_of.get({path}) or _utf8({path})"
        data = self.local("s", octets)
        length = self.local("n", f"len({data})" + (" >> 2" if wide else ""))
        if type_.string_bound:
            self.beyond.append(f"{length} > {type_.string_bound}")
        self.put("I", length if wide else f"{length} + 1", 4, 4)
        self.flush()
        if wide:
            self.lines.append(f"o = _put_bytes(buf, o, {data})")
        else:  # the NUL first: struct checks the length of the buffer
            if self.calls.lean:
                self.zeros = len(self.lines), f"o + {length}"
            self.lines += [
                f'_pack_into("B", buf, o + {length}, 0)',
                f"buf[o : o + {length}] = {data}",
                f"o += {length} + 1",
            ]
        self.at.know(4 if wide else 1)

    def fixed(self, type_: Type, path: str) -> None:
        if is_octets(type_):
            var = self.local("v", f"_octets({path})")
            self.beyond.append(f"len({var}) != {type_.size}")
            self.put(f"{type_.size}s", var, type_.size, 1)
        elif type_.name == "float64":
            self.align(8)
            var = self.local("v", path)
            self.rows.setdefault(type_.size, []).append(var)
            self.put(f"{8 * type_.size}s", var, 8 * type_.size, 8)
        else:
            var = self.local("v", path)
            self.beyond.append(f"len({var}) != {type_.size}")
            self.elements(type_, var)

    def sequence(self, type_: Type, path: str) -> None:
        octets = is_octets(type_)
        var = self.local("v", f"_wire_bytes({path})" if octets else path)
        if type_.size:
            self.beyond.append(f"len({var}) > {type_.size}")
        self.put("I", f"len({var})", 4, 4)
        self.flush()
        if octets:
            self.lines.append(f"o = _put_bytes(buf, o, {var})")
            self.at.know(1)
        else:
            self.elements(type_, var)

    def elements(self, type_: Type, var: str) -> None:
        """Write the elements of an array, except octets and rows."""
        if type_.name in ("string", "wstring"):
            self.flush()
            wide = type_.name == "wstring"
            self.lines.append(f"o = _put_texts(buf, o, start, {var}, {type_.string_bound}, {wide})")
            self.at.know(1)
        elif type_.primitive:
            code, octets = CODES[type_.name]
            limits = range_of(type_.name) or ()
            tail = "".join(f", {limit}" for limit in limits)
            put = f'_put_numbers(buf, o, {var}, "<{code}"{tail})'
            if type_.array == "fixed":
                self.flush()  # before the padding: MicroPython writes none after the last value
                padding = self.at.padding(octets)
                if padding is None:
                    self.at.know(octets)
                else:
                    self.at.advance(padding)
                if padding != 0:
                    self.pad(octets)
                self.at.advance(octets * type_.size)
            else:
                self.at.know(4)
                if octets == 8:  # without elements there is no padding
                    put = put.replace("o,", f"_align(buf, o, start, 7) if len({var}) else o,", 1)
                self.at.know(min(octets, 4))
            self.lines.append(f"o = {put}")
        else:
            self.flush()
            self.lines += [
                f"for e in {var}:",
                f"    if not isinstance(e, {self.aliases[type_.name]}):",
                f"        raise TypeError{self.calls.tell}",
                f"    o = e.{self.calls.pack}(buf, o, start)",
            ]
            self.at.know(1)
