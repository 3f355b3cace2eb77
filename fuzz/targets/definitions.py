"""Definitions that a board loads at run time.

Any text is a type, or InterfaceError refuses it with the line; the parser of hosts accepts the same
texts; and messages of the type, decoded from any octets, are the same after encoding and decoding.

The first byte chooses message or service. Texts follow, separated by zeros: the definition, those
of ``Inner`` and ``Other``, which it may nest, and octets of a sample.
"""

import builtins
import re
from collections.abc import Iterator
from random import Random
from typing import Any

from uros.interfaces import dynamic
from uros.interfaces.codec import HEADER, from_cdr, to_cdr
from uros.interfaces.errors import InterfaceError
from uros.interfaces.parse import parse_msg, parse_srv
from uros.interfaces.table import MESSAGE

from .records import MutateBytes
from .world import must

_PLACE = "uros.interfaces."
_PACKAGES = ("std_msgs", "geometry_msgs", "builtin_interfaces")
# A message of more values is not created: "uint8[4294967295] x" is a valid definition.
_MOST_VALUES = 3000


def _import(name: str, *arguments: Any) -> Any:
    """Import generated modules only: a text may name any module."""
    parts = name.removeprefix(_PLACE).split(".")
    if not name.startswith(_PLACE) or parts[0] not in _PACKAGES:
        raise ImportError(name)
    return builtins.__import__(name, *arguments)


def _load(name: str, text: str, others: dict[str, Any]) -> Any:
    """The type that `dynamic` loads from a text, or its error."""
    dynamic.__import__ = _import  # type: ignore[attr-defined]
    try:
        return dynamic.load(name, text, others)
    except InterfaceError as error:
        return error
    finally:
        del dynamic.__import__  # type: ignore[attr-defined]


def _refused(kind: str, text: str) -> "str | None":
    """The error of the parser of hosts; None where it accepts the text."""
    try:
        if kind == "msg":
            parse_msg(text, "fuzz_msgs", "Thing")
        else:
            parse_srv(text, "fuzz_msgs", "Thing")
    except InterfaceError as error:
        return str(error)
    return None


def _values(cls: Any) -> int:
    """The number of values in a default message."""
    count = 1
    for _, code, array, size, of in getattr(cls, "_plan", ()):
        each = _values(of) if code == MESSAGE else 1
        count += each * (size if array == "[" else 0 if array else 1)
    return count


