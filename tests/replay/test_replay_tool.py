"""``uros replay``: conversations of the C library, captures of our agent, and differences."""

import io
import os
import socket
from contextlib import redirect_stderr, redirect_stdout

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import recorded
from support.agent import running_agent
from support.client import XrceClient
from support.replay import CAPTURES
from support.tshark import packets

from uros.agent.observability.capture import Capture
from uros.agent.policy.admission import Admission
from uros.tools import cli
from uros.tools.capture.connections import Connections, UdpConnection
from uros.tools.capture.recordings import read
from uros.tools.capture.records import Record
from uros.tools.capture.replay import Player
from uros.tools.capture.script import Answer, Step, script
from uros.tools.errors import ToolError
from uros.wire import ids, session

NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))
# Captures with samples of nodes that are not in the capture.
OUTSIDE = ("subscribe_reliable", "rclc_int32_subscriber")
TYPE = "std_msgs::msg::dds_::String_"


def address(agent):
    """The address of a running agent, as an argument of ``uros replay``."""
    if agent.kind == "pseudoterminal":
        return f"serial://{agent.transport.device}"
    scheme = agent.kind if agent.kind.endswith("6") else f"{agent.kind}4"
    host = "[::1]" if agent.kind.endswith("6") else "127.0.0.1"
    return f"{scheme}://{host}:{agent.transport.port}"


