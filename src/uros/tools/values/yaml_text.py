"""Plain values as YAML text, byte for byte as ``ros2 topic echo`` prints them.

That is YAML 1.1 in the choices of PyYAML's ``dump`` with ``allow_unicode`` and lines of any
length: strings stay plain where they can be read back as strings, else they are single-quoted,
and double-quoted where they hold something that only an escape can carry, or, other than there,
what is not `printable`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final, Union

from ...printable import is_printable

Value = Union[None, bool, int, float, str, "Sequence[Value]", "Mapping[str, Value]"]

_INDENT: Final = 2
_LINE_BREAK: Final = "\n"
_BREAKS: Final = "\n\x85\u2028\u2029"
_UNPRINTABLE: Final = re.compile(
    "[^\n\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010fffe]"
)
# Quotes other than double ones would lose blanks beside a line break.
_NEEDS_ESCAPES: Final = re.compile(f" [{_BREAKS}]|[{_BREAKS}] ")
# What a plain string must not look like, and, within brackets, must not hold either.
_NOT_PLAIN: Final = re.compile(
    f"---|\\.\\.\\.|[#,\\[\\]{{}}&*!|>'\"%@` ]|[-?:](?: |$)|.*(?:[{_BREAKS}]|: | #|:$| $)",
    re.DOTALL,
)
_NOT_PLAIN_IN_FLOW: Final = re.compile(r"[?:]|.*[,?\[\]{}:]", re.DOTALL)
# What YAML 1.1 reads as something else than a string.
_NO_STRING: Final = re.compile(
    r"""
    yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF  # bool
    | ~|null|Null|NULL|                                                         # null
    | [-+]?0b[0-1_]+ | [-+]?0[0-7_]+ | [-+]?(?:0|[1-9][0-9_]*)                  # int
    | [-+]?0x[0-9a-fA-F_]+ | [-+]?[1-9][0-9_]*(?::[0-5]?[0-9])+
    | [-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?                             # float
    | \.[0-9][0-9_]*(?:[eE][-+][0-9]+)?
    | [-+]?[0-9][0-9_]*(?::[0-5]?[0-9])+\.[0-9_]*
    | [-+]?\.(?:inf|Inf|INF) | \.(?:nan|NaN|NAN)
    | [0-9]{4}-[0-9]{2}-[0-9]{2}                                                # date
    | [0-9]{4}-[0-9][0-9]?-[0-9][0-9]?(?:[Tt]|[ \t]+)[0-9][0-9]?:[0-9]{2}:[0-9]{2}
      (?:\.[0-9]*)?(?:[ \t]*(?:Z|[-+][0-9][0-9]?(?::[0-9]{2})?))?
    | << | =                                                                    # merge, value
    """,
    re.VERBOSE,
)
# All but what stands for itself between double quotes.
_ESCAPED: Final = re.compile(r"[^ !#-\[\]-~\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd]")
_ESCAPES: Final = dict(
    zip('\0\x07\x08\t\n\x0b\x0c\r\x1b"\\\x85\u2028\u2029', '0abtnvfre"\\NLP', strict=True)
)


def dump(value: Value, flow: bool = False) -> str:
    """The document, ending with a line break. ``flow``: sequences in brackets, on one line."""
    lines: list[str] = []
    _block(value, 0, lines, flow)
    return "\n".join(lines) + "\n"


def one_line(value: Value) -> str:
    """The document in braces and brackets, without the line break at its end."""
    return _flow(value, 0)


def _block(value: Value, indent: int, lines: list[str], flow: bool) -> None:
    """Append the lines of a mapping or a sequence in block style, or of a scalar."""
    pad = " " * indent
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            head = pad + _string(key, 0, False) + ":"
            if isinstance(item, Mapping) and item:
                lines.append(head)
                _block(item, indent + _INDENT, lines, flow)
            elif _is_sequence(item) and item and not flow:
                lines.append(head)
                _block(item, indent, lines, flow)
            else:
                lines.append(f"{head} {_inline(item, indent + _INDENT)}")
    elif isinstance(value, Sequence) and not isinstance(value, str) and value and not flow:
        for item in value:
            if (isinstance(item, Mapping) or _is_sequence(item)) and item:
                inner: list[str] = []
                _block(item, indent + _INDENT, inner, flow)
                lines.append(f"{pad}- {inner[0][indent + _INDENT :]}")
                lines += inner[1:]
            else:
                lines.append(f"{pad}- {_inline(item, indent + _INDENT)}")
    else:
        lines.append(pad + _inline(value, indent + _INDENT))


def _is_sequence(value: Value) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _inline(value: Value, indent: int) -> str:
    """A scalar, or a collection in brackets, as empty ones are in block style too."""
    if isinstance(value, (Mapping, Sequence)) and not isinstance(value, str):
        return _flow(value, indent)
    return _scalar(value, indent, False)


def _flow(value: Value, indent: int) -> str:
    inner = indent + _INDENT
    if isinstance(value, Mapping):
        pairs = [f"{_string(key, 0, True)}: {_flow(item, inner)}" for key, item in value.items()]
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join([_flow(item, inner) for item in value]) + "]"
    return _scalar(value, indent, True)


def _scalar(value: Value, indent: int, in_flow: bool) -> str:
    if isinstance(value, str):
        return _string(value, indent, in_flow)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _number(value)
    return str(value)


def _number(value: float) -> str:
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    text = repr(value)
    # YAML 1.1 knows no float without a point.
    return text.replace("e", ".0e") if "." not in text and "e" in text else text


def _string(text: str, indent: int, in_flow: bool) -> str:
    """``indent``: of the lines that follow the first one."""
    if (
        _UNPRINTABLE.search(text)
        or _NEEDS_ESCAPES.search(text)
        or not is_printable(text, _LINE_BREAK)
    ):
        return '"' + "".join(map(_quoted, text)) + '"'
    if (
        _NOT_PLAIN.match(text)
        or _NO_STRING.fullmatch(text)
        or (in_flow and _NOT_PLAIN_IN_FLOW.match(text))
    ):
        return "'" + _single(text, indent) + "'"
    return text


def _single(text: str, indent: int) -> str:
    """Single-quoted, where a line break alone is read as a blank, so it stands doubled."""
    text = text.replace("'", "''")

    def break_lines(match: re.Match[str]) -> str:
        first = "\n" if match[0][0] == "\n" else ""
        return f"{first}{match[0]}{' ' * indent}"

    return re.sub(f"[{_BREAKS}]+", break_lines, text)


def _quoted(char: str) -> str:
    """One character between double quotes."""
    if is_printable(char) and not _ESCAPED.match(char):
        return char
    if char in _ESCAPES:
        return "\\" + _ESCAPES[char]
    code = ord(char)
    if code <= 0xFF:
        return f"\\x{code:02X}"
    return f"\\u{code:04X}" if code <= 0xFFFF else f"\\U{code:08X}"
