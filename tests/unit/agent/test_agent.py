"""Clients of an agent: admission, to which client a datagram belongs, deletion."""

import pytest
from unit.agent import helpers
from unit.agent.helpers import (
    KEY,
    PARTICIPANT,
    READER,
    Board,
    create_client,
    delete,
    get_info,
    message,
    oid,
    parse,
    participant,
    publisher_entities,
    read_data,
    sub,
    subscriber_entities,
    topic,
    write_data,
)

from uros.agent import agent as module
from uros.agent.objects.client import HOLD_MS
from uros.wire import ids, session
from uros.wire.cdr import Reader

OK, INVALID = ids.STATUS_OK, ids.STATUS_ERR_INVALID_DATA


def answer(desk, datagram, peer=1):
    """Return (head, kind, payload) of the single answer."""
    ((to, sent),) = desk.hear(datagram, peer)
    assert to == peer
    head, ((kind, _, payload),) = parse(sent)
    return head, kind, payload


def admitted(desk, *args, peer=1, **more):
    """Return the status of CREATE_CLIENT."""
    head, kind, payload = answer(desk, create_client(*args, **more), peer)
    assert kind == ids.STATUS_AGENT
    return payload[0]


def still_works(desk):
    """Test that another client connects, publishes, subscribes and gets all its answers."""
    board = Board(desk, peer=99, key=0x99)
    entities = publisher_entities("rt/other")
    assert board.ask(*entities, *subscriber_entities("rt/other")[2:]) == [OK] * 6
    board.send(read_data(READER))
    board.send(write_data(helpers.WRITER, b"works"))
    board.settle()
    assert board.samples() == [b"works"]
    assert "internal error" not in desk.log()


# --- admission ---------------------------------------------------------------------------


def test_a_client_connects_and_closes_its_session(desk):
    assert admitted(desk) == OK
    assert list(desk.agent.clients) == [helpers.KEY]
    head, kind, payload = answer(desk, message([delete(ids.OBJECT_CLIENT, 0x0506)], 0))
    assert (kind, payload) == (ids.STATUS, bytes.fromhex("0506fffe0000"))
    assert not desk.agent.clients and not desk.place.sessions and not desk.agent._places
    for line in (
        "create_client            | create                         | client_key: 0xAABBCCDD,"
        " session_id: 0x81",
        "establish_session        | session established            | client_key: 0xAABBCCDD,"
        " address: peer 1",
        "delete_client            | delete                         | client_key: 0xAABBCCDD",
        "destroy_session          | session closed                 | client_key: 0xAABBCCDD,"
        " address: peer 1",
    ):
        assert line in desk.log()


@pytest.mark.parametrize(
    ("more", "status", "message_text"),
    [
        ({"key": 0}, INVALID, "invalid client key"),
        ({"cookie": b"XRCF"}, INVALID, "invalid cookie"),
        ({"version": (2, 0)}, ids.STATUS_ERR_INCOMPATIBLE, "incompatible version"),
        ({"version": (1, 9)}, OK, None),
        ({"vendor": b"\0\0"}, OK, None),
        ({"session_id": 0x00}, INVALID, "invalid session id"),
        ({"session_id": 0x80}, INVALID, "invalid session id"),
        ({"session_id": 0xFF}, OK, None),
        ({"session_id": 0x01}, OK, None),
        ({"mtu": 0}, INVALID, "MTU of 0 is under 32"),
        ({"mtu": 4}, INVALID, "MTU of 4"),
        ({"mtu": 31}, INVALID, "MTU of 31"),
        ({"mtu": 32}, OK, None),
        ({"mtu": 65535}, OK, None),
        ({"properties": [("uxr_hl", "no number")]}, OK, None),
        ({"properties": [("uxr_hl", ""), ("uxr_sm", "1"), ("", "")]}, OK, None),
        ({"properties": []}, OK, None),
    ],
)
def test_admission_of_a_create_client(desk, more, status, message_text):
    assert admitted(desk, **more) == status
    assert bool(desk.agent.clients) == (status == OK)
    if message_text:
        assert message_text in desk.log()
    still_works(desk)


