"""The passes of a build, as they are declared, and as their page and the tool's help have them."""

from pathlib import Path

from uros.boards.builder.pipeline import PASSES
from uros.tools.cli import main

PAGE = Path(__file__).resolve().parents[4] / "docs" / "design" / "board_builder.md"


def test_the_page_has_the_declared_passes_in_their_order() -> None:
    rows = [line.split(" | ") for line in PAGE.read_text("utf-8").splitlines() if "| `" in line]
    assert [(row[0].strip("|` "), row[1], row[2]) for row in rows] == [
        (step.name, step.purpose, step.condition) for step in PASSES
    ]


def test_the_help_has_the_declared_passes(capsys) -> None:
    try:
        main(["board", "build", "--help"])
    except SystemExit:
        pass
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for step in PASSES:
        assert any(line.startswith(f"{step.name} {step.purpose}") for line in lines), step.name
