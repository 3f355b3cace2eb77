"""Writes a class's codec methods: ``cdr_size``, ``pack_into``, ``unpack_from``. Host only."""

from __future__ import annotations

from typing import Final

from . import registry
from .layout import (
    CODES,
    INLINE_LEAVES,
    Aliases,
    fixed_size,
    is_octets,
    least_size,
    leaves,
)
from .parse import INTEGERS, Message, Type
from .walk import Attribute, Run, Walker

RUN_VALUES: Final = 64
"""Values after which a struct call ends; MicroPython passes at most 255 arguments."""
UNROLL: Final = 36
"""Fixed arrays up to this size (a covariance) are packed within the run, without allocation."""


def sizer(message: Message, attribute: Attribute) -> str:
    """Return the source of ``cdr_size``."""
    return Sizer(attribute, Aliases()).method(message)


def packer(message: Message, attribute: Attribute, aliases: Aliases) -> str:
    """Return the source of ``pack_into``."""
    return _Packer(attribute, aliases).method(message)


def unpacker(message: Message, aliases: Aliases) -> str:
    """Return the source of ``unpack_from``."""
    return _Unpacker(aliases).method(message)


def _inlined(type_: Type) -> Message | None:
    nested = registry.message(type_.name)
    return nested if leaves(nested) <= INLINE_LEAVES else None


def runs(codes: list[str]) -> str:
    """Join struct codes to a format: ``["d", "d", "x", "I"]`` → ``2dxI``."""
    out: list[tuple[str, int]] = []
    for code in codes:
        if out and out[-1][0] == code and len(code) == 1:
            out[-1] = (code, out[-1][1] + 1)
        else:
            out.append((code, 1))
    return "".join(code if count == 1 else f"{count}{code}" for code, count in out)


def range_of(name: str) -> tuple[int, int] | None:
    """Return the limits of an integer type or bool, or None for other types."""
    return (0, 1) if name == "bool" else INTEGERS.get(name)


def within(var: str, low: int, high: int) -> str:
    """Return the condition that an integer is in range.

    On MicroPython a literal that is no small integer takes 16 bytes at each place in the code, so
    wide limits are tested by shifts.
    """
    bits = high.bit_length()
    if bits < 30:
        return f"{low} <= {var} <= {high}"
    return f"-1 <= {var} >> {bits} <= 0" if low else f"{var} >> {bits} == 0"


