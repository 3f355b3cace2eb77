"""Checks a command's output as a terminal shows it, with text that attacks a terminal."""

import unicodedata

# A hostile name: it clears the screen, sets the title, returns to the start of the line, begins new
# lines in eight ways, changes the direction, has invisible characters, and cannot be encoded.
FORGED = "FORGED"
HOSTILE = (
    f"a\x1b[2J\x1b]0;owned\x07\r{FORGED}\n{FORGED}\r\n{FORGED}\x0b{FORGED}\x0c{FORGED}\x1c{FORGED}"
    f"\x85{FORGED}\u2028{FORGED}\x9b31m\u202ee\u2066v\u2069i\u200fl\u200b\ufeff\u3164\xad\x7f\x00"
)
UNENCODABLE = "\udc80\udfff"

_HARMFUL = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
_INVISIBLE = "\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0"


def visible_lines(output: str) -> list[str]:
    """The lines of an output, after a check that no text is hidden, moved or forged.

    Raises AssertionError where a terminal would do more than show text and begin lines, and where a
    line begins with FORGED.
    """
    for char in output:
        if char not in "\n\t":
            assert unicodedata.category(char) not in _HARMFUL, ascii(output)
            assert char not in _INVISIBLE, ascii(output)
    lines = output.split("\n")
    assert not any(line.strip().startswith(FORGED) for line in lines), output
    return lines
