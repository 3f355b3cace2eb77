"""The middleware ced: any text is the name of a participant or topic, as in the C++ agent.

CED of the C++ agent (``-m ced``) parses no XML. It ignores a participant's text, takes a topic's
text as its name, and finds the topic of a datawriter or datareader by the same text, as XML or as
a reference.
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
    desk = Desk(middleware=open_middleware("ced"))
    yield desk
    desk.close()


def entities(name, form=xml, participant="participant", flags=0):
    """Create all entities as eProsima's clients of CED do."""
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
def test_any_text_is_a_topic_name_and_samples_reach_its_readers(desk, name, form):
    publisher, subscriber = Board(desk, 1, key=1), Board(desk, 2, key=2)
    assert publisher.ask(*entities(name, form)) == [OK] * 6
    assert subscriber.ask(*entities(name, form, participant=name)) == [OK] * 6
    subscriber.send(read_data(READER))
    for number in range(3):
        publisher.send(write_data(WRITER, bytes([number])))
    subscriber.settle()
    assert subscriber.samples() == [b"\0", b"\1", b"\2"]
    assert "refused" not in desk.log()


@given(st.text(st.characters(exclude_characters="\0<", codec="utf-8"), max_size=80))
def test_no_text_raises_an_error(name):
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
    # The text of a participant is ignored.
    assert board.ask(form(PARTICIPANT, "other", flags=REUSE)) == [MATCHED]
    assert board.ask(form(TOPIC, "c", PARTICIPANT, flags=REUSE)) == [MISMATCH]


def test_an_endpoint_needs_its_topic(desk):
    board = Board(desk)
    assert board.ask(*entities("a b")[:3]) == [OK] * 3
    assert board.ask(xml(WRITER, "another", PUBLISHER)) == [UNKNOWN]


def test_ros_names_and_binary_representations_work_as_with_memory(desk):
    board, second_board = Board(desk, 1, key=1), Board(desk, 2, key=2)
    assert board.ask(*publisher_entities()) == [OK] * 4
    assert second_board.ask(*subscriber_entities()) == [OK] * 4
    second_board.send(read_data(READER))
    board.send(write_data(WRITER, b"abcd"))
    second_board.settle()
    assert second_board.samples() == [b"abcd"]


def test_a_namespace_rule_applies_with_ced():
    rules = Rules()
    rules.add({"namespace": "/jail"})
    desk = Desk(middleware=open_middleware("ced"), rules=rules)
    board = Board(desk)
    statuses = board.ask(*entities("plain text")[:2], xml(TOPIC, "rt/../x", PARTICIPANT))
    assert statuses[0] == OK and OK not in statuses[1:]
    assert "namespace /jail" in desk.log()
    desk.close()


def test_other_middlewares_refuse_text_that_is_no_xml():
    desk = Desk(middleware=open_middleware("memory"))
    board = Board(desk)
    assert OK not in board.ask(*entities("bighelloworld_topic"))
    desk.close()
