"""Reads a value that a board printed by ``repr``: None, a bool, an int, a text, lists and tuples.

`ast.literal_eval` is not used: its parser takes a hundred times the memory of its input, and the
device that answers may be untrusted.
"""

from __future__ import annotations

import re
from typing import Final, Union

Literal = Union[None, bool, int, str, "list[Literal]", "tuple[Literal, ...]"]

# Attack: unlimited nesting, or unlimited items. A board cannot hold more paths than MAX_ITEMS.
MAX_DEPTH: Final = 4
MAX_ITEMS: Final = 10_000

_TOKEN: Final = re.compile(
    r"""\s*(?:
        (?P<word>None|True|False)
        | (?P<int>-?(?:0|[1-9][0-9]{0,19}))
        | (?P<text>'[^'\\]*(?:\\.[^'\\]*)*'|"[^"\\]*(?:\\.[^"\\]*)*")
        | (?P<mark>[][(),])
    )""",
    re.VERBOSE,
)
_ESCAPE: Final = re.compile(
    r"\\(?:(?P<code>x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{8})|(?P<char>.?))", re.DOTALL
)
_CHARS: Final = {"n": "\n", "r": "\r", "t": "\t", "\\": "\\", "'": "'", '"': '"'}
_WORDS: Final[dict[str, Literal]] = {"None": None, "True": True, "False": False}


def parse(text: str) -> Literal:
    """Parse one value; raise ValueError if it is invalid, too deep or has too many items."""
    text = text.rstrip()
    open_: list[tuple[str, list[Literal]]] = [("", [])]  # open brackets and their items
    after_comma = True
    at = items = 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            raise ValueError("this is no value")
        at = token.end()
        mark = token["mark"]
        bracket, inside = open_[-1]
        if mark == ",":
            if after_comma or not bracket:
                raise ValueError("a comma where none belongs")
            after_comma = True
            continue
        value: Literal
        if mark in (")", "]"):
            if bracket + mark not in ("()", "[]"):
                raise ValueError("brackets that do not fit")
            if bracket == "(" and len(inside) == 1 and not after_comma:
                value = inside[0]
            else:
                value = tuple(inside) if bracket == "(" else inside
            open_.pop()
            open_[-1][1].append(value)
            after_comma = False
            continue
        items += 1
        if not after_comma or items > MAX_ITEMS:
            raise ValueError("more than there may be")
        if mark:
            if len(open_) > MAX_DEPTH:
                raise ValueError("too deep")
            open_.append((mark, []))
            continue
        if token["word"]:
            value = _WORDS[token["word"]]
        elif token["int"]:
            value = int(token["int"])
        else:
            value = _text(token["text"])
        inside.append(value)
        after_comma = False
    if len(open_) > 1 or len(open_[0][1]) != 1:
        raise ValueError("this is not one value")
    return open_[0][1][0]


def _text(token: str) -> str:
    return _ESCAPE.sub(_unescape, token[1:-1])


def _unescape(match: re.Match[str]) -> str:
    if match["code"]:
        return chr(min(int(match["code"][1:], 16), 0x110000))  # ValueError above U+10FFFF
    if match["char"] not in _CHARS:
        raise ValueError("an escape that repr does not write")
    return _CHARS[match["char"]]
