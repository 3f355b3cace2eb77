"""The passes of a build, as they are declared and as their page has them."""

from pathlib import Path

from uros.boards.builder.pipeline import PASSES

PAGE = Path(__file__).resolve().parents[4] / "docs" / "design" / "board_builder.md"


def test_the_page_has_the_declared_passes_in_their_order() -> None:
    rows = [line.split(" | ") for line in PAGE.read_text("utf-8").splitlines() if "| `" in line]
    assert [(row[0].strip("|` "), row[1], row[2]) for row in rows] == [
        (step.name, step.purpose, step.condition) for step in PASSES
    ]
