"""Writes the ``_load`` method of a board's class, see `emit_board`. Host only."""

from __future__ import annotations

import re
from typing import Final

from . import registry
from .board_walk import HALVES, BoardWalker, Names, is_doubles
from .emit import runs
from .layout import CODES, Aliases, is_octets, least_size
from .parse import Message, Type
from .walk import Attribute

_LOADERS: Final = {
    "_load": ["    def _load(self, buf, o, start, end, little):"],
    "unpack_into": [
        "    def unpack_into(self, buf, o, start, end, little=True):",
        "        buf = memoryview(buf)[:end]",
        "        end = len(buf)",
    ],
    "unpack_from": [
        "    @classmethod",
        "    def unpack_from(cls, buf, o, start, end, little=True):",
        "        self = cls()",
        "        buf = memoryview(buf)[:end]",
        "        end = len(buf)",
    ],
}


VIEW: Final = "[: end if little else 0]"
"""Slice of the buffer in lean classes: empty for big-endian data."""


class Loader(BoardWalker):
    """The inverse of `emit_board._Packer`. It checks a run's length before it stores any value."""

    def __init__(self, attribute: Attribute, aliases: Aliases, calls: Names) -> None:
        super().__init__(attribute, aliases, calls)
        self.lean = calls.lean
        self.fresh = False  # whether all fields have their values from the constructor
        self.mask = 0
        self.targets: list[str] = []
        self.then: list[str] = []  # the lines after the run's numbers
        self.rows = False  # whether these lines copy float64 values

    def method(self, message: Message, load: str) -> str:
        """Return the source of the method; ``load`` is a key of `_LOADERS`."""
        self.fresh = self.lean and load == "unpack_from"
        self.walk(message, "self")
        self.flush()
        tail = "return self, " if load == "unpack_from" else "return "
        if self.lines[-1].startswith("o += "):
            tail += "o + " + self.lines.pop()[5:]
        elif self.lines[-1].startswith("o = "):
            tail += self.lines.pop()[4:]
        else:
            tail += "o"
        head = [line.replace("[:end]", VIEW) if self.lean else line for line in _LOADERS[load]]
        if head[-1].endswith("end = len(buf)") and not re.search(r"\bend\b", " ".join(self.lines)):
            head.pop()
        return "\n".join(
            [
                *head,
                *(f"        {line}" for line in self.lines),
                f"        {tail}",
            ]
        )

    def nothing(self) -> None:
        """Read the one octet of a message without fields."""
        self.advance(["x"], 1, 1)

    def pad(self, alignment: int) -> None:
        """Note the alignment, which `flush` writes before the run."""
        self.mask = alignment - 1

    def take(self, name: str, target: str) -> None:
        """Add a number to the run; ``target`` is the variable it is assigned to."""
        code, octets = CODES[name]
        self.advance([code], octets, octets)
        self.targets.append(target)

    def flush(self) -> None:
        """Write the length check of the run, its reading, and the lines of ``then``."""
        if self.lean and self.octets:
            if self.mask:
                self.lines.append(f"o += start - o & {self.mask}")
                self.mask = 0
            if self.rows and not self.targets:
                self.lines.append("v = buf[o:]")
                self.lines += [f"if len(v) < {self.octets}:", "    raise ValueError"]
                self.then = [
                    line.replace("buf[o :]", "v").replace("buf[o + ", "v[") for line in self.then
                ]
            elif self.rows or not self.targets:  # else struct checks the length
                self.lines += [f"if o + {self.octets} > len(buf):", "    raise ValueError"]
        elif self.octets:
            room = f"_room(o, start, {self.mask}, {self.octets}, end)"
            self.lines.append(f"o = {room}" if self.mask else room)
            self.mask = 0
        if self.targets:
            codes = list(self.codes)
            while codes[-1].endswith("x"):
                codes.pop()
            tail = "[0]" if len(self.targets) == 1 else ""
            self.lines.append(
                f"{', '.join(self.targets)} = {self.get('<' + runs(codes), 'o')}{tail}"
            )
        self.lines += self.then
        if self.octets:
            self.lines.append(f"o += {self.octets}")
        self.codes, self.targets, self.then, self.octets = [], [], [], 0
        self.rows = False

    def get(self, fmt: str, place: str) -> str:
        """Return the expression that reads a struct format at an offset."""
        if self.lean:
            return f'_unpack_from("{fmt}", buf, {place})'
        return f'_get("{fmt}", buf, {place}, little)'

    def aligned(self, alignment: int) -> None:
        """End the run and align."""
        self.align(alignment)
        self.flush()
        if self.mask:
            self.lines.append(f"o += start - o & {self.mask}")
            self.mask = 0

    def number(self, name: str, path: str) -> None:
        """Read a number; a bool is compared with 0 afterwards."""
        self.take(name, path)
        if name == "bool":
            self.then.append(f"{path} = {path} != 0")

    def nested(self, type_: Type, path: str) -> None:
        """Read a nested message in place, or by a call of its ``_load``."""
        nested = self.in_place(type_.name)
        if nested is None:
            self.flush()
            self.lines.append(f"o = {path}._load(buf, o, start, end, little)")
            self.at.know(1)
        elif is_doubles(nested):
            octets = 8 * len(nested.fields)
            place = self.advance([f"{octets}x"], octets, 8)
            self.rows = True
            if self.lean:
                self.then.append(f'_pack_into("{octets}s", {path}._d, 0, buf[{_at(place)} :])')
            else:
                self.then.append(f'_fill({path}._d, "{octets}s", buf, {_at(place)}, little)')
        elif nested.type_name in HALVES:
            var = self.local("m", path)
            self.halves(var)
        else:
            self.walk(nested, self.local("m", path))

    def halves(self, var: str) -> None:
        """Read a Time or a Duration, whose seconds are two halves."""
        self.align(4)
        place = self.octets
        self.take("uint16", f"{var}.low")
        self.take("int16", f"{var}.high")
        self.take("uint32", f"{var}.nanosec")
        if self.lean:
            return
        # In big-endian data the high half comes first.
        seconds = f'_get("<i", buf, {_at(place)}, little)[0]'
        self.then += ["if not little:", f"    {var}._set_sec({seconds})"]

    def count(self) -> str:
        """Read a length and end the run."""
        var = self.name("n")
        self.take("uint32", var)
        self.flush()
        return var

    def text(self, type_: Type, path: str) -> None:
        """Read a string; an equal text stays the same object."""
        length = self.count()
        bound = f", {type_.string_bound}" if type_.string_bound else ""
        if type_.name == "wstring":
            self.lines.append(f"{path} = _get_wide(buf, o, {length}, end, little{bound})")
            self.lines.append(f"o += 4 * {length}")
            self.at.know(4)
        elif self.fresh and not bound:
            self.lines += [f"{path} = _new_text(buf, o, {length})", f"o += {length}"]
            self.at.know(1)
        else:
            self.lines.append(f"{path} = _load_text(buf, o, {length}, end, {path}{bound})")
            self.lines.append(f"o += {length}")
            self.at.know(1)

    def fixed(self, type_: Type, path: str) -> None:
        """Read a fixed array."""
        size = type_.size
        if is_octets(type_):
            self.advance([f"{size}s"], size, 1)
            self.targets.append(path)
        elif type_.name == "float64":
            place = self.advance([f"{8 * size}x"], 8 * size, 8)
            self.rows = True
            if not self.lean:
                self.then.append(
                    f'{path} = _load_row({path}, {size}, "{8 * size}s", buf, {_at(place)}, little)'
                )
                return
            var = path
            if not self.fresh:
                var = self.name("v")
                self.then += [
                    f"{var} = {path}",
                    f"if not ({var}.__class__ is _Row and {var}.n == {size}):",
                    f"    {var} = {path} = _row(None, {size})",
                ]
            self.then.append(f'_pack_into("{8 * size}s", {var}, 0, buf[{_at(place)} :])')
        else:
            self.elements(type_, path, str(size))

    def sequence(self, type_: Type, path: str) -> None:
        """Read a sequence, after a check of its bound."""
        length = self.count()
        if type_.size:
            self.lines += [
                f"if {length} > {type_.size}:",
                f"    raise _long({length}, {type_.size})",
            ]
        if is_octets(type_):
            self.lines.append(f"{path} = _get_bytes(buf, o, {length}, end)")
            self.lines.append(f"o += {length}")
            self.at.know(1)
        else:
            self.elements(type_, path, length)

    def elements(self, type_: Type, path: str, count: str) -> None:
        """Read the elements of an array, except octets and rows."""
        if type_.name in ("string", "wstring"):
            self.flush()
            self.lines.append(
                f"{path}, o = _get_texts(buf, o, start, end, {count}, little,"
                f" {type_.string_bound}, {type_.name == 'wstring'})"
            )
            self.at.know(1)
        elif type_.primitive:
            self.numbers(type_, path, count)
        else:
            self.flush()
            least = least_size(registry.message(type_.name))
            self.lines += [
                f"if {count} * {least} > end - o:",
                f"    raise _short({count} * {least}, o, end)",
                "v = []",
                f"for _ in range({count}):",
                f"    e = {self.aliases[type_.name]}()",
                "    o = e._load(buf, o, start, end, little)",
                "    v.append(e)",
                f"{path} = v",
            ]
            self.at.know(1)

    def numbers(self, type_: Type, path: str, count: str) -> None:
        """Read an array of numbers."""
        code, size = CODES[type_.name]
        if type_.array == "fixed":
            self.aligned(size)
        elif size == 8:  # without elements there is no padding
            self.lines += [f"if {count}:", "    o += start - o & 7"]
        if type_.name == "bool":
            value = f"_get_bools(buf, o, {count}, end)"
        else:
            value = f'_get_array(buf, o, {count}, end, "{code}", {size}, little)'
            if type_.array == "fixed":
                value = f"list({value})"
        self.lines.append(f"{path} = {value}")
        self.lines.append(f"o += {count}" if size == 1 else f"o += {size} * {count}")
        if type_.array == "fixed":
            self.at.advance(size * type_.size)
        else:
            self.at.know(min(size, 4))


def _at(place: int) -> str:
    return f"o + {place}" if place else "o"
