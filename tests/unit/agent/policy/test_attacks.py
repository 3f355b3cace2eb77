"""Attacks by one client on shared resources; another client is served afterwards."""

import gc
import time
import weakref

import pytest
from unit.agent.helpers import (
    APPLICATION,
    RESOURCES,
    TOPIC,
    WRITER,
    Board,
    create_client,
    delete,
    endpoint,
    fragment,
    group,
    oid,
    parse,
    participant,
    publisher_entities,
    topic,
    whole,
    xml,
)
from unit.agent.objects.test_xml_profiles import LAUGHS
from unit.agent.test_agent import still_works

from uros.agent.objects.xml_profiles import MAX_XML
from uros.agent.policy.limits import Limits
from uros.middleware.base import MiddlewareError
from uros.wire import ids

OK, INVALID = ids.STATUS_OK, ids.STATUS_ERR_INVALID_DATA
NAME = "<dds><topic><name>{}</name><dataType>t::T</dataType></topic></dds>"

QUADRATIC = '<!DOCTYPE a [<!ENTITY x "' + "x" * 20_000 + '">]>' + NAME.format("&x;" * 10_000)
BOMBS = {
    "billion laughs": LAUGHS,
    "quadratic": QUADRATIC[:MAX_XML - 100],
    "quadratic and whole": '<!DOCTYPE a [<!ENTITY x "' + "x" * 9000 + '">]>'
    + NAME.format("&x;" * 9000),
    "external": '<!DOCTYPE d [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + NAME.format("&x;"),
    "external parameters": '<!DOCTYPE d [<!ENTITY % x SYSTEM "http://192.0.2.1/x"> %x;]>'
    + NAME.format("a"),
    "external dtd": '<!DOCTYPE d SYSTEM "http://192.0.2.1/x.dtd">' + NAME.format("a"),
    "deep": "<dds>" + "<a>" * 9000 + "</a>" * 7000,
    "deep and closed": "<dds>" + "<a>" * 9000 + "</a>" * 9000 + "</dds>",
    "wide": "<dds>" + "<a/>" * 16_000 + "</dds>",
    "one attribute": f"<dds a='{'x' * 60_000}'/>",
    "attributes": "<dds " + " ".join(f"a{i}='1'" for i in range(6000)) + "/>",
    "attributes alike": "<dds " + "a='1' " * 9000 + "/>",
    "namespaces": "<dds " + " ".join(f"xmlns:a{i}='u'" for i in range(3000)) + "/>",
    "glued": "<dds " + 'a="x"' * 12_000 + "/>",
    "quotes": "<dds a=" + '"' * 60_000 + "/>",
    "comment": "<dds><!--" + "-" * 60_000,
    "text": NAME.format(" " * 60_000),
    "cdata": "<dds>" + "<![CDATA[]]>" * 5000 + "</dds>",
    "instructions": "<dds>" + "<?a?>" * 12_000 + "</dds>",
    "too long": NAME.format("x" * 2 * MAX_XML),
    "control": NAME.format("\x02"),
}  # fmt: skip


def send_long(board, submessage):
    """Send in fragments, as a client does."""
    raw = whole(submessage)
    for start in range(0, len(raw), 400):
        board.send(fragment(raw[start : start + 400], start + 400 >= len(raw)))


@pytest.mark.parametrize("kind", [ids.KIND_TOPIC, ids.KIND_PARTICIPANT, ids.KIND_DATAWRITER])
@pytest.mark.parametrize("bomb", BOMBS)
def test_xml_bombs(desk, bomb, kind):
    board = Board(desk)
    board.ask(participant(oid(9, 1)))
    start = time.process_time()
    text = BOMBS[bomb]
    if len(text) < 65_000:
        send_long(board, xml(oid(1, kind), text, oid(9, 1)))
    else:
        raw = whole(xml(oid(1, kind), text[:65_000], oid(9, 1)))
        for at in range(0, len(raw), 400):
            board.send(fragment(raw[at : at + 400], at + 400 >= len(raw)))
    assert time.process_time() - start < 1.0
    assert oid(1, kind) not in desk.agent.clients[board.key].objects or bomb == "text"
    still_works(desk)


