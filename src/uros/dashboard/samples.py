"""Parses the samples that a rover sends while its wheels are tuned: lines of whole numbers."""

from __future__ import annotations

import re
from typing import Final

MAX_FIELDS: Final = 8
MAX_VALUE: Final = 1_000_000
# Attack: a line that never ends.
MAX_LINE: Final = 256
# Bytes after which a rover without line ends is recognised.
_UNDECIDED: Final = 8

_END: Final = re.compile(rb"[\r\n;\0]")
_WHOLE: Final = re.compile(r"[+-]?\d{1,8}")
_JOINED: Final = re.compile(r"([+-]?\d{1,8})([+-]\d{1,8})")

Sample = tuple[int, ...]


class Samples:
    """Finds samples in the bytes of one connection, however TCP has split or joined them.

    With line ends (LF, CR, a semicolon) only these count. A rover that sends none is known by a
    pause, `flush`, or by eight pieces without any; then each piece that TCP brings is a message, as
    for the document's program, unless it clearly goes on. Two that came in one piece are told apart
    by a sign; where there is none they cannot be, and are left out: ``-3`` and ``15`` are ``-315``.

    A line that begins with ``#`` is a remark of the rover's for the person.

    ``faults`` counts what was left out. ``said`` has remarks and faults in words, for who asks;
    take them out, no more than eight are kept.
    """

    def __init__(self) -> None:
        self.faults = 0
        self.said: list[str] = []
        self._pieces: list[bytes] = []  # of the incomplete line, as received
        self._by_lines: bool | None = None  # None: not known yet
        self._skips = False
        self._fields = 0  # number of fields of the last valid sample; 0 without one
        self._other = 0  # of the last sample with another number of fields

    def feed(self, octets: bytes) -> list[Sample]:
        """Return the complete samples in a piece of the stream."""
        found: list[Sample] = []
        *lines, rest = _END.split(octets)
        if lines:
            self._by_lines = True
        for line in lines:
            self._add(line, found)
            self._end(found)
        if self._by_lines is False and self._pieces and self._goes_on(rest) is False:
            self._end(found)
        self._add(rest, found)
        if self._by_lines is None and len(self._pieces) >= _UNDECIDED:
            self._by_lines = False
            self._settle(found)
        return found

    def flush(self) -> list[Sample]:
        """Handle a pause, which ends a message where there are no line ends."""
        found: list[Sample] = []
        if self._by_lines is None and self._pieces:
            self._by_lines = False
            self._settle(found)
        if self._by_lines is False:
            self._end(found)
        return found

    def _settle(self, found: list[Sample]) -> None:
        """Treat the stored pieces as messages, as there are no line ends."""
        pieces, self._pieces = self._pieces, []
        for piece in pieces:
            if self._pieces and not self._goes_on(piece):
                self._end(found)
            self._pieces.append(piece)

    def _goes_on(self, piece: bytes) -> bool:
        """Return whether a piece continues the message before it."""
        before = b"".join(self._pieces).rstrip()
        return (
            not before[-1:].isdigit()
            or piece.lstrip()[:1] in (b",", b"")
            or (self._fields > 0 and before.count(b",") + 1 < self._fields)
        )

    def _add(self, piece: bytes, found: list[Sample]) -> None:
        if self._skips or not piece:
            return
        if sum(map(len, self._pieces)) + len(piece) <= MAX_LINE:
            self._pieces.append(piece)
            return
        if self._by_lines is None:  # each piece may be a message
            self._by_lines = False
            self._settle(found)
            if self._pieces and not self._goes_on(piece):
                self._end(found)
                return self._add(piece, found)
        self._pieces.clear()
        self._wrong(f"more than {MAX_LINE} characters without a line end")
        self._skips = True

    def _end(self, found: list[Sample]) -> None:
        text = b"".join(self._pieces).decode("ascii", "replace").strip()
        self._pieces.clear()
        if self._skips:
            self._skips = False
        elif text.startswith("#"):
            self._say(f"the rover says: {_shown(text[1:].strip(), 120)}")
        elif text:
            self._read(text, found)

    def _read(self, text: str, found: list[Sample]) -> None:
        sample: list[int] = []
        whole: list[list[int]] = [sample]
        for field in text.split(","):
            field = field.strip()
            joined = None if self._by_lines else _JOINED.fullmatch(field)
            if joined:
                sample.append(int(joined[1]))
                sample = [int(joined[2])]
                whole.append(sample)
            elif _WHOLE.fullmatch(field):
                sample.append(int(field))
            else:
                return self._wrong(f"{_shown(field) or 'nothing'} is no whole number")
        for sample in whole:
            if max(map(abs, sample)) > MAX_VALUE:
                return self._wrong(f"a value is beyond {MAX_VALUE}")
            if len(sample) > MAX_FIELDS:
                return self._wrong(f"{len(sample)} values in a line: {MAX_FIELDS} at most")
        counts = {len(sample) for sample in whole}
        if not self._by_lines and self._fields and counts != {self._fields}:
            (count,) = counts if len(counts) == 1 else (0,)
            if not count or count != self._other:
                self._other = count
                return self._wrong(
                    f"{_shown(text)} is perhaps two messages in one:"
                    " let the rover end each with a line end"
                )
        self._fields, self._other = len(whole[-1]), 0
        found.extend(map(tuple, whole))

    def _wrong(self, about: str) -> None:
        self.faults += 1
        self._say(f"left out what the rover sent: {about}")

    def _say(self, text: str) -> None:
        if len(self.said) < 8:
            self.said.append(text)


def _shown(text: str, most: int = 24) -> str:
    """Escape text from outside."""
    clean = "".join(c if c.isascii() and c.isprintable() else "?" for c in text)
    return clean if len(clean) <= most else clean[: most - 1] + "…"
