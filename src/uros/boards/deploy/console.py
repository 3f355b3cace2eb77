"""What a board's console line carries, for a terminal: text, without the XRCE frames in between.

A board with one line for both prints between its frames, so the frames are taken out by their
checksum, and counted. What is left is made harmless: a terminal obeys control characters.
"""

from __future__ import annotations

import codecs
import re
from typing import Final

from ...printable import printable
from ...wire.framing import Deframer

_FLAG: Final = 0x7E
_ESCAPE: Final = 0x7D
# Flag, two addresses, two octets of length, two of checksum; each but the flag may be escaped.
_HEAD: Final = 4
_TAIL: Final = 2
# A board's message is no longer: what looks like the beginning of a longer one is text with a "~".
_LONGEST: Final = 2048
# What a terminal may get besides text: tab, new line, carriage return, backspace, bell.
_HARMLESS: Final = "\t\n\r\b\a"
# Of escape sequences the prompt's line editor needs cursor left and right and erase to the end of
# the line, and programs colours. Attack: sequences that set titles, the clipboard or keys, or that
# have the terminal answer as if somebody typed.
_SEQUENCE: Final = re.compile(r"\x1b\[(?:[0-9]{0,3}[CDK]|[0-9;]{0,16}m)")
_BEGUN: Final = re.compile(r"\x1b(?:\[[0-9;]{0,16})?\Z")


class ConsoleText:
    """Takes a line's octets in any pieces, gives the text. ``frames`` counts sound frames."""

    def __init__(self) -> None:
        self.frames = 0
        self._held = b""  # from a flag on, as long as it may become a frame
        self._begun = ""  # the beginning of an escape sequence
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    @property
    def holding(self) -> bool:
        """Whether something waits for the rest of a frame; see `flush`."""
        return bool(self._held or self._begun)

    def feed(self, data: bytes) -> str:
        """The text in ``data``, as far as it is known to be text."""
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
        """What is held, as text: nothing came for a while, so it is the beginning of no frame.

        Its first octet is text and the rest is looked at anew.
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


def _frame_end(data: bytes, flag: int) -> int | None:
    """Where the sound frame ends that begins at ``flag``; 0: it is none; None: it is not whole."""
    octets = bytearray()
    wanted = _HEAD
    at = flag + 1
    while len(octets) < wanted:
        if at >= len(data):
            return None
        octet = data[at]
        if octet == _FLAG:
            return 0  # never within a frame
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
