"""--diagnostics: when which statuses are published, and that faults there do not harm boards."""

import pytest
from support.agent import RunningAgent, serving
from support.client import XrceClient
from unit.agent.helpers import (
    KEY,
    WRITER,
    Board,
    Desk,
    get_info,
    of,
    participant,
    publisher_entities,
    write_data,
)

from uros.agent.clock import Clock
from uros.agent.log import WARNING
from uros.agent.observability import diagnostics as module
from uros.agent.observability.diagnostic_array import ERROR, OK, STALE, TYPE, WARN
from uros.agent.observability.diagnostics import GROUP, MAX_LEFT, TOPIC, Diagnostics
from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.middleware.base import MiddlewareError
from uros.middleware.memory import MemoryMiddleware
from uros.qos import QoSProfile
from uros.wire import ids

MESSAGE = load("diagnostic_msgs/msg/DiagnosticArray")
SECOND = 1000
WALL = 1_800_000_000
AGENT = "uros_agent: agent"
BOARD = f"uros_agent: board 0x{KEY:08X} ns/board"


class Hall:
    """A desk with the interface of a server, all on the desk's clock, and a tool that listens."""

    def __init__(self, period=1.0, node="uros_agent", **more):
        self._desk = None
        self.clock = Clock(self._monotonic, lambda: WALL * 10**9 + self._milliseconds() * 10**6)
        self.desk = self._desk = Desk(clock=self.clock, **more)
        self.agent = self.desk.agent
        self.transports = [self.desk.place]
        self.started = self._monotonic()
        self.wake_at = self.desk.wake_at
        self.desk.start()
        tool = self.desk.middleware.create_node(0, "/", "tool")
        self.reader = tool.create_reader(TOPIC, TYPE, QoSProfile(depth=1000), lambda: None)
        self.diagnostics = Diagnostics(0, period, node)
        self.diagnostics.open(self)

    def _milliseconds(self):
        return self._desk.clock if self._desk else 1000

    def _monotonic(self):
        return self._milliseconds() / 1000

    def note(self, level, part, function, event, about):
        self.agent.log(level, part, function, event, about)

    def messages(self):
        return [from_cdr(MESSAGE, sample) for sample in self.reader.take(1000)]

    def hear(self, milliseconds=SECOND):
        """Return the statuses of some time by name, each list oldest first."""
        self.messages()
        self.desk.wait(milliseconds)
        statuses = {}
        for message in self.messages():
            for status in message.status:
                statuses.setdefault(status.name, []).append(status)
        return statuses

    def last(self, milliseconds=SECOND):
        """Return (level, message) of each name's last status in some time."""
        return {
            name: (statuses[-1].level, statuses[-1].message)
            for name, statuses in self.hear(milliseconds).items()
        }

    def close(self):
        self.diagnostics.close()
        self.desk.close()


@pytest.fixture
def hall():
    new_hall = Hall()
    yield new_hall
    new_hall.close()


def boards(hall, count, first=1):
    made = [Board(hall.desk, number, KEY + number) for number in range(first, first + count)]
    for board in made:
        board.ask(*publisher_entities())
    return made


# --- boards that come and go --------------------------------------------------------------


def test_a_board_from_its_connection_until_it_is_left_out(hall):
    assert hall.last() == {AGENT: (OK, "0 boards")}
    board = Board(hall.desk)
    board.ask(*publisher_entities())
    assert hall.last() == {AGENT: (OK, "1 board"), BOARD: (OK, "connected")}
    hall.agent.delete_client(KEY)
    statuses = hall.last()
    assert statuses[BOARD][0] == STALE
    assert statuses[BOARD][1].startswith("disconnected ")
    assert statuses[BOARD][1].endswith(" s ago, before: connected")
    assert hall.last(58 * SECOND)[BOARD][0] == STALE
    hall.desk.wait(2 * SECOND)
    assert list(hall.last()) == [AGENT]


def test_a_board_that_comes_back_is_told_as_connected(hall):
    Board(hall.desk).ask(*publisher_entities())
    hall.desk.wait(SECOND)
    hall.agent.delete_client(KEY)
    assert hall.last()[BOARD][0] == STALE
    Board(hall.desk).ask(*publisher_entities())
    assert [status.message for status in hall.hear()[BOARD]] == ["connected"]
    assert [status.level for status in hall.hear(3 * SECOND)[BOARD]] == [OK, OK, OK]


def test_a_board_with_other_firmware_has_another_name(hall):
    Board(hall.desk).ask(*publisher_entities())
    assert BOARD in hall.last()
    hall.agent.delete_client(KEY)
    Board(hall.desk).ask(participant(name="arm"))
    assert list(hall.last()) == [AGENT, f"uros_agent: board 0x{KEY:08X} arm"]


