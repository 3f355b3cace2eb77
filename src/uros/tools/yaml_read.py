"""YAML text as nested dicts, lists and scalars: the part of it that fills messages.

Collections in brackets and by indentation, plain and quoted scalars, comments: all that `yaml_text`
writes, and what people type. What is read is what PyYAML reads; the rest of YAML (anchors, tags,
block scalars, plain text over several lines) is refused by name. A plain scalar stays the text that
it is, since what ``1`` or ``yes`` means is for the field to say; `resolve` tells what YAML takes it
for.
"""

from __future__ import annotations

import re
from typing import Final, Union

Node = Union["Plain", str, "list[Node]", "dict[str, Node]"]


class Plain(str):
    """A scalar without quotes."""


class YamlError(ValueError):
    """The text is no YAML, or none of this part; says where and what to do."""


# Attack: brackets in brackets, until Python's stack is used up.
_DEEPEST: Final = 64
_BREAKS: Final = "\n\r\x85\u2028\u2029"
_BLANKS: Final = " \t"
_FOREIGN: Final = re.compile(
    "[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
)
_ESCAPES: Final = {
    "0": "\0", "a": "\x07", "b": "\x08", "t": "\t", "\t": "\t", "n": "\n", "v": "\x0b",
    "f": "\x0c", "r": "\r", "e": "\x1b", " ": " ", '"': '"', "/": "/", "\\": "\\",
    "N": "\x85", "_": "\xa0", "L": "\u2028", "P": "\u2029",
}  # fmt: skip
_HEX: Final = {"x": 2, "u": 4, "U": 8}
_REFUSED: Final = {
    "&": "an anchor", "*": "an alias", "!": "a tag", "|": "a block scalar", ">": "a block scalar",
    "%": "a directive", "@": "a reserved sign", "`": "a reserved sign", "?": "a complex key",
}  # fmt: skip


def read(text: str) -> Node:
    """The value of a document; an empty one is `Plain` and empty. Raises YamlError."""
    return _Reader(text).document()