class Sizer(Walker):
    """Writes ``cdr_size``: constant sizes are summed here, variable sizes at run time."""

    called = "cdr_size"
    """The method of nested messages that are not inlined."""

    def method(self, message: Message) -> str:
        """Return the source of the method for a message."""
        self.walk(message, "self")
        tail = f"o + {self.octets}" if self.octets else "o"
        if not any(" self." in line or "(self." in line for line in self.lines):
            body = [f"        {line}" for line in self.lines]
            return "\n".join(["    def cdr_size(self, o=0):", *body, f"        return {tail}"])
        body = [f"            {line}" for line in self.lines]
        return "\n".join(
            [
                "    def cdr_size(self, o=0):",
                "        try:",
                *body,
                f"            return {tail}",
                "        except Exception as error:",
                "            return _fault(self, error)",
            ]
        )

    def add(self, octets: int, alignment: int) -> None:
        """Add octets of a constant size, aligned."""
        self.advance([], octets, alignment)

    def pad(self, alignment: int) -> None:
        """Write the alignment of the offset at run time."""
        self.lines.append(f"o = (o + {alignment - 1}) & -{alignment}")

    def flush(self) -> None:
        """Write the sum of the constant sizes gathered so far."""
        if self.octets:
            self.lines.append(f"o += {self.octets}")
            self.octets = 0

    def nothing(self) -> None:
        """Add the one octet of a message without fields."""
        self.add(1, 1)

    def number(self, name: str, path: str) -> None:
        """Add the size of a number."""
        octets = CODES[name][1]
        self.add(octets, octets)

    def text(self, type_: Type, path: str) -> None:
        """Write the size of a string, with its length and its NUL."""
        self.add(4, 4)
        wide = type_.name == "wstring"
        text = f"len(_wide({path}))" if wide else f"len(_utf8({path}))"
        self.lines.append(f"o += {text} + {self.octets + (0 if wide else 1)}")
        self.octets = 0
        self.at.know(4 if wide else 1)

    def nested(self, type_: Type, path: str) -> None:
        """Add the sizes of a nested message's fields, or write a call of its method."""
        if nested := _inlined(type_):
            self.walk(nested, path)
        else:
            self.flush()
            self.lines.append(f"o = {path}.{self.called}(o)")
            self.at.know(1)

    def fixed(self, type_: Type, path: str) -> None:
        """Add the size of a fixed array."""
        if type_.name in ("string", "wstring"):
            self.texts(type_, path)
        elif not type_.primitive:
            self.messages(type_, path)
        else:
            octets = CODES[type_.name][1]
            self.add(octets * type_.size, octets)

    def sequence(self, type_: Type, path: str) -> None:
        """Write the size of a sequence, with its length."""
        self.add(4, 4)
        if type_.name in ("string", "wstring"):
            self.texts(type_, path)
        elif not type_.primitive:
            self.messages(type_, path)
        else:
            octets = CODES[type_.name][1]
            self.flush()
            if octets == 8:
                self.lines += [
                    f"n = len({path})",
                    "if n:",
                    "    o = ((o + 7) & -8) + 8 * n",
                ]
            elif octets == 1:
                self.lines.append(f"o += len({path})")
            else:
                self.lines.append(f"o += {octets} * len({path})")
            self.at.know(min(octets, 4))

    def texts(self, type_: Type, path: str) -> None:
        """Write the size of an array's strings."""
        self.flush()
        self.lines.append(f"o = _size_texts(o, {path}, {type_.name == 'wstring'})")
        self.at.know(1)

    def messages(self, type_: Type, path: str) -> None:
        """Write the size of an array's messages."""
        self.flush()
        nested = registry.message(type_.name)
        if fixed := fixed_size(nested):
            size, alignment = fixed
            self.lines += [
                f"n = len({path})",
                "if n:",
                f"    o = ((o + {alignment - 1}) & -{alignment}) + {size} * n",
            ]
        else:
            self.lines += [f"for e in {path}:", f"    o = e.{self.called}(o)"]
        self.at.know(1)