@pytest.mark.parametrize("bomb", ["deep and closed", "wide", "attributes", "cdata"])
def test_xml_bombs_as_an_application(desk, bomb):
    board = Board(desk)
    start = time.process_time()
    send_long(board, xml(APPLICATION, BOMBS[bomb].replace("dds", "application", 1)))
    assert time.process_time() - start < 1.0
    still_works(desk)


def test_key_0_and_every_other_session_id(desk):
    for session_id in range(256):
        desk.hear(create_client(0, session_id), peer=3)
        desk.hear(create_client(5, session_id), peer=3)
    assert 0 not in desk.agent.clients and len(desk.agent.clients) <= 1
    still_works(desk)


def test_one_client_cannot_join_all_domains(desk):
    board = Board(desk)
    most = desk.agent.limits.domains
    answers = []
    for domain in range(20):
        answers += board.ask(participant(oid(domain, 1), domain=domain))
    assert answers == [OK] * most + [RESOURCES] * (20 - most)
    assert f"over {most} domains of one client" in desk.log()
    # It may use its domains again, also after it has deleted its nodes in them.
    assert board.ask(participant(oid(30, 1), domain=1)) == [OK]
    still_works(desk)


def test_one_client_cannot_exhaust_the_types(desk):
    """Nor can it one after the other: the middleware keeps the names of types."""
    desk.agent.limits = Limits(types=20)
    board = Board(desk)
    board.ask(participant(), group())
    answers = []
    for number in range(40):
        type_name = f"a::msg::dds_::T{number}_"
        board.ask(topic(TOPIC, f"rt/t{number}", type_name, flags=ids.FLAG_REPLACE))
        answers += board.ask(endpoint(flags=ids.FLAG_REPLACE))
    assert answers == [OK] * 20 + [RESOURCES] * 20
    assert "over 20 types of one client" in desk.log()
    still_works(desk)


def test_a_middleware_without_a_domain_left_refuses_and_serves_the_rest(desk, monkeypatch):
    def full(domain, *_):
        raise MiddlewareError(f"domain {domain} would be one more than the 32")

    board = Board(desk)
    monkeypatch.setattr(desk.middleware, "create_node", full)
    assert board.ask(participant()) == [ids.STATUS_ERR_DDS_ERROR]
    monkeypatch.undo()
    still_works(desk)


def test_a_window_of_short_write_data_and_of_nothing(desk):
    board = Board(desk)
    board.ask(*publisher_entities())
    for size in range(6):
        board.send((ids.WRITE_DATA, 1, WRITER.to_bytes(2, "big")[:size] + bytes(max(0, size - 2))))
    board.send((0x55, 0xFF, b""), (0, 0, b""))
    still_works(desk)


def test_creating_and_deleting_objects_leaks_no_memory(desk):
    board = Board(desk)
    desk.agent.log.level = 3
    board.ask(participant(), topic(), group())
    held_bytes = desk.agent.clients[board.key].held()
    for _ in range(300):
        assert board.ask(endpoint()) == [OK]
        assert board.ask(delete(WRITER)) == [OK]
    assert desk.agent.clients[board.key].held() <= held_bytes + 200
    still_works(desk)


def test_creating_and_deleting_sessions_leaks_no_memory(desk):
    desk.agent.log.level = 3
    for number in range(500):
        board = Board(desk, peer=7, key=0x100 + number)
        board.ask(*publisher_entities())
    assert len(desk.agent.clients) == 1  # each replaced the session before it
    assert len(desk.middleware.bus.nodes) == 1
    ((_, sent),) = desk.hear(create_client(0x9999), peer=8)
    assert parse(sent)[1][0][2][0] == OK
    still_works(desk)


def test_a_deleted_client_is_freed_without_the_cyclic_garbage_collector(desk):
    """A thousand reference cycles of the size of a board's objects would be megabytes."""
    desk.agent.log.level = 3
    board = Board(desk)
    board.ask(*publisher_entities())
    client = weakref.ref(desk.agent.clients[board.key])
    gc.collect()
    gc.disable()
    try:
        desk.agent.delete_client(board.key)
        desk.agent.attended.clear()
        assert client() is None
    finally:
        gc.enable()
