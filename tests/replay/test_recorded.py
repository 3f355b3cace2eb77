"""RecordedBoard with a recorded agent, in simulated time."""

import pytest
from support import recorded
from support.recorded import RecordedBoard, RecordingError
from support.replay import CAPTURES, load

from uros.wire import ids
from uros.wire.header import MessageWriter, pull_header
from uros.wire.session import pull_acknack, push_acknack

WEATHER = load("rclc_temperature_humidity")


def stream_of(message):
    return pull_header(message, len(message))[1]


class RecordedAgent:
    """Sends the answers of the recorded agent, each after the same message of the board."""

    def __init__(self, records, client=0):
        self._turns = []
        for record in records:
            if record.client != client or recorded.is_acknowledgement(record.data):
                continue
            if record.from_client:
                self._turns.append([])
            else:
                self._turns[-1].append(record.data)
        self.heard = []
        self._next = {}

    def take(self, message):
        """The agent's answers to a message."""
        if recorded.is_acknowledgement(message):
            return []
        stream, number = pull_header(message, len(message))[1:3]
        out = []
        if stream >= ids.STREAM_RELIABLE:
            if number != self._next.get(stream, 0):
                return [self.acknack(stream)]
            self._next[stream] = number + 1
            out.append(self.acknack(stream))
        if len(self.heard) < len(self._turns):
            out += self._turns[len(self.heard)]
        self.heard.append(message)
        return out

    def acknack(self, stream):
        w = MessageWriter(bytearray(32), 0x81, ids.STREAM_NONE, 0)
        w.begin(ids.ACKNACK)
        push_acknack(w, self._next.get(stream, 0), 0, stream)
        return w.finish()


def play(board, agent, until=10**6, lose=lambda message: False):
    """Run a board in simulated time; (time, message) of all but ACKNACK and HEARTBEAT."""
    now = 0
    sent = []
    while not board.done and now <= until:
        for message in board.outgoing(now):
            if not recorded.is_acknowledgement(message):
                sent.append((now, message))
            if not lose(message):
                for answer in agent.take(message):
                    board.receive(answer, now)
        deadline = board.next_deadline(now)
        if board.done or deadline is None:
            break
        now = max(now, deadline)
    return sent


def recorded_messages(records, client=0):
    return [
        record.data
        for record in records
        if record.from_client and record.client == client
        and not recorded.is_acknowledgement(record.data)
    ]  # fmt: skip


UDP = sorted(
    path.stem for path in CAPTURES.glob("*.jsonl") if not path.stem.startswith(("serial", "tcp"))
)


@pytest.mark.parametrize("name", UDP)
def test_a_board_sends_the_recorded_bytes_and_not_earlier(name):
    records = load(name)
    for client in {record.client for record in records}:
        board = RecordedBoard(records, client)
        sent = play(board, RecordedAgent(records, client))
        assert board.done
        assert [message for _, message in sent] == recorded_messages(records, client)
        times = [
            record.time * 1000
            for record in records
            if record.from_client and record.client == client
            and not recorded.is_acknowledgement(record.data)
        ]  # fmt: skip
        assert all(
            abs((at - sent[0][0]) - (then - times[0])) <= 1
            for (at, _), then in zip(sent, times, strict=True)
        )


def test_an_endless_board_repeats_with_its_intervals_and_rising_sequence_numbers():
    agent = RecordedAgent(WEATHER)
    board = RecordedBoard(WEATHER, endless=True)
    sent = play(board, agent, until=60_000)
    assert not board.done
    data = [(at, m) for at, m in sent if m[4] == ids.WRITE_DATA]
    assert board.published == len(data)
    assert 2 * 118 <= len(data) <= 2 * 121  # two samples each 500 ms
    numbers = [pull_header(m, len(m))[2] for _, m in sent if stream_of(m) == 0x80]
    assert numbers == list(range(len(numbers)))
    originals = [m[4:] for m in recorded_messages(WEATHER) if m[4] == ids.WRITE_DATA]
    assert [m[4:] for _, m in data] == [originals[i % len(originals)] for i in range(len(data))]
    firsts = [at for at, _ in data[::2]]
    gaps = [b - a for a, b in zip(firsts, firsts[1:], strict=False)]
    assert all(498 <= gap <= 502 for gap in gaps)


def test_finish_closes_the_session_as_recorded():
    agent = RecordedAgent(WEATHER)
    board = RecordedBoard(WEATHER, endless=True)
    play(board, agent, until=10_000)
    published = board.published
    board.finish(10_001)
    now = 10_001
    while not board.done:
        for message in board.outgoing(now):
            kinds = [kind for kind, _, _ in recorded.submessages(message)]
            if kinds == [ids.DELETE] * len(kinds):
                # The recorded agent has no answer left; this one confirms the DELETE.
                for kind, _, payload in recorded.submessages(message):
                    board.receive(status(agent, stream_of(message), kind, payload), now)
            for answer in agent.take(message):
                board.receive(answer, now)
        now += 1
        assert now < 10_001 + recorded.CLOSE_MS + 10
    assert board.published <= published + 1
    last = [m for m in agent.heard if m[4] == ids.DELETE][-1]
    assert last[6:12] == b"\x04\x00\x00\x02\xff\xfe"