class _Reader:
    def __init__(self, text: str) -> None:
        foreign = _FOREIGN.search(text)
        if foreign:
            raise YamlError(
                f"the character {foreign[0]!a} cannot stand in YAML; in double quotes, write it as"
                " \\x.., \\u.... or \\n"
            )
        self._text = re.sub("\r\n?|\x85", "\n", text)
        self._at = 0
        self._depth = 0

    def document(self) -> Node:
        self._skip(True)
        if self._marker("---"):
            self._at += 3
            self._skip(True)
        value = self._block(-1)
        self._skip(True)
        if self._marker("---") or self._marker("..."):
            self._at += 3
            self._skip(True)
        if not self._is_end():
            raise self._fault("here the value has ended; put longer text in quotes")
        return value

    # --- where we are ---------------------------------------------------------------------

    def _peek(self, ahead: int = 0) -> str:
        """The character there, or nothing behind the end."""
        return self._text[self._at + ahead : self._at + ahead + 1]

    def _is_end(self) -> bool:
        return self._at >= len(self._text)

    def _column(self) -> int:
        return self._at - max(self._text.rfind(it, 0, self._at) for it in "\n\u2028\u2029") - 1

    def _marker(self, what: str) -> bool:
        """Whether a document's begin or end is here."""
        return (
            self._column() == 0
            and self._text.startswith(what, self._at)
            and self._peek(3) in ("", *_BLANKS, *_BREAKS)
        )

    def _fault(self, what: str) -> YamlError:
        near = self._text[self._at : self._at + 20].split("\n")[0]
        line = len(re.findall("[\n\u2028\u2029]", self._text[: self._at])) + 1
        where = f"line {line}, column {self._column() + 1}"
        return YamlError(f"{where}, at {near!r}: {what}" if near else f"{where}: {what}")

    def _skip(self, breaks: bool) -> bool:
        """Pass over blanks and a comment, with ``breaks`` over lines as well; whether any."""
        start = self._at
        while not self._is_end():
            char = self._peek()
            if char in _BLANKS:
                self._at += 1
            elif char == "#" and (self._at == 0 or self._text[self._at - 1] in _BLANKS + _BREAKS):
                while not self._is_end() and self._peek() not in _BREAKS:
                    self._at += 1
            elif breaks and char in _BREAKS:
                self._at += 1
            else:
                break
        return self._at > start

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._fault(f"nested more than {_DEEPEST} deep")

    # --- by indentation -------------------------------------------------------------------

    def _indented(self) -> int:
        """The column of what stands here, first on its line or behind ``- ``."""
        column = self._column()
        if "\t" in self._text[self._at - column : self._at]:
            raise self._fault("a tab stands before it; indent by blanks")
        return column

    def _block(self, parent: int) -> Node:
        """What stands further right than the column ``parent``."""
        column = self._indented()
        if self._is_end() or column <= parent or self._marker("---") or self._marker("..."):
            return Plain("")
        self._deeper()
        value: Node
        if self._is_item():
            value = self._items(column)
        else:
            start = self._at
            value = self._scalar(False)
            if self._is_colon(value, start):
                value = self._pairs(column, value)
            else:
                self._end_of_line()
        self._depth -= 1
        return value

    def _is_item(self) -> bool:
        return self._peek() == "-" and self._peek(1) in ("", *_BLANKS, *_BREAKS)

    def _is_colon(self, key: Node, start: int) -> bool:
        """Whether a key has ended here, which began at ``start``."""
        self._skip(False)
        if self._peek() != ":" or self._peek(1) not in ("", *_BLANKS, *_BREAKS):
            return False
        if not isinstance(key, str) or any(it in _BREAKS for it in self._text[start : self._at]):
            raise self._fault("a name of a field is a word on one line")
        return True

    def _items(self, column: int) -> Node:
        items: list[Node] = []
        while not self._is_end() and self._indented() == column and self._is_item():
            self._at += 1
            self._skip(True)
            items.append(self._block(column))
            self._skip(True)
        return items

    def _pairs(self, column: int, key: Node) -> Node:
        pairs: dict[str, Node] = {}
        while True:
            self._at += 1  # the colon
            self._skip(False)
            value: Node
            if self._is_end() or self._peek() in _BREAKS:
                self._skip(True)
                at_key = not self._is_end() and self._indented() == column
                value = self._block(column - 1 if at_key and self._is_item() else column)
            else:
                if self._is_item():
                    raise self._fault("a list begins on a line of its own, or in [brackets]")
                value = self._scalar(False)
                self._end_of_line()
            self._put(pairs, key, value)
            self._skip(True)
            if self._is_end() or self._indented() != column or self._marker("..."):
                return pairs
            if self._marker("---"):
                return pairs
            start = self._at
            if self._is_item():
                raise self._fault("a name of a field was expected, and a colon")
            key = self._scalar(False)
            if not self._is_colon(key, start):
                raise self._fault("a colon and a blank were expected behind a field's name")

    def _put(self, pairs: dict[str, Node], key: Node, value: Node) -> None:
        if not isinstance(key, str):
            raise self._fault("the name of a field is a word")
        if key == "<<" and isinstance(key, Plain):
            raise self._fault("merging (<<) is not known here; write the fields out")
        if key in pairs:
            raise self._fault(f"{str(key)!r} stands there twice")
        pairs[str(key)] = value

    def _end_of_line(self) -> None:
        self._skip(False)
        if self._peek() == ":":
            raise self._fault("a second colon on the line; put {..} or quotes around the value")
        if not self._is_end() and self._peek() not in _BREAKS:
            raise self._fault("here the value has ended; put longer text in quotes")

    # --- scalars, and collections in brackets ---------------------------------------------

    def _scalar(self, in_flow: bool) -> Node:
        char = self._peek()
        if char == "[":
            return self._sequence()
        if char == "{":
            return self._mapping()
        if char == "'":
            return self._single()
        if char == '"':
            return self._double()
        return self._plain(in_flow)

    def _sequence(self) -> Node:
        self._deeper()
        items: list[Node] = []
        self._at += 1
        self._skip(True)
        while self._peek() != "]":
            start = self._at
            item = self._scalar(True)
            self._skip(True)
            if self._peek() == ":":
                # One pair without braces: [a: 1] is [{a: 1}].
                if any(it in _BREAKS for it in self._text[start : self._at]):
                    raise self._fault("a name of a field is a word on one line")
                pair: dict[str, Node] = {}
                self._put(pair, item, self._flow_value())
                item = pair
            items.append(item)
            self._comma("]")
        self._at += 1
        self._depth -= 1
        return items

    def _mapping(self) -> Node:
        self._deeper()
        pairs: dict[str, Node] = {}
        self._at += 1
        self._skip(True)
        while self._peek() != "}":
            start = self._at
            key = self._scalar(True)
            lines = any(it in _BREAKS for it in self._text[start : self._at])
            self._skip(True)
            if self._peek() != ":":
                hint = ""
                if isinstance(key, Plain) and ":" in key:
                    hint = f"; a blank is missing behind the colon of {str(key)!r}"
                raise self._fault(f"a colon and a value were expected{hint}")
            if lines:
                raise self._fault("a name of a field is a word on one line")
            self._put(pairs, key, self._flow_value())
            self._comma("}")
        self._at += 1
        self._depth -= 1
        return pairs

    def _flow_value(self) -> Node:
        self._at += 1  # the colon
        self._skip(True)
        return Plain("") if self._peek() in (",", "]", "}") else self._scalar(True)

    def _comma(self, closing: str) -> None:
        self._skip(True)
        if self._peek() == ",":
            self._at += 1
            self._skip(True)
        elif self._peek() != closing:
            if self._is_end():
                raise self._fault(f"the {closing} is missing")
            raise self._fault(f"a comma or {closing} was expected; put longer text in quotes")

    def _plain(self, in_flow: bool) -> Plain:
        char, after = self._peek(), self._peek(1)
        ends = ("", *_BLANKS, *_BREAKS)
        if char in _REFUSED and (char != "?" or after in ends or in_flow):
            raise self._fault(f"this would be {_REFUSED[char]}; put the text in quotes")
        if char == "" or char in ",[]{}#" or (char in "-:" and after in ends):
            raise self._fault("a value was expected")
        if char == ":" and in_flow:
            raise self._fault("a name of a field was expected before the colon")
        if in_flow and char == "-" and after in ",[]{}":
            raise self._fault("a value was expected; put a - alone in quotes")
        if self._marker("---") or self._marker("..."):
            raise self._fault("another document begins; give one")
        start = end = self._at
        while True:
            char = self._peek()
            if char in ("", *_BREAKS) or (in_flow and char in ",?[]{}"):
                break
            if char == ":" and self._peek(1) in (*ends, *(",[]{}" if in_flow else "")):
                break
            if char == "#" and self._text[self._at - 1] in _BLANKS:
                break
            self._at += 1
            if char not in _BLANKS:
                end = self._at
        self._at = end
        return Plain(self._text[start:end])

    def _single(self) -> str:
        parts: list[str] = []
        self._at += 1
        while True:
            char = self._peek()
            if char == "'" and self._peek(1) == "'":
                parts.append("'")
                self._at += 2
            elif char == "'":
                self._at += 1
                return "".join(parts)
            else:
                parts.append(self._quoted("'"))

    def _double(self) -> str:
        parts: list[str] = []
        self._at += 1
        while True:
            char = self._peek()
            if char == '"':
                self._at += 1
                return "".join(parts)
            parts.append(self._escape() if char == "\\" else self._quoted('"'))

    def _quoted(self, quote: str) -> str:
        """One character between quotes, or blanks; a line break is a blank, n of them n - 1."""
        if self._is_end():
            raise self._fault(f"the closing {quote} is missing")
        start = self._at
        while self._peek() and self._peek() in _BLANKS:
            self._at += 1
        if self._peek() and self._peek() in _BREAKS:
            first, *others = self._lines()
            return (first if first != "\n" else "" if others else " ") + "".join(others)
        if self._at == start:
            self._at += 1
        return self._text[start : self._at]

    def _lines(self) -> list[str]:
        """Pass over line breaks, and the blanks behind each; the breaks."""
        breaks = []
        while self._peek() and self._peek() in _BREAKS:
            breaks.append(self._peek())
            self._at += 1
            if self._marker("---") or self._marker("..."):
                raise self._fault("another document begins within the quotes")
            while self._peek() and self._peek() in _BLANKS:
                self._at += 1
        return breaks

    def _escape(self) -> str:
        char = self._peek(1)
        if char in _HEX:
            digits = self._text[self._at + 2 : self._at + 2 + _HEX[char]]
            if not re.fullmatch(f"[0-9A-Fa-f]{{{_HEX[char]}}}", digits):
                raise self._fault(f"\\{char} is followed by {_HEX[char]} hexadecimal digits")
            code = int(digits, 16)
            if code > 0x10FFFF:
                raise self._fault("there is no such character")
            self._at += 2 + len(digits)
            return chr(code)
        if char and char in _BREAKS:
            self._at += 1
            return "".join(self._lines()[1:])
        if char not in _ESCAPES:
            raise self._fault("there is no such escape; a backslash is written as \\\\")
        self._at += 2
        return _ESCAPES[char]