def test_the_name_waits_for_the_node_and_does_not_change(hall):
    board = Board(hall.desk)
    assert list(hall.last()) == [AGENT]  # it may still create its node
    board.ask(*publisher_entities())
    assert list(hall.last()) == [AGENT, BOARD]
    without = Board(hall.desk, 2, 7)
    statuses = hall.last(3 * SECOND)
    assert statuses["uros_agent: board 0x00000007"] == (OK, "connected")
    without.ask(*publisher_entities())
    assert "uros_agent: board 0x00000007" in hall.last()


def test_a_talking_board_that_falls_silent_is_asked_before_the_dead_time_would():
    hall = Hall()
    board = Board(hall.desk)
    board.ask(*publisher_entities())
    for _ in range(100):
        board.send(write_data(WRITER, b"\0\0\0\0"))
        hall.desk.wait(100)
    assert hall.last()[BOARD] == (OK, "connected")
    board.polite = False
    levels = [status.level for status in hall.hear(20 * SECOND)[BOARD]]
    assert levels == sorted(levels) and set(levels) == {OK, WARN, ERROR}
    assert levels.index(WARN) <= 6 and levels.index(ERROR) <= 11
    assert hall.last()[BOARD] == (ERROR, "silent for 22 s, no answer to a ping")
    board.send(get_info())
    assert hall.last()[BOARD] == (OK, "connected")
    hall.close()


def test_a_board_is_asked_once_in_a_silence(hall):
    board = Board(hall.desk)
    board.ask(*publisher_entities())
    for _ in range(100):
        board.send(write_data(WRITER, b"\0\0\0\0"))
        hall.desk.wait(100)
    sent = [datagram for _, datagram in hall.desk.wait(20 * SECOND)]
    assert len([datagram for datagram in sent if datagram[4] == ids.GET_INFO]) == 1


def test_a_board_that_does_not_talk_waits_for_the_probe_of_the_dead_time(hall):
    board = Board(hall.desk)
    board.ask(*publisher_entities())
    hall.desk.wait(4 * SECOND)
    board.send(get_info())  # as the answer to what its creations have caused
    levels = [status.level for status in hall.hear(29 * SECOND)[BOARD]]
    assert levels == [OK] * 29
    assert hall.last(5 * SECOND)[BOARD] == (ERROR, "silent for 34 s, no answer to a ping")


def test_boards_that_left_are_limited_the_oldest_first(hall, monkeypatch):
    monkeypatch.setattr(module, "MAX_LEFT", 3)
    made = boards(hall, 5)
    hall.desk.wait(SECOND)
    for board in made:
        hall.agent.delete_client(board.key)
        hall.desk.wait(SECOND)
    stale = [name for name, (level, _) in hall.last().items() if level == STALE]
    assert stale == [f"uros_agent: board 0x{board.key:08X} ns/board" for board in made[2:]]
    assert MAX_LEFT == 200


# --- messages -------------------------------------------------------------------------------


def test_header_period_and_names():
    hall = Hall(period=2.0, node="arm_agent")
    hall.desk.wait(10 * SECOND)
    first, *others = hall.messages()
    stamps = [first.header.stamp] + [message.header.stamp for message in others]
    # When the agent's clock has 1 s, its wall clock has WALL and 1 s.
    assert [(stamp.sec, stamp.nanosec) for stamp in stamps] == [
        (WALL + 1 + 2 * count, 0) for count in range(6)
    ]
    assert first.header.frame_id == ""
    assert [status.name for status in first.status] == ["arm_agent: agent"]
    nodes = [node.full_name for node in hall.desk.middleware.bus.nodes]
    assert nodes == ["/tool", "/arm_agent"]
    hall.close()


