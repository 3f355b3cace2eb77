"""Silent clients: when they are probed, which messages count as answers, when they are deleted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, serving
from support.client import XrceClient
from unit.agent.helpers import (
    KEY,
    READER,
    WRITER,
    Board,
    Desk,
    acknack,
    create_client,
    get_info,
    message,
    of,
    parse,
    participant,
    publisher_entities,
    read_data,
    sub,
    subscriber_entities,
    write_data,
)

from uros.agent.policy import liveliness as module
from uros.wire import ids, session
from uros.wire.cdr import Reader

SECOND = 1000


@pytest.fixture
def desk():
    desk = Desk().start()
    yield desk
    desk.close()


def desk_with(**more):
    return Desk(**more).start()


def probe_count(sent, peer=None):
    """Return the number of liveliness probes; each is a GET_INFO and a HEARTBEAT."""
    kinds = [parse(datagram)[1][0][0] for to, datagram in sent if peer is None or to == peer]
    assert kinds.count(ids.GET_INFO) <= kinds.count(ids.HEARTBEAT)
    return kinds.count(ids.GET_INFO)


# --- what is asked ------------------------------------------------------------------------


def test_a_probe_byte_by_byte(desk):
    Board(desk)
    first, second = [datagram for _, datagram in desk.wait(31 * SECOND)]
    # As the probe of the C++ agent: request 0 about OBJECTID_CLIENT, no mask.
    assert first.hex(" ") == "81 00 00 00 02 01 08 00 00 00 ff fe 00 00 00 00"
    assert second.hex(" ") == "81 00 00 00 0b 01 05 00 00 00 ff ff 80"


def test_the_heartbeat_of_a_probe_has_the_range_of_the_stream(desk):
    board = Board(desk)
    board.ask(*subscriber_entities())
    board.send(read_data(READER))
    other_board = Board(desk, 2, 0x22)
    other_board.ask(*publisher_entities())
    board.polite = False
    for i in range(3):
        other_board.send(write_data(WRITER, bytes([i])))
    of(board).session.probe()
    info, beat = of(board).session.outgoing
    assert parse(info)[1][0][0] == ids.GET_INFO
    first, last, stream = session.pull_heartbeat(Reader(parse(beat)[1][0][2], 0, 5))
    out = of(board).session._out[ids.STREAM_RELIABLE]
    assert (first, last, stream) == (out.acked, (out.sent - 1) & 0xFFFF, 0x80)
    assert (last - first) & 0xFFFF == 2  # the three samples that are not acknowledged


def test_a_probe_of_a_client_with_its_key_in_the_header(desk):
    Board(desk, session_id=0x05)
    for _, datagram in desk.wait(31 * SECOND):
        assert datagram[:8] == bytes.fromhex("05000000aabbccdd")


# --- silent and there ------------------------------------------------------------------------

ANSWERS = {
    "C client": bytes.fromhex("81000000 00000000 00000000"),
    "by acknack": message([acknack(0)], 0),
    "INFO": message([sub(ids.INFO, bytes(8))], 0),
    "ping": message([get_info()], 0),
    "ping outside": message([get_info()], 0, 0, 0x80),
    "nonsense": message([sub(99)], 0),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_a_client_that_answers_probes_is_never_deleted(desk, name):
    Board(desk)
    for _ in range(20):
        sent = desk.wait(100 * SECOND)
        assert 1 <= probe_count(sent) <= 4
        desk.hear(ANSWERS[name])
    assert list(desk.agent.clients) == [KEY]
    assert "client is silent" not in desk.log()


def test_the_answer_of_a_c_client_is_no_fault(desk):
    """It leaves out the submessage header of INFO; with its key in the header it is cut, too."""
    Board(desk)
    Board(desk, 2, 0x22, 0x05)
    before = desk.log()
    desk.hear(ANSWERS["C client"])
    desk.hear(bytes.fromhex("05000000 00000022 00000000"), 2)
    assert desk.log().count("recv_message") == before.count("recv_message")
    assert "warning" not in desk.log()
    # A complete CREATE_CLIENT within a session is still handled as one.
    desk.hear(message([sub(ids.CREATE_CLIENT, bytes(16))], 0))
    assert "submessage 0 is not for an agent" in desk.log()


def test_an_active_client_is_not_probed(desk):
    board = Board(desk)
    board.ask(*publisher_entities())
    for _ in range(100):
        board.send(write_data(WRITER, b"x"))
        assert probe_count(desk.wait(20 * SECOND)) == 0


def test_a_message_after_a_long_silence_restarts_the_dead_time(desk):
    Board(desk)
    desk.wait(299 * SECOND)
    desk.hear(ANSWERS["C client"])
    desk.wait(299 * SECOND)
    assert KEY in desk.agent.clients
    desk.wait(3 * SECOND)
    assert KEY not in desk.agent.clients


# --- silent and gone ---------------------------------------------------------------------------


def test_a_client_that_does_not_answer_is_deleted_after_the_dead_time(desk):
    Board(desk).ask(*publisher_entities())
    sent = desk.wait(299 * SECOND)
    assert probe_count(sent) == 9
    assert KEY in desk.agent.clients
    desk.wait(3 * SECOND)
    assert not desk.agent.clients and not desk.place.sessions and not desk.middleware.bus.nodes
    (line,) = [log_line for log_line in desk.log().splitlines() if "client is silent" in log_line]
    assert "client_key: 0xAABBCCDD, address: peer 1, no message for 30" in line
    assert "9 probes unanswered: deleted (set by --dead-time SECONDS, 0: never)" in line
    # Its messages now belong to no session, and it can connect again.
    assert desk.hear(message([get_info()], 0)) == []
    assert Board(desk).ask(participant()) == [ids.STATUS_OK]


@pytest.mark.parametrize("dead_time, at_most", [(1, 5), (3, 5), (10, 13), (60, 63), (3600, 3603)])
def test_at_least_three_probes_precede_a_deletion_for_any_dead_time(dead_time, at_most):
    desk = desk_with(dead_time=dead_time)
    Board(desk)
    sent = desk.wait(int(dead_time * SECOND) - 1)
    assert KEY in desk.agent.clients
    sent += desk.wait(at_most * SECOND - int(dead_time * SECOND))
    assert KEY not in desk.agent.clients
    assert probe_count(sent) >= module.PROBES
    desk.close()


def test_a_dead_time_of_zero_deletes_no_client(desk):
    desk = desk_with(dead_time=0)
    Board(desk)
    assert probe_count(desk.wait(12 * 3600 * SECOND)) == 0
    assert KEY in desk.agent.clients
    desk.close()


def test_heartbeats_for_unacknowledged_messages_and_probes_are_independent(desk):
    """Heartbeats to a silent client stop after 30 s; probes go on, and an answer resumes both."""
    board, other_board = Board(desk), Board(desk, 2, 0x22)
    board.ask(*subscriber_entities())
    board.send(read_data(READER))
    board.polite = False
    other_board.ask(*publisher_entities())
    other_board.send(write_data(WRITER, b"kept"))
    desk.wait(40 * SECOND)
    beats = [datagram for to, datagram in desk.wait(10 * SECOND) if to == 1]
    assert not beats  # between two probes
    assert probe_count(desk.wait(30 * SECOND), 1) == 1
    number = board.expected[ids.STREAM_RELIABLE] - 1
    first = desk.hear(message([acknack(number, 1)], 0))
    assert any(b"kept" in datagram for to, datagram in first if to == 1)
    assert probe_count(desk.wait(300 * SECOND), 1) >= 3
    assert board.key not in desk.agent.clients


# --- the agent itself was away -----------------------------------------------------------------


def stop(desk, seconds):
    """Stop the process, or suspend the machine: no timer fires and no message arrives."""
    desk.clock += int(seconds * SECOND)


@pytest.mark.parametrize("seconds", [301, 3600, 500_000])
@pytest.mark.parametrize("before", [0, 29, 31, 100, 200])
def test_a_stopped_agent_deletes_no_client_that_answers(desk, before, seconds):
    Board(desk)
    desk.wait(before * SECOND)
    stop(desk, seconds)
    for _ in range(40):
        if probe_count(desk.wait(SECOND)):
            break
    assert KEY in desk.agent.clients
    desk.hear(ANSWERS["C client"])
    desk.wait(290 * SECOND)
    assert KEY in desk.agent.clients


def test_an_answer_right_before_the_agent_was_stopped_counts(desk):
    Board(desk)
    desk.wait(200 * SECOND)
    desk.hear(ANSWERS["C client"])
    stop(desk, 3600)
    desk.wait(250 * SECOND)
    assert KEY in desk.agent.clients


def test_a_stopped_agent_probes_three_times_before_it_deletes(desk):
    Board(desk)
    stop(desk, 10_000)
    sent = []
    while KEY in desk.agent.clients:
        sent += desk.wait(SECOND)
        assert len(sent) < 100
    assert probe_count(sent) >= module.PROBES
    assert desk.clock - 10_000 * SECOND > 200 * SECOND


@given(
    st.lists(
        st.tuples(st.sampled_from(("wait", "stop", "answer")), st.integers(1, 400)), max_size=30
    )
)
def test_no_client_is_deleted_before_three_unanswered_probes(steps):
    """Test any sequence of stops, waits and answers."""
    desk = desk_with()
    Board(desk)
    unanswered = 0
    for step, seconds in steps:
        if step == "stop":
            stop(desk, seconds)
        elif step == "answer":
            desk.hear(ANSWERS["C client"])
            unanswered = 0
        else:
            unanswered += probe_count(desk.wait(seconds * SECOND))
        if KEY not in desk.agent.clients:
            assert unanswered >= module.PROBES
            break
    desk.close()


# --- very many ---------------------------------------------------------------------------------


def test_many_clients_that_fall_silent_at_once_are_probed_in_portions(desk):
    for key in range(1, 1001):
        desk.hear(create_client(key, 1), key)
    most, total = 0, 0
    for _ in range(4000):
        sent = desk.wait(10)
        most, total = max(most, probe_count(sent)), total + probe_count(sent)
    assert most <= module.MAX_PROBED
    assert total == 1000  # each was probed once in the 40 s
    desk.wait(261 * SECOND)
    remaining = len(desk.agent.clients)
    desk.wait(5 * SECOND)
    assert len(desk.agent.clients) == 0 and remaining <= 1000
    assert not desk.agent.liveliness._silent


def test_liveliness_state_is_freed_with_its_client(desk):
    for key in range(1, 101):
        desk.hear(create_client(key, 1, properties=[("uxr_hl", "5000")] * (key % 2)), key)
    desk.wait(40 * SECOND)
    for key in list(desk.agent.clients):
        desk.agent.delete_client(key)
    desk.wait(2 * SECOND)
    assert not desk.agent.liveliness._silent and not desk.agent.liveliness._hard


# --- hard liveliness ---------------------------------------------------------------------------


def hard(desk, text, peer=1, key=KEY):
    ((_, sent),) = desk.hear(create_client(key, properties=[("uxr_hl", text)]), peer)
    assert parse(sent)[1][0][2][0] == ids.STATUS_OK


# Of the C client 3.0 built with UCLIENT_HARD_LIVELINESS_CHECK and a timeout of 1000: its length
# (10 00, the 16 of one without properties) leaves them out.
OF_A_C_CLIENT = bytes.fromhex(
    "80000000 00011000 58524345 0100010f 000000a1 81010000 01000000"
    "07000000 7578725f686c0000 07000000 3030313030300000 fc01"
)


def test_the_properties_of_a_c_client_are_behind_the_announced_length(desk):
    ((_, sent),) = desk.hear(OF_A_C_CLIENT)
    assert parse(sent)[1][0][2][0] == ids.STATUS_OK
    assert "client_key: 0x000000A1, timeout: 1000 ms" in desk.log()
    assert desk.agent.clients[0xA1].session.mtu == 508
    for cut in range(1, 40):
        assert desk.hear(OF_A_C_CLIENT[:-cut], 2) == []


@pytest.mark.parametrize("text, period", [("010000", 10_000), ("500", 500), ("999999", 999_999)])
def test_hard_liveliness_probes_each_period_and_deletes_after_three(desk, text, period):
    hard(desk, text)
    assert f"session hard timeout enabled   | client_key: 0xAABBCCDD, timeout: {period}" in (
        desk.log()
    )
    assert probe_count(desk.wait(period - 1)) == 0
    sent = []
    while KEY in desk.agent.clients:
        assert desk.clock < 5 * period + 3 * SECOND
        sent += desk.wait(period // 10)
    assert probe_count(sent) == 3
    assert desk.clock - SECOND >= 4 * period
    assert f"requested by the client: uxr_hl={period}" in desk.log()


def test_hard_liveliness_of_one_that_answers(desk):
    hard(desk, "1000")
    for _ in range(100):
        desk.wait(2500)
        desk.hear(ANSWERS["C client"])
    assert KEY in desk.agent.clients


def test_hard_liveliness_works_without_a_dead_time():
    desk = desk_with(dead_time=0)
    hard(desk, "1000")
    desk.wait(6 * SECOND)
    assert not desk.agent.clients
    desk.close()


def test_a_stopped_agent_probes_a_hard_liveliness_client_three_times_too(desk):
    hard(desk, "1000")
    stop(desk, 3600)
    assert probe_count(desk.wait(2500)) >= 1
    assert KEY in desk.agent.clients


@pytest.mark.parametrize(
    "text", ["", "no number", "-5", "1e3", "0", "000000", "١٢٣", "9" * 5000, "12 ", "0x10", "5.0"]
)
def test_invalid_hard_liveliness_is_logged_and_ignored(desk, text):
    hard(desk, text)
    assert "hard liveliness ignored" in desk.log()
    assert not desk.agent.liveliness._hard
    assert all(len(log_line) < 400 for log_line in desk.log().splitlines() if "ignored" in log_line)
    assert probe_count(desk.wait(29 * SECOND)) == 0


@pytest.mark.parametrize("text, period", [("1", 100), ("99", 100), ("9" * 19, 3_600_000)])
def test_the_period_of_hard_liveliness_is_limited(desk, text, period):
    hard(desk, text)
    ((timeout, _),) = desk.agent.liveliness._hard.values()
    assert timeout == period


@given(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30))
def test_any_text_is_a_period_or_ignored(text):
    desk = desk_with()
    hard(desk, text)
    for period, _ in desk.agent.liveliness._hard.values():
        assert module.MIN_HARD_MS <= period <= module.MAX_HARD_MS
    desk.wait(5 * SECOND)
    desk.close()


def test_a_client_that_connects_again_without_hard_liveliness_has_the_ordinary_dead_time(desk):
    hard(desk, "1000")
    desk.hear(create_client())
    desk.wait(20 * SECOND)
    assert KEY in desk.agent.clients


# --- over real lines ---------------------------------------------------------------------------


class Quick(RunningAgent):
    """An agent with a clock a hundred times as fast, which checks a hundred times as often."""

    def __init__(self, transport):
        super().__init__(transport, "memory", 0, 4)
        agent, now = self.agent, self.agent.now
        agent.liveliness = module.Liveliness(agent, 100)
        wake_at = self.server.wake_at
        agent.now = lambda: now() * 100 & 0x3FFFFFFF
        self.server.wake_at = lambda seconds, call: wake_at(seconds / 100, call)


@pytest.mark.parametrize("transport", ["udp", "tcp", "pseudoterminal"])
def test_of_two_silent_clients_the_one_that_answers_stays(transport):
    with serving(Quick(transport)) as running:
        answering, silent = XrceClient(running.line(0), 1), XrceClient(running.line(1), 2)
        for client in (answering, silent):
            assert client.open() == ids.STATUS_OK
            client.participant(f"n{client.key}")
        # The client only reads: it answers heartbeats and sends nothing else.
        answering.until(lambda: 2 not in running.agent.clients, "nobody was forgotten")
        assert list(running.agent.clients) == [1]
        assert answering.ping() == 1
    assert "client is silent" in running.said.getvalue()


# --- whether a client is told to be silent ------------------------------------------------


def unanswered(board):
    return board.desk.agent.liveliness.is_unanswered(of(board))


def test_a_probe_is_unanswered_after_some_time_and_until_the_client_is_heard(desk):
    board = Board(desk)
    desk.wait(30 * SECOND)
    assert not unanswered(board)
    desk.wait(4 * SECOND)
    assert unanswered(board)
    board.send(get_info())
    assert not unanswered(board)
    desk.wait(SECOND)
    assert not unanswered(board)


def test_a_client_is_asked_at_once_and_once_in_a_silence(desk):
    board = Board(desk)
    for asked in range(2):
        desk.wait(3 * SECOND)
        assert not unanswered(board)
        for _ in range(3):
            desk.agent.liveliness.ask(of(board))
        assert probe_count(desk.settle()) == 1
        assert probe_count(desk.wait(4 * SECOND)) == 0
        assert unanswered(board), asked
        board.send(get_info())
        assert not unanswered(board)


def test_asking_does_not_shorten_the_dead_time():
    desk = desk_with(dead_time=10)
    board = Board(desk)
    desk.wait(500)
    desk.agent.liveliness.ask(of(board))
    desk.settle()
    desk.wait(9 * SECOND)
    assert of(board) is not None
    desk.wait(3 * SECOND)
    assert board.key not in desk.agent.clients
    desk.close()


def test_a_client_that_has_left_is_no_longer_asked(desk):
    board = Board(desk)
    client = of(board)
    desk.agent.liveliness.ask(client)
    desk.agent.delete_client(board.key)
    desk.wait(2 * SECOND)
    assert not desk.agent.liveliness._asked


def test_a_client_with_hard_liveliness_is_unanswered_too(desk):
    board = Board(desk)
    desk.hear(create_client(properties=[(module.HARD, "3000")]))
    desk.wait(6 * SECOND)
    assert unanswered(board)
