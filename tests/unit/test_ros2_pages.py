"""The pages about ros2's commands and the cases of their tests agree with the parsers and tests."""

import re

import pytest
from unit.test_docs import ROOT, VERBS, options_of, tables

COMMANDS = ROOT / "docs" / "ros2_commands.md"
CASES = ROOT / "docs" / "ros2_cases.md"
GROUPS = (
    "topic", "node", "service", "action", "param", "lifecycle", "interface", "bag", "doctor",
    "multicast",
)  # fmt: skip
WORDS = [verb.removeprefix("uros ") for verb in VERBS if verb.split()[1] in GROUPS]
# How many cases the test suites of ros2's command groups have.
COUNTS = {
    "topic": 48, "node": 10, "service": 14, "action": 14, "param": 12, "lifecycle": 15,
    "interface": 25,
}  # fmt: skip


def options_in(text):
    return set(re.findall(r"`(--?[a-z1-9][\w-]*)`", text))


def sections():
    """Return the rows of the options of each verb: ``(option of ros2, of uros, tests)``."""
    return {
        section: rows
        for section, header, rows in tables(COMMANDS)
        if header[-1] == "test" and len(header) == 3
    }


COMMON = options_in("".join(cells[1] for cells in sections()["Every command"]))


def test_every_verb_has_its_section():
    assert sorted(set(sections()) - {"Every command"}) == sorted(WORDS)


@pytest.mark.parametrize("verb", WORDS)
def test_the_options_of_a_section_are_those_of_the_verb(verb):
    rows = sections().get(verb, [])
    named = set()
    for _, ours, _ in rows:
        if not re.match(r"no\b", ours) or ours == "no arguments":
            named |= options_in(ours)
    assert named - COMMON == options_of(f"uros {verb}") - COMMON


@pytest.mark.parametrize("group", COUNTS)
def test_every_case_has_its_row(group):
    count = sum(
        len(rows)
        for section, header, rows in tables(CASES)
        if section.partition(":")[0] == group and header[-1] == "test"
    )
    assert count == COUNTS[group]