def test_many_boards_are_split_and_spread_over_the_period(hall):
    boards(hall, 3 * GROUP)
    hall.desk.wait(1900)
    hall.messages()
    hall.desk.wait(SECOND)
    messages = hall.messages()
    assert [len(message.status) for message in messages] == [GROUP, GROUP, GROUP, 1]
    times = [message.header.stamp.nanosec // 10**6 for message in messages]
    assert times == [0, 200, 400, 600]
    assert len({status.name for message in messages for status in message.status}) == 61


def test_above_the_highest_rate_the_period_is_longer(hall, monkeypatch):
    monkeypatch.setattr(module, "MAX_RATE", 10)
    boards(hall, 49)
    hall.desk.wait(5 * SECOND)
    statuses = hall.hear(50 * SECOND)
    assert 9 <= min(map(len, statuses.values())) <= max(map(len, statuses.values())) <= 11


def test_a_message_fits_a_datagram(hall):
    """Long names of boards included, as far as the snapshot shows them."""
    for board in [Board(hall.desk, number, number) for number in range(1, GROUP + 1)]:
        board.ask(*publisher_entities(name="rt/x"))
        client = of(board)
        client.refused = dict.fromkeys(range(16), "x" * 5000)
    hall.desk.wait(2 * SECOND)
    assert max(map(len, hall.reader.take(1000))) < 60_000


def test_totals_of_the_agent_are_those_of_the_boards(hall):
    made = boards(hall, 2)
    of(made[0]).refused = {1: "no"}
    hall.desk.wait(2 * SECOND)
    values = {pair.key: pair.value for pair in hall.hear()[AGENT][0].values}
    assert (values["boards"], values["boards with errors"]) == ("2", "1")
    held = sum(of(board).held() for board in made)
    assert values["memory held for boards (bytes)"] == str(held)


# --- faults ---------------------------------------------------------------------------------


class Faulty(MemoryMiddleware):
    """Fails where ``where`` says, with ``error``."""

    where = ""
    error = MiddlewareError("no network")

    def create_node(self, domain, namespace, name, localhost_only=False):
        if self.where == "node" and name == "uros_agent":
            raise self.error
        node = super().create_node(domain, namespace, name, localhost_only)
        create_writer = node.create_writer

        def create(topic, type_name, qos):
            if self.where == "writer" and topic == TOPIC:
                raise self.error
            writer = create_writer(topic, type_name, qos)
            if self.where == "write" and topic == TOPIC:
                monkey = Failing(writer, self.error)
                return monkey
            return writer

        node.create_writer = create
        return node


class Failing:
    def __init__(self, writer, error):
        self._error = error
        self.close = writer.close

    def write(self, cdr):
        raise self._error


@pytest.mark.parametrize("where", ["node", "writer", "write"])
@pytest.mark.parametrize("error", [MiddlewareError("no network"), OSError("odd")])
def test_a_failing_middleware_is_tried_again_and_boards_are_served(where, error):
    middleware = Faulty()
    middleware.where, middleware.error = where, error
    hall = Hall(middleware=middleware)
    board = Board(hall.desk)
    assert board.ask(*publisher_entities()) == [ids.STATUS_OK] * 4
    for _ in range(50):
        board.send(write_data(WRITER, b"\0\0\0\0"))
        assert hall.last(100) == {}
    assert str(error) in hall.desk.log()
    if isinstance(error, MiddlewareError):  # all others are logged as faults of uros
        assert hall.desk.log().count(str(error)) == 1
    assert [node.full_name for node in middleware.bus.nodes] == ["/tool", "/ns/board"] or (
        where == "write"
    )
    middleware.where = ""
    hall.desk.wait(SECOND)
    assert hall.last()[BOARD] == (OK, "connected")
    hall.close()


def test_a_writer_without_room_loses_a_message_and_no_more(hall, monkeypatch):
    hall.desk.wait(SECOND)
    monkeypatch.setattr(type(hall.diagnostics._writer), "write", lambda self, cdr: False)
    assert hall.hear(3 * SECOND) == {}
    monkeypatch.undo()
    assert AGENT in hall.hear()


def test_a_status_that_cannot_be_made_does_not_end_diagnostics(hall, monkeypatch):
    """As a fault of uros would: the server logs it."""
    monkeypatch.setattr(module, "agent_status", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        hall.desk.wait(SECOND)
    monkeypatch.undo()
    hall.desk.wait(2 * SECOND)
    assert hall.last()[AGENT] == (OK, "0 boards")


def test_close_ends_the_node_and_the_timers_between_two_messages_too(hall):
    boards(hall, 3 * GROUP)
    hall.desk.wait(SECOND)
    assert len(hall.messages()[-1].status) == GROUP  # the first of four
    hall.diagnostics.close()
    hall.diagnostics.close()
    assert hall.hear(3 * SECOND) == {}
    assert "/uros_agent" not in [node.full_name for node in hall.desk.middleware.bus.nodes]


# --- in a running agent -----------------------------------------------------------------------


def test_a_running_agent_publishes_and_serves():
    running = RunningAgent("udp", "memory", 0, WARNING)
    running.server.attachments.append(Diagnostics(0, 0.1))
    with serving(running):
        client = XrceClient(running.line(), 0x77)
        assert client.open() == ids.STATUS_OK
        reader = client.reader("tool", "rt/diagnostics", TYPE)
        client.read(reader)
        names = set()
        while "uros_agent: board 0x00000077 tool" not in names:
            message = from_cdr(MESSAGE, b"\0\1\0\0" + client.sample(reader))
            names |= {status.name for status in message.status}
        assert AGENT in names
