"""Reports source files of more than 600 lines: ``make lint``.

A report, not a failure: a file is split by subject, never by length.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINES = 600


def main() -> None:
    """Print a line for each long file, the longest first."""
    lengths = {
        path: len(path.read_text("utf-8").splitlines()) for path in (ROOT / "src").rglob("*.py")
    }
    for path, length in sorted(lengths.items(), key=lambda item: -item[1]):
        if length > LINES:
            print(f"long: {path.relative_to(ROOT)} has {length} lines; has it two subjects?")


if __name__ == "__main__":
    main()
