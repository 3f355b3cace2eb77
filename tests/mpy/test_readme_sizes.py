"""The sizes in the READMEs of ``firmware/``: of the files on a board, and of the heap in use."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from uros.boards.builder.file_system import build
from uros.boards.virtual.engine.runner import RunningBoard

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
# The most that a size may differ from the stated one, in kB: READMEs have whole ones.
TOLERANCE = 1.0
STATED = re.compile(
    r"`uros board deploy (?P<name>\w+) [^`]*--mpy`: (?P<files>\d+) kB"
    r"(?:\.\s(?:On\sMicroPython\sit|It)\stakes\s(?P<heap>\d+)\skB\sof\sthe\sheap)?"
)


def stated() -> dict[str, tuple[float, float | None]]:
    """Return the sizes of files and heap by program."""
    sizes = {}
    for page in sorted(FIRMWARE.glob("*/README.md")):
        text = re.sub(r"\s+", " ", page.read_text("utf-8"))
        for found in STATED.finditer(text):
            heap = found["heap"]
            sizes[found["name"]] = float(found["files"]), float(heap) if heap else None
    return sizes


SIZES = stated()
QUICK = "spresense_publisher"
PROGRAMS = [
    pytest.param(name, marks=[] if name == QUICK else pytest.mark.slow) for name in sorted(SIZES)
]


def test_every_size_in_a_readme_is_checked() -> None:
    pages = {page.parent.name: page.read_text("utf-8") for page in FIRMWARE.glob("*/README.md")}
    deployed = {name for name, text in pages.items() if re.search(r"--mpy`: \d+ kB", text)}
    heaps = {name for name, text in pages.items() if re.search(r"\d+ kB\s+of\s+the\s+heap", text)}
    assert deployed == {*SIZES} and QUICK in SIZES
    assert heaps == {name for name, (_, heap) in SIZES.items() if heap}


@pytest.mark.parametrize("name", PROGRAMS)
def test_size_of_the_files(name: str, tmp_path: Path) -> None:
    files = build(FIRMWARE / name, tmp_path / "out", "mpy")
    size = sum(file.stat().st_size for file in files) / 1000
    print(f"\n{name}: {size:.1f} kB")
    assert abs(size - SIZES[name][0]) < TOLERANCE


@pytest.mark.parametrize("name", [param for param in PROGRAMS if SIZES[param.values[0]][1]])
def test_size_of_the_heap(name: str) -> None:
    """Heap in use while the program looks for its agent."""
    with RunningBoard(name, engine="micropython", form="mpy") as board:
        used = board.heap().used / 1000
    print(f"\n{name}: {used:.1f} kB")
    assert abs(used - (SIZES[name][1] or 0.0)) < TOLERANCE
