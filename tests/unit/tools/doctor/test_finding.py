"""Findings of ``uros doctor``: many that are alike are printed as one."""

from uros.tools.doctor.agents import check_clocks, check_refused
from uros.tools.doctor.command import lines
from uros.tools.doctor.finding import OK, Finding, merge_alike, note, ok, problem
from uros.tools.doctor.graph import check_names


class Names:
    """A picture of a graph with two nodes of each name."""

    nodes = [f"/b{number}" for number in range(1, 6)] * 2


def boards(count, offset=-0.3):
    """The snapshot of an agent with boards whose clocks are off."""
    clients = [
        {"key": f"0x{number:08X}", "nodes": [{"name": f"/b{number}"}], "clock_offset": offset}
        for number in range(1, count + 1)
    ]
    return {"pid": 7, "clients": clients}


def test_many_boards_with_the_same_fault_are_one_note_which_names_some():
    (one,) = merge_alike(check_clocks([boards(24)]))
    assert one.what == (
        "24 alike: the clock of /b1 was 0.3 s behind the agent's at its last time synchronization;"
        " also /b2, /b3, /b4 and 20 more (--json has each)"
    )
    assert one.fix.startswith("synchronize more often: ") and len(lines(one).splitlines()) == 3
    (one,) = merge_alike(check_clocks([boards(4)]))
    assert one.what.endswith("; also /b2, /b3, /b4 (--json has each)")
    assert (one.check, one.state) == ("board clock", "note")


def test_a_few_are_printed_each():
    found = check_clocks([boards(3)])
    assert merge_alike(found) == found and len(found) == 3


def test_what_is_not_alike_stays_apart():
    found = [*check_clocks([boards(3, -0.3)]), *check_clocks([boards(3, 0.3)])]
    assert merge_alike(found) == found
    found = [ok("device", "a"), note("device", "b"), ok("device", "c"), ok("device", "d"),
             ok("device", "e")]  # fmt: skip
    assert merge_alike(found) == found


def test_the_order_is_that_of_the_first_of_each_kind():
    many = [Finding("device", OK, f"{name} is free", about=name) for name in "abcdef"]
    other = problem("device", "x cannot be opened", "use another device", "x")
    merged = merge_alike([many[0], other, *many[1:]])
    assert [finding.what for finding in merged] == [
        "6 alike: a is free; also b, c, d and 2 more (--json has each)",
        "x cannot be opened",
    ]


def test_a_fix_that_differs_says_that_the_others_have_theirs():
    found = [problem("qos", f"/{name} fails", f"--qos /{name}:depth=1", name) for name in "abcd"]
    (one,) = merge_alike(found)
    assert one.what == "4 alike: /a fails; also b, c, d (--json has each)"
    assert one.fix == "--qos /a:depth=1, and the others likewise"


def test_refused_boards_are_alike_by_their_reason():
    refused = [
        {"key": f"0x{number:08X}", "address": f"10.0.0.{number}:1", "times": number, "why": why}
        for why in ("over 4096 clients", "memory")
        for number in range(1, 6)
    ]
    one, other = merge_alike(check_refused([{"pid": 7, "refused": refused}]))
    assert one.what.startswith(
        "5 alike: the agent 7 refuses the board 0x00000001 at 10.0.0.1:1: over"
    )
    assert "; also 0x00000002, 0x00000003, 0x00000004 and 1 more" in other.what


def test_names_of_two_nodes_are_alike():
    (one,) = merge_alike(check_names(Names, 3))
    assert one.what.startswith("5 alike: 2 nodes in domain 3 have the name /b1: ")


def test_json_has_the_four_fields_of_each():
    found = check_clocks([boards(24)])
    assert [list(finding.plain()) for finding in found] == [["check", "state", "what", "fix"]] * 24
