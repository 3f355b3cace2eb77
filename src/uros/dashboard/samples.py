"""Parses the samples that a rover sends while its wheels are tuned: lines of whole numbers."""

from __future__ import annotations

import re
from typing import Final

MAX_FIELDS: Final = 8
MAX_VALUE: Final = 1_000_000
# The longest line, because a malicious one may never end.
MAX_LINE: Final = 256
# Pieces after which a rover without line ends is recognised.
_UNDECIDED: Final = 8

_END: Final = re.compile(rb"[\r\n;\0]")
_WHOLE: Final = re.compile(r"[+-]?\d{1,8}")
_JOINED: Final = re.compile(r"([+-]?\d{1,8})([+-]\d{1,8})")

Sample = tuple[int, ...]


class Samples:
    """Finds samples in the bytes of one connection, however TCP has split or joined them.

    Line ends (LF, CR, a semicolon) separate messages if the rover sends any. A pause (`flush`) or
    eight pieces without a line end show that it sends none; then each piece from TCP is a message,
    as for the document's program, unless the piece clearly continues the one before. A sign
    separates two messages that arrive in one piece; without a sign they cannot be separated, and
    are dropped: ``-3`` and ``15`` are ``-315``.

    A line that begins with ``#`` is a remark of the rover for the user.

    ``faults`` counts dropped messages. ``notes`` has the last remarks and faults as text, eight at
    most; the caller removes them.
    """

    def __init__(self) -> None:
        self.faults = 0
        self.notes: list[str] = []
        self._pieces: list[bytes] = []  # of the incomplete line, as received
        self._has_line_ends: bool | None = None  # None: unknown
        self._skip_line = False
        self._fields = 0  # number of fields of the last valid sample; 0 without one
        self._other_fields = 0  # number of fields of the last sample with a different one

    def feed(self, octets: bytes) -> list[Sample]:
        """Return the complete samples in a piece of the stream."""
        samples: list[Sample] = []
        *lines, rest = _END.split(octets)
        if lines:
            self._has_line_ends = True
        for line in lines:
            self._add(line, samples)
            self._end(samples)
        if self._has_line_ends is False and self._pieces and self._goes_on(rest) is False:
            self._end(samples)
        self._add(rest, samples)
        if self._has_line_ends is None and len(self._pieces) >= _UNDECIDED:
            self._has_line_ends = False
            self._settle(samples)
        return samples

    def flush(self) -> list[Sample]:
        """Handle a pause, which ends a message if the rover sends no line ends."""
        samples: list[Sample] = []
        if self._has_line_ends is None and self._pieces:
            self._has_line_ends = False
            self._settle(samples)
        if self._has_line_ends is False:
            self._end(samples)
        return samples

    def _settle(self, samples: list[Sample]) -> None:
        """Treat the stored pieces as messages, as there are no line ends."""
        pieces, self._pieces = self._pieces, []
        for piece in pieces:
            if self._pieces and not self._goes_on(piece):
                self._end(samples)
            self._pieces.append(piece)

    def _goes_on(self, piece: bytes) -> bool:
        """Return whether a piece continues the message before it."""
        before = b"".join(self._pieces).rstrip()
        return (
            not before[-1:].isdigit()
            or piece.lstrip()[:1] in (b",", b"")
            or (self._fields > 0 and before.count(b",") + 1 < self._fields)
        )

    def _add(self, piece: bytes, samples: list[Sample]) -> None:
        if self._skip_line or not piece:
            return
        if sum(map(len, self._pieces)) + len(piece) <= MAX_LINE:
            self._pieces.append(piece)
            return
        if self._has_line_ends is None:  # each piece may be a message
            self._has_line_ends = False
            self._settle(samples)
            if self._pieces and not self._goes_on(piece):
                self._end(samples)
                return self._add(piece, samples)
        self._pieces.clear()
        self._fault(f"more than {MAX_LINE} characters without a line end")
        self._skip_line = True

    def _end(self, samples: list[Sample]) -> None:
        text = b"".join(self._pieces).decode("ascii", "replace").strip()
        self._pieces.clear()
        if self._skip_line:
            self._skip_line = False
        elif text.startswith("#"):
            self._note(f"the rover says: {_shown(text[1:].strip(), 120)}")
        elif text:
            self._read(text, samples)

    def _read(self, text: str, samples: list[Sample]) -> None:
        sample: list[int] = []
        whole: list[list[int]] = [sample]
        for field in text.split(","):
            field = field.strip()
            joined = None if self._has_line_ends else _JOINED.fullmatch(field)
            if joined:
                sample.append(int(joined[1]))
                sample = [int(joined[2])]
                whole.append(sample)
            elif _WHOLE.fullmatch(field):
                sample.append(int(field))
            else:
                return self._fault(f"{_shown(field) or 'nothing'} is no whole number")
        for sample in whole:
            if max(map(abs, sample)) > MAX_VALUE:
                return self._fault(f"a value is beyond {MAX_VALUE}")
            if len(sample) > MAX_FIELDS:
                return self._fault(f"{len(sample)} values in a line: {MAX_FIELDS} at most")
        counts = {len(sample) for sample in whole}
        if not self._has_line_ends and self._fields and counts != {self._fields}:
            (count,) = counts if len(counts) == 1 else (0,)
            if not count or count != self._other_fields:
                self._other_fields = count
                return self._fault(
                    f"{_shown(text)} is perhaps two messages in one:"
                    " let the rover end each with a line end"
                )
        self._fields, self._other_fields = len(whole[-1]), 0
        samples.extend(map(tuple, whole))

    def _fault(self, about: str) -> None:
        self.faults += 1
        self._note(f"left out what the rover sent: {about}")

    def _note(self, text: str) -> None:
        if len(self.notes) < 8:
            self.notes.append(text)


def _shown(text: str, most: int = 24) -> str:
    """Escape text from outside."""
    clean = "".join(c if c.isascii() and c.isprintable() else "?" for c in text)
    return clean if len(clean) <= most else clean[: most - 1] + "…"