def _play(cls: Any, octets: bytes) -> None:
    if _values(cls) > _MOST_VALUES:
        return
    first = cls()
    must(len(repr(first)) < 100_000, "a text for people")
    sample = to_cdr(first)
    must(len(sample) == 4 + first.cdr_size(), "the size is another")
    must(to_cdr(from_cdr(cls, sample)) == sample, "a default message does not come through")
    for stop in {4, len(sample) // 2, len(sample) - 1}:
        if 4 <= stop < len(sample):
            try:
                from_cdr(cls, sample[:stop])
            except InterfaceError:
                continue
            must(False, "half a sample is taken")
    for header in (HEADER, b"\0\0\0\0"):
        for body in (octets, sample[4:] + octets):
            try:
                message = from_cdr(cls, header + body)
            except InterfaceError:
                continue
            encoded = to_cdr(message)
            must(to_cdr(from_cdr(cls, encoded)) == encoded, "a message does not come through")


def one_input(data: bytes) -> None:
    kind = "srv" if data[:1] and data[0] & 1 else "msg"
    parts = data[1:].split(b"\0", 3) + [b""] * 3
    texts = [part.decode("utf-8", "replace") for part in parts[:3]]
    others: dict[str, Any] = {
        "fuzz_msgs/msg/Inner": texts[1], "fuzz_msgs/msg/Other": texts[2],
    }  # fmt: skip
    name = f"fuzz_msgs/{kind}/Thing"
    loaded = _load(name, texts[0], others)
    if isinstance(loaded, InterfaceError):
        text = str(loaded)
        must(text.startswith("fuzz_msgs/"), f"the definition is not named: {text[:200]}")
        place = text.partition(": ")[0].rpartition(":")
        must(place[2].isdigit() and int(place[2]) <= len(data), "the line is not named")
        must(len(text) < 5 * len(data) + 300, "a text for people")
        if place[0] != name or "give load its class" in text or "ring of types" in text:
            return
    text = texts[0]
    # Boards limit the length of names, and hosts accept 1_0 for a float.
    if (
        text.isascii()
        and all(char.isprintable() or char in "\n\t" for char in text)
        and not re.search(r"\w{201}|[0-9]_[0-9]", text)
    ):
        why = _refused(kind, text)
        if isinstance(loaded, InterfaceError):
            must(why is not None, f"hosts take it: {loaded}")
        else:
            must(why is None, f"hosts refuse it: {why}")
    if isinstance(loaded, InterfaceError):
        return
    octets = parts[3]
    for cls in (loaded,) if kind == "msg" else (loaded.Request, loaded.Response):
        _play(cls, octets)


_LINES = (
    "bool a true", "byte b 5", "char c 65", "int8 d -128", "uint8 e 255", "int16 f -1",
    "uint16 g 0x1F", "int32 h 0b11", "uint32 i 0o17", "int64 j -9223372036854775808",
    "uint64 k 18446744073709551615", "float32 l 1.5e3", "float64 m -inf", "string n 'it\\'s'",
    'wstring o "a#b" # no', "string<=5 p abc", "wstring<=3 q", "int32[3] r [1, 2, 3]",
    "float32[<=4] s [1.5, nan]", "uint8[] t [1,2]", "string[] u ['a, b', \"c\"]", "bool[2] v",
    "Inner w", "Inner[2] x", "Other[<=3] y", "std_msgs/Header z", "geometry_msgs/msg/Point[] aa",
    "int32 LIMIT=5", "string NAME = 'x # y'", "float32 RATE=1.0", "uint8 class", "int8 self",
    "# words", "", "int16[] bb", "float64[2] cc", "int64[<=2] dd", "char[2] ee", "wstring[] ff",
)  # fmt: skip
_WORDS = (
    "---", "[", "]", "[]", "<=", "[<=", "=", " = ", "#", "'", '"', "\\", "\t", "\r", "\ufeff", ",",
    "[1,]", "_", "0x", "-", "+", "9" * 50, "0" * 45 + "1", "4294967295", "4294967296", "1e400",
    "nan", "3.4028235e38", "True", "\\n", "/", "std_msgs/", "/msg/", "Thing", "Inner", "Other",
    "string", "std_msgs/Message", "builtin_interfaces/Time", "cdr_size", "lambda", "é", "😀",
    "\x0b", "\x85", "\u2028", "x" * 300, "\0",
)  # fmt: skip
_ENDS = (b"\0\0\0\0", b"\1\0\0\0", b"\xff\xff\xff\xff", b"\2\0\0\0a\0\0\0", b"\0\0\0\0\0\0\xf0\x7f")


def _packed(kind: int, *parts: "str | bytes") -> bytes:
    return bytes((kind,)) + b"\0".join(
        part if isinstance(part, bytes) else part.encode() for part in parts
    )


def seeds() -> Iterator[tuple[str, bytes]]:
    inner, other = "int8 a 5\nfloat64[] b", "Inner c\nstring d 'x'\n"
    octets = bytes(range(1, 40)) + _ENDS[1] * 3
    yield "all", _packed(0, "\n".join(_LINES), inner, other, octets)
    yield "service", _packed(1, "Inner a\n---\n" + "\n".join(_LINES[:9]), inner, "", octets)
    for number in range(0, len(_LINES), 4):
        some = "\r\n".join(_LINES[number : number + 4])
        yield f"some_{number}", _packed(0, some, inner, other, octets)
    yield "ring", _packed(0, "Inner a", "Other b", "Inner c")
    yield "empty", _packed(0, "")
    yield "large", _packed(0, "uint8[4294967295] a\nInner[60000] b", "uint16 c")


def mutate(data: bytes, random: Random, mutate_bytes: MutateBytes) -> bytes:
    kind = data[0] if data else 0
    if random.random() < 0.05:
        kind ^= 1
    parts = data[1:].split(b"\0", 3)
    index = random.choice((0, 0, 0, random.randrange(len(parts))))
    if index == 3:
        octets = parts[3]
        at = random.randrange(len(octets) + 1)
        if random.random() < 0.5:
            octets = octets[:at] + random.choice(_ENDS) + octets[at:]
        parts[3] = mutate_bytes(octets)
        return _packed(kind, *parts)
    lines = parts[index].split(b"\n")
    at = random.randrange(len(lines))
    draw = random.random()
    if draw < 0.15:
        lines.insert(at, random.choice(_LINES).encode())
    elif draw < 0.25:
        del lines[at]
    elif draw < 0.35:
        lines[at] = random.choice(_LINES).encode()
    elif draw < 0.7:
        where = random.randrange(len(lines[at]) + 1)
        cut = where + random.choice((0, 0, 1, 3))
        lines[at] = lines[at][:where] + random.choice(_WORDS).encode() + lines[at][cut:]
    elif draw < 0.8:
        words = lines[at].split(b" ")
        words[random.randrange(len(words))] = random.choice(
            random.choice(_LINES).encode().split(b" ")
        )
        lines[at] = b" ".join(words)
    else:
        lines[at] = mutate_bytes(lines[at])
    parts[index] = b"\n".join(lines)
    return _packed(kind, *parts)
