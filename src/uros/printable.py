"""Escaping of untrusted text for terminals and logs.

Names and types of boards and nodes, strings in messages and what a board says on its line may hold
anything: escape sequences that a terminal obeys, line ends that forge further lines, bidirectional
controls and invisible letters, with which a text looks like another one. All these are escaped.
"""

from __future__ import annotations

import re
from typing import Any, Final, TextIO, cast

# Letters and marks that show nothing, though ``str.isprintable`` lets them pass: grapheme joiner,
# Hangul fillers, Khmer and Mongolian ones, the blank of Braille.
_INVISIBLE: Final = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u2800\u3164\uffa0]")
# Spaces of other widths are text: "12 °C", and all of Japanese.
_SPACES: Final = frozenset("\xa0\u1680\u2000\u2001\u2002\u2003\u2004\u2005\u2006\u2007\u2008\u2009"
                           "\u200a\u202f\u205f\u3000")  # fmt: skip
_LINES: Final = "\n\t"


def is_printable(text: str, keep: str = "") -> bool:
    """Whether `printable` leaves the text as it is."""
    if text.isascii():
        return text.isprintable() or all(char.isprintable() or char in keep for char in text)
    return not _INVISIBLE.search(text) and all(
        char.isprintable() or char in _SPACES or char in keep for char in text
    )


def printable(text: str, keep: str = "") -> str:
    r"""Return the text as one line without effect on a terminal.

    Args:
        text: Any text, lone surrogates included.
        keep: Characters that are not escaped either, such as ``"\n"``.

    Returns:
        The text with escapes (``\x1b``, ``\n``, ``\u202e``) for control and format characters,
        surrogates, unassigned and private code points, and letters that show nothing.
    """
    if is_printable(text, keep):
        return text
    return "".join(
        char if is_printable(char, keep) else char.encode("unicode_escape").decode()
        for char in text
    )


def printable_ascii(text: str) -> str:
    """Return the text as `printable` does, with escapes for all but ASCII, for logs."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        char if char.isascii() and char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
    )


class PrintableStream:
    """A text stream that escapes control characters, except for line ends and tabs.

    What the stream's encoding lacks is escaped as well. Drawing on a terminal goes through
    `draw`.
    """

    def __init__(self, unguarded: TextIO) -> None:
        self.unguarded = unguarded

    def write(self, text: str) -> int:
        """Write the text, escaped."""
        text = printable(text, _LINES)
        try:
            self.unguarded.write(text)
        except UnicodeEncodeError as error:
            kept = text.encode(error.encoding, "backslashreplace").decode(error.encoding)
            self.unguarded.write(kept)
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each of the lines, escaped."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unguarded, name)


def guarded(stream: TextIO) -> TextIO:
    """Return the stream wrapped in a `PrintableStream`; idempotent."""
    if isinstance(stream, PrintableStream):
        return stream
    return cast(TextIO, PrintableStream(stream))


def unguarded(stream: TextIO) -> TextIO:
    """Return the unwrapped stream, for code that escapes its own output: drawing, colours, log."""
    return cast(TextIO, getattr(stream, "unguarded", stream))