class _Packer(Walker):
    """Writes ``pack_into``: one ``struct.pack_into`` for each run."""

    def __init__(self, attribute: Attribute, aliases: Aliases) -> None:
        super().__init__(attribute, aliases)
        self.args: list[str] = []
        self.checks: list[str] = []

    def method(self, message: Message) -> str:
        self.walk(message, "self")
        self.flush()
        return "\n".join(
            [
                "    def pack_into(self, buf, offset, start):",
                "        try:",
                "            o = offset",
                *(f"            {line}" for line in self.lines),
                "            return o",
                "        except Exception as error:",
                "            return _fault(self, error, len(buf) - offset)",
            ]
        )

    def nothing(self) -> None:
        self.put("B", "0", 1, 1)

    def pad(self, alignment: int, indent: str = "") -> None:
        self.lines += [
            f"{indent}while (o - start) & {alignment - 1}:",
            f"{indent}    buf[o] = 0",
            f"{indent}    o += 1",
        ]

    def put(self, code: str, args: str, octets: int, alignment: int, values: int = 1) -> None:
        self.advance([code] * values, octets, alignment)
        self.args.append(args)
        if sum(1 for c in self.codes if c != "x") >= RUN_VALUES:
            self.flush()

    def flush(self) -> None:
        if self.checks:
            self.lines += [f"if not ({' and '.join(self.checks)}):", "    raise ValueError"]
            self.checks = []
        if self.codes:
            call = f'pack_into("<{runs(self.codes)}", buf, o, {", ".join(self.args)})'
            self.lines += [call, f"o += {self.octets}"]
            self.codes, self.args, self.octets = [], [], 0

    def number(self, name: str, path: str) -> None:
        code, octets = CODES[name]
        if limits := range_of(name):
            var = self.local("i", f"_octet({path})" if name == "byte" else path)
            self.checks.append(within(var, *limits))
            path = var
        self.put(code, path, octets, octets)

    def nested(self, type_: Type, path: str) -> None:
        var = self.local("m", path)
        self.lines += [
            f"if not isinstance({var}, {self.aliases[type_.name]}):",
            "    raise TypeError",
        ]
        if nested := _inlined(type_):
            self.walk(nested, var)
            return
        self.flush()
        self.lines.append(f"o = {var}.pack_into(buf, o, start)")
        self.at.know(1)

    def text(self, type_: Type, path: str) -> None:
        wide = type_.name == "wstring"
        data = self.local("s", f"_wide({path})" if wide else f"_utf8({path})")
        length = self.local("n", f"len({data})" + (" >> 2" if wide else ""))
        if type_.string_bound:
            self.checks.append(f"{length} <= {type_.string_bound}")
        self.put("I", length if wide else f"{length} + 1", 4, 4)
        self.flush()
        self.lines.append(f"o = _{'put_bytes' if wide else 'put_text'}(buf, o, {data})")
        self.at.know(4 if wide else 1)

    def fixed(self, type_: Type, path: str) -> None:
        if is_octets(type_):
            var = self.local("v", f"_octets({path})")
            self.checks.append(f"len({var}) == {type_.size}")
            self.put(f"{type_.size}s", var, type_.size, 1)
            return
        var = self.local("v", path)
        self.checks.append(f"len({var}) == {type_.size}")
        if not type_.primitive or type_.name in ("string", "wstring"):
            self.flush()
            self.elements(type_, var)
            return
        code, octets = CODES[type_.name]
        limits = range_of(type_.name)
        if type_.size > UNROLL:
            self.align(octets)
            self.flush()
            self.lines.append(self.array_call(type_, var))
            self.at.advance(octets * type_.size)
            return
        if limits:
            self.checks.append(f"{limits[0]} <= min({var})")
            self.checks.append(f"max({var}) <= {limits[1]}")
        args = ", ".join(f"{var}[{i}]" for i in range(type_.size))
        self.put(code, args, octets * type_.size, octets, type_.size)

    def array_call(self, type_: Type, var: str) -> str:
        limits = range_of(type_.name)
        tail = f", {limits[0]}, {limits[1]}" if limits else ""
        return f'o = _put_array(buf, o, {var}, "{CODES[type_.name][0]}"{tail})'

    def sequence(self, type_: Type, path: str) -> None:
        octets = is_octets(type_)
        var = self.local("v", f"_wire_bytes({path})" if octets else path)
        length = self.local("n", f"len({var})")
        if type_.size:
            self.checks.append(f"{length} <= {type_.size}")
        self.put("I", length, 4, 4)
        self.flush()
        if octets:
            self.lines.append(f"o = _put_bytes(buf, o, {var})")
            self.at.know(1)
        elif type_.primitive and type_.name not in ("string", "wstring"):
            size = CODES[type_.name][1]
            if size == 8:
                self.lines.append(f"if {length}:")
                self.pad(8, "    ")
                self.lines.append("    " + self.array_call(type_, var))
            else:
                self.lines.append(self.array_call(type_, var))
            self.at.know(min(size, 4))
        else:
            self.elements(type_, var)

    def elements(self, type_: Type, var: str) -> None:
        if type_.primitive:
            wide = type_.name == "wstring"
            self.lines.append(f"o = _put_texts(buf, o, start, {var}, {type_.string_bound}, {wide})")
        else:
            self.lines += [
                f"for e in {var}:",
                f"    if not isinstance(e, {self.aliases[type_.name]}):",
                "        raise TypeError",
                "    o = e.pack_into(buf, o, start)",
            ]
        self.at.know(1)


