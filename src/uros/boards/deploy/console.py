"""Extracts the text of a board's console line for a terminal, and explains errors in it.

A board with one line for console and agent prints between its frames: frames are recognized by
their checksum, removed and counted. Control characters that a terminal would obey are escaped.
"""

from __future__ import annotations

import codecs
import re
from typing import Final

from ...printable import printable
from ...wire.framing import Deframer

_FLAG: Final = 0x7E
_ESCAPE: Final = 0x7D
# Flag, two addresses, two octets of length, payload, two octets of checksum; each octet except the
# flag may be escaped.
_HEAD: Final = 4
_TAIL: Final = 2
# Limit of a board's message, in octets: the start of a longer one is text that contains "~".
_LONGEST: Final = 2048
# Control characters that pass: tab, new line, carriage return, backspace, bell.
_HARMLESS: Final = "\t\n\r\b\a"
# Escape sequences that pass: the prompt's line editor needs cursor left and right and erase to the
# end of the line; programs need colors. Attack: sequences that set titles, the clipboard or keys,
# or that make the terminal send an answer as if a user typed it.
_SEQUENCE: Final = re.compile(r"\x1b\[(?:[0-9]{0,3}[CDK]|[0-9;]{0,16}m)")
_BEGUN: Final = re.compile(r"\x1b(?:\[[0-9;]{0,16})?\Z")


class ConsoleText:
    """Converts octets of a line, in pieces of any size, to text; ``frames`` counts valid frames."""

    def __init__(self) -> None:
        self.frames = 0
        self._held = b""  # from a flag on, while it may become a frame
        self._begun = ""  # the start of an escape sequence
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    @property
    def holding(self) -> bool:
        """Whether octets wait for the rest of a frame or escape sequence; see `flush`."""
        return bool(self._held or self._begun)

    def feed(self, data: bytes) -> str:
        """Return the text in ``data``; octets that may begin a frame are held back."""
        data, self._held = self._held + data, b""
        out = bytearray()
        at = 0
        while (flag := data.find(_FLAG, at)) >= 0:
            out += data[at:flag]
            stop = _frame_end(data, flag)
            if stop is None:
                self._held = data[flag:]
                at = len(data)
                break
            if stop:
                self.frames += 1
                at = stop
            else:
                out.append(_FLAG)
                at = flag + 1
        out += data[at:]
        return self._text(bytes(out))

    def flush(self) -> str:
        """Return the held octets as text, when the line was silent too long for a frame.

        The first octet is text; the rest is parsed again and may be held again.
        """
        held, self._held = self._held, b""
        text = self._text(held[:1]) + (self.feed(held[1:]) if held[1:] else "")
        begun, self._begun = self._begun, ""
        return text + printable(begun)

    def _text(self, data: bytes) -> str:
        text = self._begun + self._decoder.decode(data)
        begun = _BEGUN.search(text)
        self._begun = begun[0] if begun else ""
        text = text[: len(text) - len(self._begun)]
        out, at = [], 0
        for sequence in _SEQUENCE.finditer(text):
            out += [printable(text[at : sequence.start()], _HARMLESS), sequence[0]]
            at = sequence.end()
        return "".join([*out, printable(text[at:], _HARMLESS)])


# Errors of a board, and what they mean for a program that uros has deployed.
_HINTS: Final = {
    "incompatible .mpy file": "the bytecode on the board is of another version than its firmware"
    " reads: deploy the program again, which checks it, or without --mpy",
    "incompatible .mpy arch": "a .mpy file on the board has machine code of another processor:"
    " deploy the program again, which names the file",
    "no module named 'secrets'": "the board has no secrets.py: give deploy --secrets FILE",
}


class Hints:
    """Finds errors in the text of a console that need an explanation, each once."""

    def __init__(self) -> None:
        self._left = dict(_HINTS)
        self._tail = ""

    def feed(self, text: str) -> list[str]:
        """Return the explanations for errors in a piece of text, or over the end of the last."""
        text = self._tail + text
        found = [self._left.pop(error) for error in list(self._left) if error in text]
        self._tail = text[-max(map(len, _HINTS)) :]
        return found


def _frame_end(data: bytes, flag: int) -> int | None:
    """Return the end of the frame that begins at ``flag``; 0 if invalid, None if incomplete."""
    octets = bytearray()
    wanted = _HEAD
    at = flag + 1
    while len(octets) < wanted:
        if at >= len(data):
            return None
        octet = data[at]
        if octet == _FLAG:
            return 0  # a frame contains no flag
        if octet == _ESCAPE:
            if at + 1 >= len(data):
                return None
            at += 1
            octet = data[at] ^ 0x20
        octets.append(octet)
        at += 1
        if len(octets) == _HEAD:
            size = octets[2] | octets[3] << 8
            if size > _LONGEST:
                return 0
            wanted = _HEAD + size + _TAIL
    deframer = Deframer(octets[1])
    return at if deframer.feed(data[flag:at]) else 0
