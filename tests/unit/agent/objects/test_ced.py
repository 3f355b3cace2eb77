"""What the C++ agent takes with ``-m ced``: any text as the name of a participant or topic.

Its CED parses no XML. A participant's text means nothing, a topic's text is its name, and a
datawriter or datareader calls the topic by the same text, as XML or as a reference.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.agent.helpers import (
    EXISTS,
    MATCHED,
    MISMATCH,
    OK,
    PARTICIPANT,
    PUBLISHER,
    READER,
    REPLACE,
    REUSE,
    SUBSCRIBER,
    TOPIC,
    UNKNOWN,
    WRITER,
    Board,
    Desk,
    by_reference,
    publisher_entities,
    read_data,
    subscriber_entities,
    write_data,
    xml,
)

from uros.agent.policy.rules import Rules
from uros.middleware import open_middleware

TOPIC_XML = "<dds><topic><name>rt/a</name><dataType>T</dataType></topic></dds>"
NAMES = [
    "bighelloworld_topic", "", " ", "rt/../x", "1st topic", "<dds>", "a" * 300, "rt/", "\u202e",
    "ros_discovery_info", TOPIC_XML,
]  # fmt: skip


@pytest.fixture
def desk():
    one = Desk(middleware=open_middleware("ced"))
    yield one
    one.close()


def entities(name, form=xml, participant="participant", flags=0):
    """All of them, as eProsima's clients of CED make them."""
    return [
        form(PARTICIPANT, participant, flags=flags),
        form(TOPIC, name, PARTICIPANT, flags=flags),
        xml(PUBLISHER, "", PARTICIPANT, flags=flags),
        form(WRITER, name, PUBLISHER, flags=flags),
        xml(SUBSCRIBER, "", PARTICIPANT, flags=flags),
        form(READER, name, SUBSCRIBER, flags=flags),
    ]


@pytest.mark.parametrize("form", [xml, by_reference])
@pytest.mark.parametrize("name", NAMES)
def test_any_text_is_a_name_and_samples_meet_by_it(desk, name, form):
    one, other = Board(desk, 1, key=1), Board(desk, 2, key=2)
    assert one.ask(*entities(name, form)) == [OK] * 6
    assert other.ask(*entities(name, form, participant=name)) == [OK] * 6
    other.send(read_data(READER))
    for number in range(3):
        one.send(write_data(WRITER, bytes([number])))
    other.settle()
    assert other.samples() == [b"\0", b"\1", b"\2"]
    assert "refused" not in desk.log()


@given(st.text(st.characters(exclude_characters="\0<", codec="utf-8"), max_size=80))
def test_any_text_at_all(name):
    desk = Desk(middleware=open_middleware("ced"))
    assert Board(desk).ask(*entities(name)) == [OK] * 6
    desk.close()


@pytest.mark.parametrize("form", [xml, by_reference])
def test_creating_twice_follows_the_rules(desk, form):
    board = Board(desk)
    assert board.ask(*entities("a b", form)) == [OK] * 6
    assert board.ask(*entities("a b", form)) == [EXISTS] * 6
    assert board.ask(*entities("a b", form, flags=REUSE)) == [MATCHED] * 6
    assert board.ask(*entities("a b", form, flags=REUSE | REPLACE)) == [MATCHED] * 6
    # A participant's text means nothing.
    assert board.ask(form(PARTICIPANT, "other", flags=REUSE)) == [MATCHED]
    assert board.ask(form(TOPIC, "c", PARTICIPANT, flags=REUSE)) == [MISMATCH]


def test_an_endpoint_needs_its_topic(desk):
    board = Board(desk)
    assert board.ask(*entities("a b")[:3]) == [OK] * 3
    assert board.ask(xml(WRITER, "another", PUBLISHER)) == [UNKNOWN]


def test_names_of_ros_and_binary_forms_go_on_as_with_memory(desk):
    board, other = Board(desk, 1, key=1), Board(desk, 2, key=2)
    assert board.ask(*publisher_entities()) == [OK] * 4
    assert other.ask(*subscriber_entities()) == [OK] * 4
    other.send(read_data(READER))
    board.send(write_data(WRITER, b"abcd"))
    other.settle()
    assert other.samples() == [b"abcd"]


def test_a_namespace_holds_every_board_all_the_same():
    rules = Rules()
    rules.add({"namespace": "/jail"})
    desk = Desk(middleware=open_middleware("ced"), rules=rules)
    board = Board(desk)
    statuses = board.ask(*entities("plain text")[:2], xml(TOPIC, "rt/../x", PARTICIPANT))
    assert statuses[0] == OK and OK not in statuses[1:]
    assert "namespace /jail" in desk.log()
    desk.close()


def test_the_other_middlewares_take_none_of_it():
    desk = Desk(middleware=open_middleware("memory"))
    board = Board(desk)
    assert OK not in board.ask(*entities("bighelloworld_topic"))
    desk.close()