# --- what a plain scalar means ------------------------------------------------------------

_BOOLS: Final = re.compile(
    "(yes|Yes|YES|true|True|TRUE|on|On|ON)|no|No|NO|false|False|FALSE|off|Off|OFF"
)
_NULLS: Final = ("", "~", "null", "Null", "NULL")
_INT: Final = re.compile(
    r"(?P<sign>[-+]?)(?:0b(?P<two>[01_]+)|0x(?P<sixteen>[0-9a-fA-F_]+)|0(?P<eight>[0-7_]+)"
    r"|(?P<ten>0|[1-9][0-9_]*)|(?P<sixty>[1-9][0-9_]*(?::[0-5]?[0-9])+))"
)
_FLOAT: Final = re.compile(
    r"[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?"
)
_SIXTIES: Final = re.compile(r"([-+]?)([0-9][0-9_]*(?::[0-5]?[0-9])+\.[0-9_]*)")
_INF: Final = re.compile(r"([-+]?)\.(?:inf|Inf|INF)")
_NAN: Final = (".nan", ".NaN", ".NAN")
_BASES: Final = {"two": 2, "sixteen": 16, "eight": 8, "ten": 10}


def resolve(text: str) -> None | bool | int | float | str:
    """What YAML 1.1 takes a plain scalar for; a date stays text."""
    if text in _NULLS:
        return None
    match = _BOOLS.fullmatch(text)
    if match:
        return match[1] is not None
    match = _INT.fullmatch(text)
    if match:
        return _int(match, text)
    if _FLOAT.fullmatch(text):
        return float(text.replace("_", ""))
    match = _SIXTIES.fullmatch(text)
    if match:
        number = 0.0
        for part in match[2].replace("_", "").split(":"):
            number = number * 60 + float(part)
        return -number if match[1] == "-" else number
    match = _INF.fullmatch(text)
    if match:
        return float(match[1] + "inf")
    return float("nan") if text in _NAN else str(text)


def _int(match: re.Match[str], text: str) -> int | str:
    number = 0
    try:
        if match["sixty"]:
            for part in match["sixty"].replace("_", "").split(":"):
                number = number * 60 + int(part)
        for name, base in _BASES.items():
            if match[name]:
                number = int(match[name].replace("_", ""), base)
    except ValueError:  # underscores alone, or more digits than Python reads
        return str(text)
    return -number if match["sign"] == "-" else number