def replay(path, agent, *more):
    """Run ``uros replay --fast``; (exit status, output)."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = cli.main(["replay", "--fast", str(path), agent, *map(str, more)])
    return status, out.getvalue() + err.getvalue()


@pytest.mark.parametrize("name", NAMES)
def test_recordings_of_the_cpp_agent_get_the_same_answers(name):
    more = ["--no-data"] if name in OUTSIDE else []
    with running_agent("udp", "memory") as agent:
        status, output = replay(CAPTURES / f"{name}.jsonl", address(agent), *more)
    assert status == 0, output
    assert output.endswith("the answers are as recorded\n")


@pytest.mark.parametrize("kind", ["udp6", "tcp", "tcp6", "pseudoterminal"])
@pytest.mark.parametrize("name", ["rclc_trigger", "serial_publish"])
def test_replay_over_each_transport(kind, name):
    with running_agent(kind, "memory") as agent:
        status, output = replay(CAPTURES / f"{name}.jsonl", address(agent))
    assert status == 0, output


def test_replay_with_the_times_of_the_recording(tmp_path):
    """Without ``--fast``, a recorded gap of a second takes a second."""
    path = tmp_path / "it"
    lines = (CAPTURES / "ping.jsonl").read_text().splitlines(keepends=True)
    records = [
        line.replace('"t": 0.', '"t": 1.') if i > 2 else line for i, line in enumerate(lines)
    ]
    path.write_text("".join(records))
    recorded_gap = list(read(path))[4].time - list(read(path))[0].time
    with running_agent("udp", "memory") as agent:
        events = []
        agent.agent.message_hooks.append(events.append)
        assert cli.main(["replay", str(path), address(agent)]) == 0
    times = [event.now / 1e6 for event in events if event.direction == "client"]
    assert recorded_gap > 1 and times[-1] - times[0] >= recorded_gap * 0.99


# --- captures of our agent ----------------------------------------------------------------------


def converse(agent):
    """A conversation of two boards: a topic, samples of several sizes, DELETE, close."""
    talker, listener = XrceClient(agent.line(0), 0xCAFE), XrceClient(agent.line(1), 0xBEEF)
    for client in (talker, listener):
        assert client.open() == ids.STATUS_OK
    writer = talker.writer("talker", "rt/chatter", TYPE)
    reader = listener.reader("listener", "rt/chatter", TYPE)
    listener.read(reader)
    for size in (10, 500, 3000):
        talker.write(writer, (size - 5).to_bytes(4, "little") + bytes(size))
        listener.until(lambda: len(listener.samples.get(reader, ())) > 0, "no sample")
        listener.samples.clear()
    assert talker.ping() == 1
    assert listener.delete(reader) == ids.STATUS_OK
    assert listener.delete(0x0995) == ids.STATUS_ERR_UNKNOWN_REFERENCE
    for client in (talker, listener):
        assert client.close() == ids.STATUS_OK


@pytest.mark.parametrize("form", ["pcapng", "jsonl"])
@pytest.mark.parametrize("kind", ["udp", "udp6", "tcp", "serial", "can"])
def test_a_capture_opens_in_wireshark_and_replays_into_a_fresh_agent(kind, form, tmp_path):
    path = tmp_path / f"it.{form}"
    events = []
    with running_agent(kind, "memory") as agent:
        capture = Capture(str(path), 10**9, agent.agent.log, agent.agent.message_hooks)
        agent.agent.message_hooks.append(events.append)
        agent.line(7).send(b"nonsense of an unknown session")
        converse(agent)
    capture.close()
    records = list(read(path))
    assert [(record.from_client, record.message) for record in records] == [
        (event.direction == "client", event.message) for event in events
    ]
    assert b"nonsense of an unknown session" in [record.message for record in records]
    addresses = {agent.transport.address(event.peer) for event in events}
    assert {record.address for record in records} == addresses and len(addresses) == 3
    if form == "pcapng":
        dissected = packets(path)
        assert [packet.payload for packet in dissected] == [event.message for event in events]
        assert all(packet.checksums_good for packet in dissected)
        assert [packet.outbound for packet in dissected] == [
            event.direction == "agent" for event in events
        ]
        assert {packet.interface for packet in dissected} == {agent.transport.name}
        for packet, event in zip(dissected, events, strict=True):
            where = agent.transport.address(event.peer)
            assert packet.comment.startswith(f"{agent.transport.name} {where}")
            assert float(packet.time) == pytest.approx(event.now / 1e6, abs=1e-6)
            board = packet.destination if packet.outbound else packet.source
            if kind in ("udp", "udp6", "tcp"):
                ours = packet.source if packet.outbound else packet.destination
                host = "::1" if kind == "udp6" else "127.0.0.1"
                assert ours == (host, agent.transport.port)
                assert where in (f"{board[0]}:{board[1]}", f"[{board[0]}]:{board[1]}")
            else:
                assert board[0].startswith("127.1.0.")
    else:
        assert len(recorded.load(path)) == len(events)
    with running_agent("udp", "memory") as fresh:
        status, output = replay(path, address(fresh))
    assert status == 0, output
    assert "0x0000CAFE" in output and "0x0000BEEF" in output and "nonsense" not in output
    (left_out,) = [line for line in output.splitlines() if "is left out" in line]
    assert "its session began before the capture" in left_out


def test_a_capture_that_began_late_is_replayed_from_the_next_session():
    records = list(read(CAPTURES / "publish_reliable.jsonl"))
    late = records[5:] + records
    whole = script(records)
    play = script(late)
    assert not play.left_out
    assert [turn._replace(time=0.0) if isinstance(turn, Step) else turn for turn in play.turns] == [
        turn._replace(time=0.0) if isinstance(turn, Step) else turn for turn in whole.turns
    ]
    assert script(records[5:]).left_out == {0: "its session began before the capture"}


def test_duplicated_and_late_messages_are_replayed_once_and_in_order():
    records = list(read(CAPTURES / "rclc_int32_publisher.jsonl"))
    spoilt = []
    for first, second in zip(records[::2], records[1::2], strict=False):
        swap = first.from_client == second.from_client
        spoilt += [second, first, first] if swap else [first, first, second]
    plain, played = script(records[: len(records) // 2 * 2]), script(spoilt)

    def steps(play):
        return [turn.message for turn in play.turns if isinstance(turn, Step) and turn.stream > 127]

    def answers(play):
        recorded_answers = [turn for turn in play.turns if isinstance(turn, Answer)]
        return [turn.same for turn in recorded_answers if turn.list == ("stream", 0x80)]

    assert steps(plain) == steps(played) and len(steps(plain)) > 20
    assert answers(plain) == answers(played) and len(answers(plain)) > 5


# --- differences --------------------------------------------------------------------------------


def test_a_different_answer_is_shown(monkeypatch):
    push_status = session.push_status

    def push_matched(w, request_id, object_id, status, implementation=0):
        push_status(w, request_id, object_id, ids.STATUS_OK_MATCHED, implementation)

    monkeypatch.setattr(session, "push_status", push_matched)
    with running_agent("udp", "memory") as agent:
        status, output = replay(CAPTURES / "publish_reliable.jsonl", address(agent))
    assert status == 1
    table = output.splitlines()
    assert table[0].split() == [
        "client", "sent", "answers", "as", "recorded", "differ", "missing", "more",
    ]  # fmt: skip
    assert table[1].split()[-5:] == ["6", "1", "5", "0", "0"]
    assert "client 0, stream reliable, answer 1:\n" in output
    assert "  recorded  STATUS #10 0x001(1) OK\n  now       STATUS #10 0x001(1) OK_MATCHED\n" in (
        output
    )
    assert output.endswith("the answers differ\n")


def test_an_agent_that_refuses_the_session_is_reported():
    with running_agent("udp", "memory") as agent:
        agent.agent.admission = Admission(keys=frozenset([1]))
        path = CAPTURES / "rclc_int32_publisher.jsonl"
        status, output = replay(path, address(agent), "--patience", 0.2)
    assert status == 1
    assert "refused the session (STATUS_AGENT ERR_DENIED)" in output
    assert output.endswith("replay to an agent that was just started\n")


def test_absent_samples_are_missing_and_the_output_has_the_reason():
    with running_agent("udp", "memory") as agent:
        path = CAPTURES / "subscribe_reliable.jsonl"
        status, output = replay(path, address(agent), "--patience", 0.2)
    assert status == 1
    assert output.splitlines()[1].split()[-5:] == ["10", "6", "0", "4", "0"]
    assert "  now       (nothing)\n" in output and "--no-data leaves samples out" in output


def test_an_additional_answer_is_shown(tmp_path):
    path = tmp_path / "it"
    lines = (CAPTURES / "ping.jsonl").read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))  # without the last answer
    with running_agent("udp", "memory") as agent:
        status, output = replay(path, address(agent))
    assert status == 1
    assert output.splitlines()[1].split()[-5:] == ["2", "2", "0", "0", "1"]
    assert "  recorded  (nothing)\n  now       INFO #10 agent OK session known\n" in output


def test_lost_messages_are_retransmitted(monkeypatch):
    """Each reliable message is lost once in each direction; the answers are as recorded."""
    send, receive = UdpConnection.send, UdpConnection.read
    lost = set()

    def losing(message):
        if message[1] < ids.STREAM_RELIABLE or message in lost:
            return False
        lost.add(message)
        return True

    monkeypatch.setattr(
        UdpConnection, "send", lambda self, message: losing(message) or send(self, message)
    )
    monkeypatch.setattr(
        UdpConnection,
        "read",
        lambda self: [message for message in receive(self) if not losing(message)],
    )
    with running_agent("udp", "memory") as agent:
        status, output = replay(CAPTURES / "publish_reliable.jsonl", address(agent))
    assert status == 0, output
    assert len(lost) > 6


def test_a_missing_agent_is_an_error_of_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        where = f"127.0.0.1:{silent.getsockname()[1]}"
        path = CAPTURES / "ping.jsonl"
        status, output = replay(path, f"udp4://{where}", "--patience", 0.1)
        assert status == 1
        assert output == (
            f"uros: no agent answers at udp4://{where}: start one ('uros agent'), or"
            " correct the address\n"
        )
        status, output = replay(path, f"tcp4://{where}")
        assert status == 1 and "cannot connect to tcp4://" in output and "refused" in output
    status, output = replay(path, "serial:///dev/not-there")
    assert status == 1 and "No such file or directory; is the agent running?" in output


@pytest.mark.parametrize(
    "where",
    [
        "", "127.0.0.1:8888", "udp4://", "udp4://127.0.0.1", "udp4://127.0.0.1:x", "udp5://a:1",
        "serial://", "serial://host/dev/x", "serial:///dev/x?baudrate=fast", "udp6://[::1:8888",
        "udp4://127.0.0.1:99999",
    ],
)  # fmt: skip
def test_an_invalid_address_is_refused(where):
    status, output = replay(CAPTURES / "ping.jsonl", where)
    assert status == 1
    assert "is not an address of an agent" in output and "use udp4://127.0.0.1:8888" in output


def test_a_capture_without_a_session_is_refused(tmp_path):
    path = tmp_path / "it"
    path.write_text("")
    assert replay(path, "udp4://127.0.0.1:1") == (
        1, f"uros: {path} has nothing to play: no board opens a session in it\n"
    )  # fmt: skip


def test_an_agent_that_ends_during_the_replay_is_reported():
    with running_agent("tcp", "memory") as agent:
        play = script(read(CAPTURES / "publish_reliable.jsonl"))
        connections = Connections(address(agent))
        player = Player(play, connections, True, 0.5, True)
        connect = connections.connect

        def ending(client):
            connection = connect(client)
            send = connection.send

            def stop(message):
                send(message)
                if message[1] == 0x80:
                    agent.stop()

            connection.send = stop
            return connection

        connections.connect = ending
        with pytest.raises(ToolError, match="closed the connection|to the agent is lost"):
            player.play()
        player.close()


def test_invalid_messages_in_a_capture_are_replayed_too():
    records = list(read(CAPTURES / "ping.jsonl"))
    nonsense = [
        Record(
            record.time,
            record.from_client,
            record.client,
            "UDP",
            "x",
            0,
            record.message[:9] + os.urandom(9),
        )
        for record in records
    ]
    with running_agent("udp", "memory") as agent:
        play = script([*records[:2], *nonsense])
        player = Player(play, Connections(address(agent)), True, 0.2, True)
        player.play()
        player.close()


RECORDED = [record for name in NAMES for record in read(CAPTURES / f"{name}.jsonl")]


@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 1), st.binary(max_size=60))
        | st.sampled_from(RECORDED).map(
            lambda record: (record.from_client, record.client, record.message)
        ),
        max_size=12,
    ),
    st.data(),
)
def test_any_capture_becomes_a_script(messages, data):
    opening = next(record.message for record in RECORDED if record.message[4] == ids.CREATE_CLIENT)
    records = [Record(0.0, True, client, "UDP", "x", 0, opening) for client in (0, 1)]
    for from_client, client, message in messages:
        octets = bytearray(message)
        if octets and data.draw(st.booleans()):
            octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
        records.append(Record(0.0, from_client, client, "UDP", "x", 0, bytes(octets)))
    play = script(records)
    assert not play.left_out
    for turn in play.turns:
        assert isinstance(turn, Step) or str(turn).isprintable()