class _Unpacker(Run):
    """Writes ``unpack_from``, the inverse of `_Packer`; its last line builds the whole message."""

    def __init__(self, aliases: Aliases) -> None:
        super().__init__(aliases)
        self.values = 0
        self.tuples = 0

    def method(self, message: Message) -> str:
        built = self.walk(message, "cls")
        self.flush()
        return "\n".join(
            [
                "    @classmethod",
                "    def unpack_from(cls, buf, offset, start, end, little=True):",
                "        if end > len(buf):",
                "            raise _short(end - offset, offset, len(buf))",
                "        o = offset",
                *(f"        {line}" for line in self.lines),
                f"        return {built}, o",
            ]
        )

    def walk(self, message: Message, cls: str) -> str:
        if not message.fields:
            self.take("B", 1, 1)
        return f"{cls}({', '.join(self.value(f.type) for f in message.fields)})"

    def pad(self, alignment: int) -> None:
        self.lines.append(f"o += (start - o) & {alignment - 1}")

    def take(self, code: str, octets: int, alignment: int, values: int = 1) -> tuple[str, int]:
        """Add to the run; returns the run's tuple and the index of the first value in it."""
        codes = [f"{values}{code}"] if values > UNROLL else [code] * values
        self.advance(codes, octets, alignment)
        index = self.values
        self.values += values
        return f"t{self.tuples}", index

    def flush(self) -> None:
        if self.codes:
            text = runs(self.codes)
            self.lines += [
                f"if o + {self.octets} > end:",
                f"    raise _short({self.octets}, o, end)",
                f't{self.tuples} = unpack_from("<{text}" if little else ">{text}", buf, o)',
                f"o += {self.octets}",
            ]
            self.codes, self.values, self.octets = [], 0, 0
            self.tuples += 1

    def value(self, type_: Type) -> str:
        if type_.array == "fixed":
            return self.fixed(type_)
        if type_.array:
            return self.sequence(type_)
        if type_.name in ("string", "wstring"):
            return self.text(type_)
        if type_.primitive:
            code, octets = CODES[type_.name]
            values, index = self.take(code, octets, octets)
            return f"{values}[{index}]" + (" != 0" if type_.name == "bool" else "")
        if nested := _inlined(type_):
            return self.walk(nested, self.aliases[type_.name])
        self.flush()
        var = self.name("m")
        self.lines.append(
            f"{var}, o = {self.aliases[type_.name]}.unpack_from(buf, o, start, end, little)"
        )
        self.at.know(1)
        return var

    def count(self) -> str:
        """Read a length and end the run."""
        values, index = self.take("I", 4, 4)
        self.flush()
        return self.local("n", f"{values}[{index}]")

    def text(self, type_: Type) -> str:
        length = self.count()
        bound = f", {type_.string_bound}" if type_.string_bound else ""
        if type_.name == "wstring":
            var = self.local("s", f"_get_wide(buf, o, {length}, end, little{bound})")
            self.lines.append(f"o += 4 * {length}")
            self.at.know(4)
        else:
            var = self.local("s", f"_get_text(buf, o, {length}, end{bound})")
            self.lines.append(f"o += {length}")
            self.at.know(1)
        return var

    def fixed(self, type_: Type) -> str:
        if is_octets(type_):
            values, index = self.take(f"{type_.size}s", type_.size, 1)
            return f"{values}[{index}]"
        if not type_.primitive or type_.name in ("string", "wstring"):
            self.flush()
            return self.elements(type_, str(type_.size))
        code, octets = CODES[type_.name]
        values, index = self.take(code, octets * type_.size, octets, type_.size)
        part = f"{values}[{index}:{index + type_.size}]"
        return f"[x != 0 for x in {part}]" if type_.name == "bool" else f"list({part})"

    def sequence(self, type_: Type) -> str:
        length = self.count()
        if type_.size:
            self.lines += [
                f"if {length} > {type_.size}:",
                f"    raise _long({length}, {type_.size})",
            ]
        if not type_.primitive or type_.name in ("string", "wstring"):
            return self.elements(type_, length)
        code, size = CODES[type_.name]
        if is_octets(type_):
            var = self.local("v", f"_get_bytes(buf, o, {length}, end)")
        elif type_.name == "bool":
            var = self.local("v", f"_get_bools(buf, o, {length}, end)")
        else:
            if size == 8:
                self.lines += [f"if {length}:", "    o += (start - o) & 7"]
            var = self.local("v", f'_get_array(buf, o, {length}, end, "{code}", {size}, little)')
        self.lines.append(f"o += {length}" if size == 1 else f"o += {size} * {length}")
        self.at.know(min(size, 4))
        return var

    def elements(self, type_: Type, count: str) -> str:
        var = self.name("v")
        if type_.primitive:
            self.lines.append(
                f"{var}, o = _get_texts(buf, o, start, end, {count}, little,"
                f" {type_.string_bound}, {type_.name == 'wstring'})"
            )
        else:
            least = least_size(registry.message(type_.name))
            self.lines += [
                f"if {count} * {least} > end - o:",
                f"    raise _short({count} * {least}, o, end)",
                f"{var} = []",
                f"for _ in range({count}):",
                f"    e, o = {self.aliases[type_.name]}.unpack_from(buf, o, start, end, little)",
                f"    {var}.append(e)",
            ]
        self.at.know(1)
        return var