def test_an_optional_flag_that_is_no_boolean(desk):
    datagram = bytearray(create_client())
    at = datagram.index(b"\x81\0\0\x02", 8) + 1
    for value in (2, 0x7F, 0xFF):
        datagram[at] = value
        assert desk.hear(datagram) == []
    assert not desk.agent.clients
    assert "a boolean is 0 or 1" in desk.log()
    still_works(desk)


@pytest.mark.parametrize("cut", range(1, 24))
def test_a_truncated_create_client(desk, cut):
    assert desk.hear(create_client()[:-cut]) == []
    assert not desk.agent.clients
    still_works(desk)


def test_more_properties_than_the_limit(desk):
    datagram = create_client(properties=[("a", "b")] * 33)
    assert desk.hear(datagram) == []
    assert "over the limit" in desk.log()
    huge = bytearray(create_client(properties=[]))
    at = huge.index(b"\0\0\0\0", 20)
    huge[at : at + 4] = b"\xff" * 4
    assert desk.hear(huge) == []
    still_works(desk)


def test_no_message_is_longer_than_a_datagram_can_be(desk):
    admitted(desk, mtu=65535)
    assert desk.agent.clients[helpers.KEY].session.mtu == module.MAX_MTU == 65507


# --- coming again ------------------------------------------------------------------------------


def test_the_same_client_again_keeps_its_objects_and_starts_new_streams(desk):
    board = Board(desk)
    board.ask(*publisher_entities())
    board = Board(desk, mtu=1000)
    assert board.ask(participant()) == [ids.STATUS_ERR_ALREADY_EXISTS]
    assert desk.agent.clients[board.key].session.mtu == 1000
    assert "session re-established" in desk.log()


def test_a_delivery_goes_on_when_its_client_comes_again(desk):
    first, second = Board(desk, 1, 0x11), Board(desk, 2, 0x22)
    first.ask(*publisher_entities())
    second.ask(*subscriber_entities(depth=100))
    second.send(read_data(READER))
    second.polite = False
    for i in range(30):
        first.send(write_data(helpers.WRITER, bytes([i])))
        first.settle()
    assert len(second.samples()) == 16
    second.sequence.clear()
    second.expected.clear()
    second.polite = True
    second.take(desk.hear(create_client(0x22), 2))
    second.wait(HOLD_MS - 1)
    assert second.samples() == []
    second.wait(1)
    assert second.samples() == [bytes([i]) for i in range(16, 30)]


def test_a_board_that_was_reset_gets_samples_once_it_asks_for_them(desk):
    """They would be lost: it has no subscription yet."""
    first, second = Board(desk, 1, 0x11), Board(desk, 2, 0x22)
    first.ask(*publisher_entities())
    second.ask(*subscriber_entities())
    second.send(read_data(READER))
    second = Board(desk, 2, 0x22)
    first.send(write_data(helpers.WRITER, b"x"))
    first.settle()
    assert second.samples() == []
    second.send(read_data(READER, request=77))
    assert second.payloads(ids.DATA) == [bytes((0, 77)) + READER.to_bytes(2, "big") + b"x"]
    second.wait(HOLD_MS)
    first.send(write_data(helpers.WRITER, b"y"))
    first.settle()
    assert second.samples() == [b"y"]


def test_another_session_id_is_another_client(desk):
    Board(desk).ask(*publisher_entities())
    board = Board(desk, session_id=0x82)
    assert board.ask(participant()) == [OK]
    assert len(desk.agent.clients) == 1


def test_another_key_from_the_same_address_takes_its_place(desk):
    Board(desk, key=0x11).ask(*publisher_entities())
    Board(desk, key=0x22)
    assert list(desk.agent.clients) == [0x22]
    assert not desk.middleware.bus.nodes


def test_the_same_key_from_another_address_moves(desk):
    Board(desk, 1).ask(*publisher_entities())
    desk.hear(create_client(), 2)
    desk.wait(510)
    assert list(desk.place.sessions) == [2]
    board = Board(desk, 2)
    assert board.ask(participant(oid(2, 1))) == [OK]
    assert desk.hear(message([get_info()], 0), 1) == []


