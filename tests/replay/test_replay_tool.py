"""``uros replay``: the C library's conversations, captures of our own agent, and what it finds."""

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
# What other nodes published when these were recorded does not come again.
OUTSIDE = ("subscribe_reliable", "rclc_int32_subscriber")
TYPE = "std_msgs::msg::dds_::String_"


def address(agent):
    """Where ``uros replay`` reaches a running agent."""
    if agent.kind == "pseudoterminal":
        return f"serial://{agent.transport.device}"
    scheme = agent.kind if agent.kind.endswith("6") else f"{agent.kind}4"
    host = "[::1]" if agent.kind.endswith("6") else "127.0.0.1"
    return f"{scheme}://{host}:{agent.transport.port}"


def replay(path, agent, *more):
    """(exit status, output)."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = cli.main(["replay", "--fast", str(path), agent, *map(str, more)])
    return status, out.getvalue() + err.getvalue()


@pytest.mark.parametrize("name", NAMES)
def test_recordings_of_the_cpp_agent_are_answered_alike(name):
    more = ["--no-data"] if name in OUTSIDE else []
    with running_agent("udp", "memory") as agent:
        status, said = replay(CAPTURES / f"{name}.jsonl", address(agent), *more)
    assert status == 0, said
    assert said.endswith("the answers are as recorded\n")


@pytest.mark.parametrize("kind", ["udp6", "tcp", "tcp6", "pseudoterminal"])
@pytest.mark.parametrize("name", ["rclc_trigger", "serial_publish"])
def test_over_whichever_transport(kind, name):
    with running_agent(kind, "memory") as agent:
        status, said = replay(CAPTURES / f"{name}.jsonl", address(agent))
    assert status == 0, said


def test_by_the_clock_of_the_recording(tmp_path):
    """A second between two messages is a second again."""
    path = tmp_path / "it"
    lines = (CAPTURES / "ping.jsonl").read_text().splitlines(keepends=True)
    records = [it.replace('"t": 0.', '"t": 1.') if i > 2 else it for i, it in enumerate(lines)]
    path.write_text("".join(records))
    recorded_gap = list(read(path))[4].time - list(read(path))[0].time
    with running_agent("udp", "memory") as agent:
        heard = []
        agent.agent.message_hooks.append(heard.append)
        assert cli.main(["replay", str(path), address(agent)]) == 0
    times = [it.now / 1e6 for it in heard if it.direction == "client"]
    assert recorded_gap > 1 and times[-1] - times[0] >= recorded_gap * 0.99


# --- captures of our own ------------------------------------------------------------------------


def converse(agent):
    """A conversation of two boards: a topic, samples of all sizes, a service, farewells."""
    talker, listener = XrceClient(agent.line(0), 0xCAFE), XrceClient(agent.line(1), 0xBEEF)
    for it in (talker, listener):
        assert it.open() == ids.STATUS_OK
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
    for it in (talker, listener):
        assert it.close() == ids.STATUS_OK


@pytest.mark.parametrize("form", ["pcapng", "jsonl"])
@pytest.mark.parametrize("kind", ["udp", "udp6", "tcp", "serial", "can"])
def test_a_capture_opens_in_wireshark_and_replays_into_a_fresh_agent(kind, form, tmp_path):
    path = tmp_path / f"it.{form}"
    passed = []
    with running_agent(kind, "memory") as agent:
        capture = Capture(str(path), 10**9, agent.agent.log, agent.agent.message_hooks)
        agent.agent.message_hooks.append(passed.append)
        agent.line(7).send(b"nonsense of a stranger")
        converse(agent)
    capture.close()
    records = list(read(path))
    assert [(it.from_client, it.message) for it in records] == [
        (it.direction == "client", it.message) for it in passed
    ]
    assert b"nonsense of a stranger" in [it.message for it in records]
    addresses = {agent.transport.address(it.peer) for it in passed}
    assert {it.address for it in records} == addresses and len(addresses) == 3
    if form == "pcapng":
        found = packets(path)
        assert [it.payload for it in found] == [it.message for it in passed]
        assert all(it.checksums_good for it in found)
        assert [it.outbound for it in found] == [it.direction == "agent" for it in passed]
        assert {it.interface for it in found} == {agent.transport.name}
        for packet, it in zip(found, passed, strict=True):
            where = agent.transport.address(it.peer)
            assert packet.comment.startswith(f"{agent.transport.name} {where}")
            assert float(packet.time) == pytest.approx(it.now / 1e6, abs=1e-6)
            board = packet.destination if packet.outbound else packet.source
            if kind in ("udp", "udp6", "tcp"):
                ours = packet.source if packet.outbound else packet.destination
                host = "::1" if kind == "udp6" else "127.0.0.1"
                assert ours == (host, agent.transport.port)
                assert where in (f"{board[0]}:{board[1]}", f"[{board[0]}]:{board[1]}")
            else:
                assert board[0].startswith("127.1.0.")
    else:
        assert len(recorded.load(path)) == len(passed)
    with running_agent("udp", "memory") as fresh:
        status, said = replay(path, address(fresh))
    assert status == 0, said
    assert "0x0000CAFE" in said and "0x0000BEEF" in said and "nonsense" not in said
    (stranger,) = [it for it in said.splitlines() if "is left out" in it]
    assert "its session began before the capture" in stranger


def test_a_capture_that_began_late_is_played_from_the_next_session_on():
    records = list(read(CAPTURES / "publish_reliable.jsonl"))
    late = records[5:] + records
    whole = script(records)
    play = script(late)
    assert not play.left_out
    assert [it._replace(time=0.0) if isinstance(it, Step) else it for it in play.turns] == [
        it._replace(time=0.0) if isinstance(it, Step) else it for it in whole.turns
    ]
    assert script(records[5:]).left_out == {0: "its session began before the capture"}


def test_what_came_twice_or_late_is_played_once_and_in_order():
    records = list(read(CAPTURES / "rclc_int32_publisher.jsonl"))
    spoilt = []
    for first, second in zip(records[::2], records[1::2], strict=False):
        swap = first.from_client == second.from_client
        spoilt += [second, first, first] if swap else [first, first, second]
    plain, played = script(records[: len(records) // 2 * 2]), script(spoilt)

    def steps(play):
        return [it.message for it in play.turns if isinstance(it, Step) and it.stream > 127]

    def answers(play):
        found = [it for it in play.turns if isinstance(it, Answer)]
        return [it.same for it in found if it.list == ("stream", 0x80)]

    assert steps(plain) == steps(played) and len(steps(plain)) > 20
    assert answers(plain) == answers(played) and len(answers(plain)) > 5


# --- what it finds ------------------------------------------------------------------------------


def test_another_answer_is_found_and_shown(monkeypatch):
    push_status = session.push_status

    def other(w, request_id, object_id, status, implementation=0):
        push_status(w, request_id, object_id, ids.STATUS_OK_MATCHED, implementation)

    monkeypatch.setattr(session, "push_status", other)
    with running_agent("udp", "memory") as agent:
        status, said = replay(CAPTURES / "publish_reliable.jsonl", address(agent))
    assert status == 1
    table = said.splitlines()
    assert table[0].split() == [
        "client", "sent", "answers", "as", "recorded", "differ", "missing", "more",
    ]  # fmt: skip
    assert table[1].split()[-5:] == ["6", "1", "5", "0", "0"]
    assert "client 0, stream reliable, answer 1:\n" in said
    assert "  recorded  STATUS #10 0x001(1) OK\n  now       STATUS #10 0x001(1) OK_MATCHED\n" in (
        said
    )
    assert said.endswith("the answers differ\n")


def test_an_agent_that_refuses_the_session_is_told():
    with running_agent("udp", "memory") as agent:
        agent.agent.admission = Admission(keys=frozenset([1]))
        path = CAPTURES / "rclc_int32_publisher.jsonl"
        status, said = replay(path, address(agent), "--patience", 0.2)
    assert status == 1
    assert "refused the session (STATUS_AGENT ERR_DENIED)" in said
    assert said.endswith("replay to an agent that was just started\n")


def test_samples_that_do_not_come_are_missing_and_it_says_why():
    with running_agent("udp", "memory") as agent:
        path = CAPTURES / "subscribe_reliable.jsonl"
        status, said = replay(path, address(agent), "--patience", 0.2)
    assert status == 1
    assert said.splitlines()[1].split()[-5:] == ["10", "6", "0", "4", "0"]
    assert "  now       (nothing)\n" in said and "--no-data leaves samples out" in said


def test_an_answer_too_many_is_found(tmp_path):
    path = tmp_path / "it"
    lines = (CAPTURES / "ping.jsonl").read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))  # without the last answer
    with running_agent("udp", "memory") as agent:
        status, said = replay(path, address(agent))
    assert status == 1
    assert said.splitlines()[1].split()[-5:] == ["2", "2", "0", "0", "1"]
    assert "  recorded  (nothing)\n  now       INFO #10 agent OK session known\n" in said


def test_messages_that_get_lost_are_sent_again(monkeypatch):
    """Both ways, each reliable one once."""
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
        UdpConnection, "read", lambda self: [it for it in receive(self) if not losing(it)]
    )
    with running_agent("udp", "memory") as agent:
        status, said = replay(CAPTURES / "publish_reliable.jsonl", address(agent))
    assert status == 0, said
    assert len(lost) > 6


def test_no_agent_is_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        where = f"127.0.0.1:{silent.getsockname()[1]}"
        path = CAPTURES / "ping.jsonl"
        status, said = replay(path, f"udp4://{where}", "--patience", 0.1)
        assert status == 1
        assert said == (
            f"uros: no agent answers at udp4://{where}: start one ('uros agent'), or"
            " correct the address\n"
        )
        status, said = replay(path, f"tcp4://{where}")
        assert status == 1 and "cannot connect to tcp4://" in said and "refused" in said
    status, said = replay(path, "serial:///dev/not-there")
    assert status == 1 and "No such file or directory; is the agent running?" in said


@pytest.mark.parametrize(
    "where",
    [
        "", "127.0.0.1:8888", "udp4://", "udp4://127.0.0.1", "udp4://127.0.0.1:x", "udp5://a:1",
        "serial://", "serial://host/dev/x", "serial:///dev/x?baudrate=fast", "udp6://[::1:8888",
        "udp4://127.0.0.1:99999",
    ],
)  # fmt: skip
def test_what_is_no_address(where):
    status, said = replay(CAPTURES / "ping.jsonl", where)
    assert status == 1
    assert "is not an address of an agent" in said and "use udp4://127.0.0.1:8888" in said


def test_nothing_to_play(tmp_path):
    path = tmp_path / "it"
    path.write_text("")
    assert replay(path, "udp4://127.0.0.1:1") == (
        1, f"uros: {path} has nothing to play: no board opens a session in it\n"
    )  # fmt: skip


def test_an_agent_that_ends_in_between_is_told():
    with running_agent("tcp", "memory") as agent:
        play = script(read(CAPTURES / "publish_reliable.jsonl"))
        connections = Connections(address(agent))
        player = Player(play, connections, True, 0.5, True)
        connect = connections.connect

        def ending(client):
            found = connect(client)
            send = found.send

            def stop(message):
                send(message)
                if message[1] == 0x80:
                    agent.stop()

            found.send = stop
            return found

        connections.connect = ending
        with pytest.raises(ToolError, match="closed the connection|to the agent is lost"):
            player.play()
        player.close()


def test_nonsense_in_a_capture_is_played_too():
    records = list(read(CAPTURES / "ping.jsonl"))
    nonsense = [
        Record(it.time, it.from_client, it.client, "UDP", "x", 0, it.message[:9] + os.urandom(9))
        for it in records
    ]
    with running_agent("udp", "memory") as agent:
        play = script([*records[:2], *nonsense])
        player = Player(play, Connections(address(agent)), True, 0.2, True)
        player.play()
        player.close()


RECORDED = [it for name in NAMES for it in read(CAPTURES / f"{name}.jsonl")]


@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 1), st.binary(max_size=60))
        | st.sampled_from(RECORDED).map(lambda it: (it.from_client, it.client, it.message)),
        max_size=12,
    ),
    st.data(),
)
def test_any_capture_becomes_a_play(said, data):
    opening = next(it.message for it in RECORDED if it.message[4] == ids.CREATE_CLIENT)
    records = [Record(0.0, True, client, "UDP", "x", 0, opening) for client in (0, 1)]
    for from_client, client, message in said:
        octets = bytearray(message)
        if octets and data.draw(st.booleans()):
            octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
        records.append(Record(0.0, from_client, client, "UDP", "x", 0, bytes(octets)))
    play = script(records)
    assert not play.left_out
    for turn in play.turns:
        assert isinstance(turn, Step) or str(turn).isprintable()