_numbers = {}


def status(agent, stream, kind, payload):
    number = _numbers.setdefault(id(agent), {}).get(stream, 7)
    _numbers[id(agent)][stream] = number + 1
    w = MessageWriter(bytearray(32), 0x81, stream, number if stream else 0)
    w.begin(ids.STATUS)
    w.octets(payload[:4] + b"\0\0")
    return w.finish()


def test_finish_without_an_agent_ends_at_once():
    board = RecordedBoard(WEATHER, endless=True)
    board.outgoing(0)
    board.finish(5)
    assert board.done


def test_finish_after_the_agent_has_gone_ends_in_time():
    agent = RecordedAgent(WEATHER)
    board = RecordedBoard(WEATHER, endless=True)
    play(board, agent, until=5000)
    board.finish(5000)
    now = 5000
    while not board.done:
        board.outgoing(now)
        now = board.next_deadline(now) or now
        assert now <= 5000 + recorded.CLOSE_MS


def test_lost_messages_are_retransmitted():
    lost = set()

    def lose(message):
        """Lose every message once."""
        key = bytes(message)
        if recorded.is_acknowledgement(message) or key in lost:
            return False
        lost.add(key)
        return True

    class Agent(RecordedAgent):
        def take(self, message):
            """Request the message that a HEARTBEAT announces."""
            if message[4] == ids.HEARTBEAT:
                stream = message[12]
                w = MessageWriter(bytearray(32), 0x81, ids.STREAM_NONE, 0)
                w.begin(ids.ACKNACK)
                push_acknack(w, self._next.get(stream, 0), 1, stream)
                return [w.finish()]
            return super().take(message)

    agent = Agent(WEATHER)
    board = RecordedBoard(WEATHER)
    play(board, agent, lose=lose)
    assert board.done
    assert agent.heard == recorded_messages(WEATHER)


def test_answers_are_acknowledged():
    agent = RecordedAgent(WEATHER)
    board = RecordedBoard(WEATHER)
    acknowledged = []
    now = 0
    while not board.done:
        for message in board.outgoing(now):
            if message[4] == ids.ACKNACK:
                from uros.wire.cdr import Reader

                acknowledged.append(pull_acknack(Reader(message, 8, len(message))))
            for answer in agent.take(message):
                board.receive(answer, now)
        now = board.next_deadline(now) or now
    assert acknowledged[-1][0] == 14 and acknowledged[-1][1:] == (0, 0x80)


def test_the_board_creates_its_session_again_at_a_late_or_new_agent():
    board = RecordedBoard(WEATHER, endless=True)
    now = 0
    sent = []
    while now < 20_000:  # without an agent
        sent += board.outgoing(now)
        now = board.next_deadline(now)
    assert 10 <= len(sent) <= 60 and {m[4] for m in sent} == {ids.CREATE_CLIENT}
    # Then with an agent, and later with a new one that has no session.
    for _ in range(2):
        agent = RecordedAgent(WEATHER)
        end = now + 20_000
        while now < end:
            for message in board.outgoing(now):
                if not agent.heard and message[4] != ids.CREATE_CLIENT:
                    continue  # of an unknown session
                for answer in agent.take(message):
                    board.receive(answer, now)
            now = max(now, board.next_deadline(now))
        assert len([m for m in agent.heard if m[4] == ids.WRITE_DATA]) > 40


def test_junk_from_the_agent_is_dropped():
    board = RecordedBoard(WEATHER)
    for junk in (b"", b"\x81", b"\x81\x00\x00\x00\x0a\x01\xff\xff", bytes(50), b"\x81\x80\0\0"):
        board.receive(junk, 0)
    play(board, RecordedAgent(WEATHER))
    assert board.done


def test_only_acknowledgements_are_left_out_of_the_comparison():
    kinds = {
        kind
        for record in WEATHER
        if recorded.is_acknowledgement(record.data)
        for kind, _, _ in recorded.submessages(record.data)
    }
    assert kinds == {ids.ACKNACK}


@pytest.mark.parametrize(
    "line",
    ["{", "[]", '{"t": 0}', '{"t": 0, "from": "nobody", "client": 0, "hex": ""}',
     '{"t": 0, "from": "agent", "client": 0, "hex": "0"}'],
)  # fmt: skip
def test_the_error_for_a_bad_recording_names_the_line(tmp_path, line):
    path = tmp_path / "x.jsonl"
    path.write_text('{"t": 0, "from": "agent", "client": 0, "hex": ""}\n' + line + "\n")
    with pytest.raises(RecordingError, match=r"x\.jsonl:2: not a record"):
        recorded.load(path)


def test_the_error_for_a_missing_file_names_it(tmp_path):
    with pytest.raises(RecordingError, match="none.jsonl"):
        recorded.load(tmp_path / "none.jsonl")


def test_a_recording_of_another_kind_is_refused():
    with pytest.raises(RecordingError, match="not a recording of datagrams"):
        RecordedBoard(load("tcp_publish"))
    with pytest.raises(RecordingError, match="no client 3"):
        RecordedBoard(WEATHER, client=3)
    with pytest.raises(RecordingError, match="publishes nothing"):
        RecordedBoard(load("ping"), endless=True)