def test_without_a_key_in_the_header_the_address_decides(desk):
    board = Board(desk, 1)
    assert desk.hear(message([topic()], 0x80, 0), 2) == []
    assert not desk.agent.clients[board.key].objects


def test_with_a_key_in_the_header_the_key_decides_wherever_it_comes_from(desk):
    board = Board(desk, 1, session_id=0x05)
    assert board.ask(participant()) == [OK]
    desk.boards.clear()
    board.peer = 7
    desk.boards[7] = board
    assert board.ask(topic()) == []
    desk.wait(510)
    board.sequence[ids.STREAM_RELIABLE] = 1  # as heartbeats would advance it
    assert board.ask(topic()) == [OK]
    assert "address: peer 7" in desk.log()
    assert desk.place.sessions == {}
    board.send(delete(ids.OBJECT_CLIENT), stream=0)
    assert board.statuses() == [OK]
    assert not desk.agent.clients


def test_a_wrong_key_or_session_id_changes_nothing(desk):
    Board(desk, 1, session_id=0x05).ask(participant())
    for session_id, key in ((0x05, 0x1234), (0x06, helpers.KEY), (0x85, helpers.KEY)):
        assert desk.hear(message([delete(PARTICIPANT)], 0x80, 1, session_id, key), 1) == []
    assert len(desk.middleware.bus.nodes) == 1


def test_many_clients_of_both_kinds(desk):
    boards = [Board(desk, i, 1000 + i, 0x81 + i % 64 if i % 2 else 1 + i % 64) for i in range(200)]
    for board in boards:
        assert board.ask(participant()) == [OK]
    for board in boards[::2]:
        board.send(delete(ids.OBJECT_CLIENT))
    for board in boards[1::2]:
        assert board.ask(topic()) == [OK]
    assert len(desk.agent.clients) == len(desk.middleware.bus.nodes) == 100


# --- messages without a session ------------------------------------------------------------------


@pytest.mark.parametrize(
    "submessage",
    [get_info(), participant(), write_data(helpers.WRITER, b"x"), read_data(READER),
     helpers.heartbeat(0, 3), helpers.acknack(0), sub(ids.RESET), sub(ids.TIMESTAMP, bytes(8)),
     sub(99)],
)  # fmt: skip
@pytest.mark.parametrize("session_id", [0x05, 0x81])
def test_messages_of_unknown_sessions_get_no_answer(desk, submessage, session_id):
    for stream in (0, 1, 0x80):
        assert desk.hear(message([submessage], stream, 0, session_id)) == []
    still_works(desk)


def test_unknown_sessions_are_logged_at_a_limited_rate(desk):
    for number in range(5):
        desk.hear(message([write_data(helpers.WRITER, b"x")], 1, number))
    assert desk.said.getvalue().count("unknown session") == 1
    assert "session_id: 0x81 (a board that pings will start anew" in desk.said.getvalue()


@pytest.mark.parametrize("session_id", [0x05, 0x81])
def test_delete_of_an_unknown_client_is_confirmed(desk, session_id):
    datagram = message([delete(ids.OBJECT_CLIENT, 0x0708)], 0, 0, session_id)
    head, kind, payload = answer(desk, datagram)
    assert head == (session_id, 0, 0)
    assert (kind, payload) == (ids.STATUS, bytes.fromhex("0708fffe0000"))
    assert desk.hear(message([delete(PARTICIPANT)], 0, 0, session_id)) == []


@pytest.mark.parametrize(
    ("head", "key", "info_mask"),
    [(0x80, 0, 1), (0x00, helpers.KEY, 1), (0x00, 0x1234, 0)],
)
def test_ping_answers_depend_on_whether_the_client_is_known(desk, head, key, info_mask):
    _, kind, payload = answer(desk, message([get_info()], 0, 0, 0x80, 0))
    assert kind == ids.INFO and payload[5] == 0
    Board(desk)
    _, kind, payload = answer(desk, message([get_info(request=0x1122)], 0, 0, head, key))
    request, object_id, status, implementation, _ = session.pull_info(
        Reader(payload, 0, len(payload))
    )
    assert (request, object_id, status) == (0x1122, ids.OBJECT_AGENT, OK)
    assert implementation == info_mask


