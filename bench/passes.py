"""Measures what each pass of the board builder saves; prints a table in markdown.

    .venv/bin/python bench/passes.py [PASS ...]

Two programs are built as bytecode with all passes, and again without each one:

- the firmware ``ra6m5_sensor_node``: the size of its files;
- the client, ``CORE`` of ``tests/mpy/measures.py``: the size of its files, and the heap that
  importing it takes on MicroPython 1.27 (WebAssembly: 32-bit pointers, as on boards).

A figure is what the pass saves, in bytes: the build without it, less the build with all. Passes
build on each other (without ``bundle`` those after it do nothing), so the figures do not add up.
They depend on the sources alone: one run is enough. The table is in docs/design/board_builder.md.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from mpy.harness import MicroPython, tree  # noqa: E402
from mpy.measures import CORE, heap_of  # noqa: E402

from uros.boards.builder.file_system import build  # noqa: E402
from uros.boards.builder.pipeline import PASSES  # noqa: E402

NODE = ROOT / "firmware" / "ra6m5_sensor_node"


def files_of(program: Path, without: Iterable[str]) -> dict[str, bytes]:
    """The files of a build."""
    with tempfile.TemporaryDirectory() as folder:
        build(program, Path(folder, "out"), "mpy", without=without)
        return tree(Path(folder, "out"))


def octets(files: dict[str, bytes]) -> int:
    return sum(map(len, files.values()))


def measure(without: Iterable[str]) -> tuple[int, int, int]:
    """The octets of the node's files, of the client's, and the heap of the client."""
    node = octets(files_of(NODE, without))
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "main.py").write_text(CORE, encoding="utf-8")
        files = files_of(Path(folder), without)
    module = "uros._all" if "uros/_all.mpy" in files else "uros.client"
    with MicroPython() as board:
        heap = sum(heap_of(board, files, [f"import {module}"]).values())
    return node, octets(files), heap


def row(texts: Iterable[str], figures: Iterable[int]) -> str:
    return f"| {' | '.join((*texts, *(f'{figure:,}' for figure in figures)))} |"


def main() -> int:
    print("| pass | purpose | condition | node, octets | client, octets | client, heap |")
    print("| --- | --- | --- | ---: | ---: | ---: |")
    base = measure(())
    for step in PASSES:
        if step.name in sys.argv[1:] or not sys.argv[1:]:
            pairs = zip(measure((step.name,)), base, strict=True)
            texts = (f"`{step.name}`", step.purpose, step.condition)
            print(row(texts, (without - left for without, left in pairs)), flush=True)
    pairs = zip(measure([step.name for step in PASSES]), base, strict=True)
    print(row(("all passes", "", ""), (without - left for without, left in pairs)))
    print(row(("what is left", "", ""), base))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
