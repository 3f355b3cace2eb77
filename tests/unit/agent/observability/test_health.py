"""What the status of a board, and of the agent, says of an entry of the snapshot."""

import pytest
from unit.agent.helpers import KEY, Board, Desk, oid, publisher_entities, topic

from uros.agent.observability import snapshot
from uros.agent.observability.diagnostic_array import ERROR, OK, STALE, WARN
from uros.agent.observability.health import agent_status, board_status, left_status
from uros.wire import ids

NOW = 1_800_000_000.0
HEAD = {
    "memory_full": False, "max_clients": 4, "limits": {"memory": 1000}, "middleware": "rtps",
    "pid": 1, "uptime": 61.2, "cpu": 0.25, "rss": None, "fds": 9,
    "transports": [
        {"name": "SerialAgent", "kind": "SERIAL", "label": "/dev/tty\x1b", "messages": 0,
         "bytes": 80, "crc_errors": 2, "skipped": 0},
    ],
}  # fmt: skip


class Owner:
    def __init__(self, desk):
        self.agent = desk.agent


@pytest.fixture
def board_entry():
    """The entry of a board that is well, as the snapshot has it."""
    desk = Desk()
    board = Board(desk)
    board.ask(*publisher_entities())
    client = desk.agent.clients[KEY]
    yield snapshot.board(Owner(desk), client, snapshot.Rates(desk.agent.clients))
    desk.close()


def judged(entry, **changes):
    status = board_status("uros_agent: board x", {**entry, **changes}, NOW)
    return status.level, status.message


def recent(entry, **counts):
    return {"recent": {**entry["recent"], **counts}, "rate_over": 10.0}


def test_a_board_that_is_well(board_entry):
    status = board_status("uros_agent: board x", board_entry, NOW)
    assert status[:4] == (OK, "uros_agent: board x", "connected", f"0x{KEY:08X}")
    values = dict(status.values)
    assert len(values) == len(status.values), "each key once"
    assert (values["nodes"], values["transport"]) == ("/ns/board", "TestAgent")
    assert (values["address"], values["round trip (ms)"]) == ("peer 1", "0.0")
    assert (values["messages from the board"], values["clock offset (s)"]) == ("5", "unknown")


@pytest.mark.parametrize(
    ("changes", "level", "message"),
    [
        ({"line_lost": True, "heard_ago": 2.0}, ERROR, "the line is lost, last message 2 s ago"),
        ({"unanswered": True, "heard_ago": 9.9}, WARN, "silent for 10 s, no answer to a ping"),
        ({"unanswered": True, "heard_ago": 42.0}, ERROR, "silent for 42 s, no answer to a ping"),
        ({"unanswered": False, "heard_ago": 42.0}, OK, "connected"),
        ({"refused_objects": {"0x003(5)": "no type\x1b[0m"}}, ERROR,
         "object 0x003(5) refused: no type\\x1b[0m"),
        ({"refused_objects": {"0x001(5)": "a", "0x002(5)": "b"}}, ERROR,
         "object 0x001(5) and 1 more refused: a"),
        ({"round_trip": 1.5}, WARN, "slow acknowledgements: after 1.5 s"),
        ({"round_trip": 0.5, "unacknowledged_for": 3.0}, WARN,
         "slow acknowledgements: after 3.0 s"),
        ({"unacknowledged_for": 40.0, "unanswered": True, "heard_ago": 41.0}, ERROR,
         "silent for 41 s, no answer to a ping"),
        ({"clock_offset": 0.4}, OK, "connected"),
        ({"clock_offset": -2.5}, WARN, "clock 2.5 s behind the agent's"),
        ({"clock_offset": 3600.0}, WARN, "clock 3600.0 s ahead of the agent's"),
        ({"clock_offset": 100 - NOW}, OK, "connected"),
    ],
)  # fmt: skip
def test_faults_of_a_board(board_entry, changes, level, message):
    assert judged(board_entry, **changes) == (level, message)