@pytest.mark.parametrize("size", range(13))
@pytest.mark.parametrize("first", [0x00, 0x05, 0x80, 0x81, 0xFF])
def test_too_short_for_a_message(desk, first, size):
    desk.hear(bytes([first] * size))
    board = Board(desk)
    desk.hear(bytes([first] * size))
    assert board.ask(participant()) == [OK]


def test_a_flood_of_invalid_datagrams_writes_few_log_lines(desk):
    for i in range(5000):
        desk.hear(bytes([0x81, 0, 0, 0, i & 0xFF]), peer=i)
    assert desk.log().count("not an XRCE message") <= 2 * 50


def test_a_closed_connection_deletes_its_clients(desk):
    Board(desk, 1, 0x11).ask(participant())
    Board(desk, 2, 0x22).ask(participant())
    desk.agent.gone(desk.place, 1)
    assert list(desk.agent.clients) == [0x22]
    desk.agent.gone(desk.place, 1)
    assert len(desk.middleware.bus.nodes) == 1


# --- more than there may be ---------------------------------------------------------------------


def test_clients_without_objects_are_evicted_for_new_ones(desk):
    desk.agent.admission.max_clients = 32
    assert Board(desk, 100, key=100).ask(participant()) == [OK]
    for key in range(1, 32):
        desk.clock += 10
        assert (
            admitted(desk, key, 1, peer=1) == OK
        )  # the key is in the header, so one address serves for all
    desk.clock += 10
    assert admitted(desk, 32, 1, peer=1) == OK
    assert set(desk.agent.clients) == {100, *range(3, 33)}
    for key in range(1000, 1100):
        assert admitted(desk, key, 1, peer=1) == OK
        assert len(desk.agent.clients) <= 32 and 100 in desk.agent.clients


def test_clients_with_objects_stay_and_new_ones_are_refused(desk):
    desk.agent.admission.max_clients = 2
    for key in (1, 2):
        assert Board(desk, key, key=key).ask(participant()) == [OK]
    assert admitted(desk, 3, peer=3) == ids.STATUS_ERR_RESOURCES
    assert "over 2 clients" in desk.log() and "see --max-clients" in desk.log()
    assert admitted(desk, 2, peer=2) == OK  # the key is in use already
    for key in range(3, 103):
        admitted(desk, key, peer=3)
    assert desk.log().count("over 2 clients") == 1


def test_clients_that_close_their_sessions_in_one_turn_all_get_an_answer(desk):
    boards = [Board(desk, 1 + item, KEY + item) for item in range(5)]
    for number, board in enumerate(boards):
        stream = ids.STREAM_RELIABLE if number & 1 else ids.STREAM_NONE
        request = message([delete(ids.OBJECT_CLIENT)], stream, 0, board.session_id, board.key)
        buf = bytearray(request)
        desk.place.deliver(desk, board.peer, buf, memoryview(buf), len(buf), desk.clock)
    for peer, datagram in desk.settle():
        boards[peer - 1].look(datagram)
    assert [board.statuses() for board in boards] == [[OK]] * 5
    assert not desk.agent.clients and not desk.agent._left
    assert "unknown session" not in desk.log()


def test_last_messages_of_a_session_go_to_its_own_address(desk):
    first = Board(desk, 1)
    buf = bytearray(message([delete(ids.OBJECT_CLIENT)], 0))
    desk.place.deliver(desk, 1, buf, memoryview(buf), len(buf), desk.clock)
    buf = bytearray(create_client())  # another board with the same key, in the same turn
    desk.place.deliver(desk, 2, buf, memoryview(buf), len(buf), desk.clock)
    sent = desk.settle()
    assert sorted((peer, kind) for peer, datagram in sent for kind, _, _ in parse(datagram)[1]) == [
        (1, ids.STATUS),
        (2, ids.STATUS_AGENT),
    ]
    assert desk.agent.place(first.key) == (desk.place, 2)


def test_deleted_clients_leave_nothing_in_the_agent(desk):
    for number in range(3):
        Board(desk, 1 + number, KEY + number)
        desk.agent.delete_client(KEY + number)
    desk.settle()
    assert not desk.agent._left
