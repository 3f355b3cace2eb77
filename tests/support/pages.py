"""The code blocks of a page of docs/, with the markers that tell how a test runs them.

A marker is a comment of HTML, above the block that it is about; neither a code host nor the site
shows it:

``<!-- not run: REASON -->``       nothing runs the block, and this is why
``<!-- shell -->``                 the block is commands, though its language says otherwise
``<!-- file: PATH -->``            the reader saves the block under this name
``<!-- board: NAME SPEC... -->``   the block runs on this virtual board, with these plugs
``<!-- host -->``                  the block runs on the host, though it looks like a board's
``<!-- given: PYTHON -->``         this stands before the program in a test
``<!-- setup: COMMAND -->``        a test runs this before the block, for what the page assumes
``<!-- beside: COMMAND -->``       the same, and it goes on until the section ends
``<!-- prints: LINE -->``          the block prints this line, though the page does not show it
``<!-- after: N -->``              the block goes on from the N-th block above it in the section
``<!-- replace: OLD -> NEW -->``   a test runs NEW in place of OLD, which names hardware
``<!-- device: PATH = NAME -->``   PATH is the line of the virtual board NAME, on the whole page
``<!-- type: TEXT -->``            the reader types TEXT where the board runs

A block is shell commands (``sh``, or without a language if its first word is a command), Python,
or output; Python with its file name as a comment in the first line is saved under that name. Output
with the language ``text`` is what the commands or the program above it print,
with other numbers; output without a language is an example.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

from support.paths import ROOT

DOCS = ROOT / "docs"
COMMANDS = frozenset(
    "uros ros2 pip python python3 make ls podman docker esptool.py openssl echo cd mkdir nc"
    " mpremote git sudo apt source systemctl journalctl curl cat".split()
)
_PIECE = re.compile(
    r"^(?P<heading>#{1,3} [^\n]+)$"
    r"|^[ ]*<!-- (?P<marker>[^\n]*?) -->$"
    r"|^(?P<indent>[ ]*)```(?P<language>[\w-]*)[^\n]*\n(?P<text>.*?)^[ ]*```$",
    re.M | re.S,
)
_KINDS = (
    "not run", "shell", "file", "board", "host", "given", "setup", "beside", "prints", "after",
    "replace", "device", "type",
)  # fmt: skip


@dataclass
class Block:
    """A code block, or what the reader types.

    ``kind`` is "shell", "python", "output" (to be printed), "example" (not compared) or "type".
    """

    kind: str
    text: str
    line: int
    section: str = ""
    markers: list[tuple[str, str]] = field(default_factory=list)

    def marker(self, name: str) -> str | None:
        """Return the value of the only marker of this name, or None."""
        values = [value for kind, value in self.markers if kind == name]
        assert len(values) <= 1, f"line {self.line}: {name} twice"
        return values[0] if values else None


def blocks_of(text: str) -> list[Block]:
    """Return the blocks of a page in order. Raises ValueError for a marker that does not exist."""
    found, markers, section = [], [], ""
    for piece in _PIECE.finditer(text):
        line = text.count("\n", 0, piece.start()) + 1
        if piece["heading"]:
            section = piece["heading"]
        elif piece["marker"] is not None:
            name, _, value = piece["marker"].partition(":")
            if name not in _KINDS:
                raise ValueError(f"line {line}: no marker {name!r}; there are {', '.join(_KINDS)}")
            if name == "type":
                found.append(Block("type", value.strip(), line, section))
            else:
                markers.append((name, value.strip()))
        else:
            indent = len(piece["indent"])
            lines = [row[indent:] for row in piece["text"].splitlines()]
            body = "\n".join(lines) + "\n"
            if named := re.match(r"# ([\w/]+\.py)\n", body):
                markers.append(("file", named[1]))
            language = "sh" if ("shell", "") in markers else piece["language"]
            found.append(Block(_kind(language, body), body, line, section, markers))
            markers = []
    if markers:
        raise ValueError(f"a marker without a block below it: {markers}")
    return found


def _kind(language: str, text: str) -> str:
    if language in ("python", "text"):
        return {"python": "python", "text": "output"}[language]
    words = text.split()
    is_shell = language == "sh" or (not language and bool(words) and words[0] in COMMANDS)
    return "shell" if is_shell else "example"


def pages_of_nav(*groups: str) -> list[Path]:
    """Return the pages in these groups of the site's navigation."""
    text = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:\n")[2]
    pages = []
    for title, entries in re.findall(r"^  - ([\w-]+):\n((?:      .*\n)+)", text, re.M):
        if title in groups:
            pages += [DOCS / name for name in re.findall(r"([\w/-]+\.md)$", entries, re.M)]
    return pages