@pytest.mark.parametrize(
    ("counts", "level", "message"),
    [
        ({"dropped": 1}, WARN, "1 message dropped in the last 10 s"),
        ({"dropped": 1, "given_up": 2}, WARN, "3 messages dropped in the last 10 s"),
        ({"lost": 4, "received": 0}, OK, "connected"),
        ({"lost": 5, "received": 95}, OK, "connected"),
        ({"lost": 6, "received": 94}, WARN, "6 of 100 messages lost on the way in the last 10 s"),
        ({"resent": 4, "sent": 4}, OK, "connected"),
        ({"resent": 10, "sent": 100}, OK, "connected"),
        ({"resent": 11, "sent": 100}, WARN, "11 of 100 messages sent again in the last 10 s"),
    ],
)
def test_losses_of_a_board(board_entry, counts, level, message):
    assert judged(board_entry, **recent(board_entry, **counts)) == (level, message)


def test_the_worst_fault_is_first_and_gives_the_level(board_entry):
    level, message = judged(
        board_entry,
        round_trip=1.5,
        refused_objects={"0x001(5)": "a"},
        **recent(board_entry, dropped=1),
    )
    assert level == ERROR
    assert message == (
        "object 0x001(5) refused: a; slow acknowledgements: after 1.5 s;"
        " 1 message dropped in the last 10 s"
    )


def test_a_refused_object_of_a_board_is_told_until_the_board_creates_it():
    desk = Desk()
    board = Board(desk)
    client = desk.agent.clients[KEY]
    owner, rates = Owner(desk), snapshot.Rates(desk.agent.clients)
    number = oid(3, ids.KIND_TOPIC)
    board.ask(*publisher_entities())
    board.ask(topic(number, "rt/bad name"))
    entry = snapshot.board(owner, client, rates)
    assert list(entry["refused_objects"]) == ["0x003(2)"]
    assert judged(entry)[0] == ERROR and "bad name" in judged(entry)[1]
    board.ask(topic(number, "rt/good_name"))
    assert judged(snapshot.board(owner, client, rates)) == (OK, "connected")
    desk.close()


def test_a_board_that_has_left():
    status = left_status("uros_agent: board x", "0x01", 12.4, "connected")
    assert status == (
        STALE, "uros_agent: board x", "disconnected 12 s ago, before: connected", "0x01", [],
    )  # fmt: skip


def test_the_agent():
    status = agent_status("uros_agent: agent", "hall", HEAD, [], 3, {OK: 2, WARN: 1}, 700)
    assert status[:4] == (OK, "uros_agent: agent", "3 boards", "hall")
    values = dict(status.values)
    assert (values["boards"], values["boards with warnings"]) == ("3", "1")
    assert (values["boards with errors"], values["middleware"]) == ("0", "rtps")
    assert (values["memory held for boards (bytes)"], values["open descriptors"]) == ("700", "9")
    assert values["resident memory (bytes)"] == "unknown"
    assert values["SerialAgent /dev/tty\\x1b"] == "0 messages, 80 bytes, 2 crc errors"


@pytest.mark.parametrize(
    ("head", "refused", "boards", "level", "message"),
    [
        ({}, [], 1, OK, "1 board"),
        ({"memory_full": True}, [], 1, ERROR,
         "the memory for boards is used up (see --max-memory)"),
        ({}, [], 4, WARN, "no places left for boards (see --max-clients)"),
        ({}, [("0x01", 61.0)], 1, OK, "1 board"),
        ({}, [("0x01", 70.0), ("0x02", 5.0), ("0x03", 1.0)], 1, WARN,
         "refused 0x03 and 1 more: over 4 clients, there"),
    ],
)  # fmt: skip
def test_faults_of_the_agent(head, refused, boards, level, message):
    refusals = [
        {"key": key, "ago": ago, "why": "over 4 clients", "address": "there", "times": 1}
        for key, ago in refused
    ]
    status = agent_status("uros_agent: agent", "hall", {**HEAD, **head}, refusals, boards, {}, 0)
    assert (status.level, status.message) == (level, message)
