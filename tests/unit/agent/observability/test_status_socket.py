"""The status socket: what it answers, and that no query or connection harms the agent."""

import json
import os
import select
import socket
import stat
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, serving
from support.client import XrceClient
from support.lines import SECONDS
from support.waiting import eventually

from uros.agent.observability import status_socket as module
from uros.agent.observability.status_socket import StatusSocket, folders, sockets
from uros.tools.agent import running_agents as tool
from uros.tools.agent.running_agents import PATIENCE, ask, find_agent, find_agents, stream
from uros.tools.errors import ToolError
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


@contextmanager
def inspected(folder=None):
    """An agent on UDP with a status socket."""
    running = RunningAgent("udp", "memory", 0, 4)
    running.status_socket = StatusSocket(folder)
    running.server.attachments.append(running.status_socket)
    with serving(running):
        yield running


def connect(running):
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(SECONDS)
    sock.connect(str(running.status_socket.path))
    return sock


def own_agent(running):
    """Return the agent's entry as tools find it."""
    return tool.RunningAgent(os.getpid(), running.status_socket.path)


def ours():
    """Return the agents of this process: other processes may run agents on this machine."""
    return [agent for agent in find_agents() if agent.pid == os.getpid()]


def line_of(sock):
    line = b""
    while not line.endswith(b"\n"):
        chunk = sock.recv(1)
        assert chunk, f"it was cut off after {line!r}"
        line += chunk
    return json.loads(line)


def tracing(running, count=1):
    """Wait until so many connections trace messages."""
    eventually(
        lambda: (
            sum(connection.tracing for connection in list(running.status_socket._connections))
            == count
        )
    )


def served(running, key=0x51):
    """Test that a board gets an answer."""
    client = XrceClient(running.line(), key)
    assert client.open() == ids.STATUS_OK
    assert client.ping() == 1
    return client


# --- finding it ---------------------------------------------------------------------


def test_an_agent_is_found_queried_and_no_longer_found_after_its_end():
    assert ours() == []
    with inspected() as running:
        assert len(ours()) == 1
        served(running, 0x1234)
        answer = ask(find_agent(os.getpid()), "status")
        assert answer["pid"] == os.getpid()
        assert [client["key"] for client in answer["clients"]] == ["0x00001234"]
        path = running.status_socket.path
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
        assert stat.S_IMODE(os.stat(path.parent).st_mode) == 0o700
        assert path.name == f"agent-{os.getpid()}.sock" and len(os.listdir(path.parent)) == 1
        assert "status socket open" in running.said.getvalue()
    assert ours() == [] and os.listdir(path.parent) == []


def test_without_a_runtime_folder_the_socket_is_in_tmp(monkeypatch, tmp_path):
    inside = tmp_path / "uros"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    own = folders()[-1]
    assert folders() == [inside, own] and str(own) == f"/tmp/uros-{os.getuid()}"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    assert folders() == [own]
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert folders() == [own]
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(
        os, "getuid", lambda: 12345
    )  # after sudo -E, the folder belongs to another user
    assert [str(folder) for folder in folders()] == ["/tmp/uros-12345"]


def test_sockets_of_ended_agents_are_removed_and_not_found(tmp_path):
    folder = tmp_path / "uros"
    folder.mkdir(mode=0o700)
    for name in ("agent-999999.sock", "agent-999998.sock.new", f"agent-{os.getpid()}.sock"):
        with socket.socket(socket.AF_UNIX) as sock:
            sock.bind(str(folder / name))
    (folder / "notes.txt").write_text("mine")
    with inspected(folder) as running:
        served(running)
        assert sorted(os.listdir(folder)) == [f"agent-{os.getpid()}.sock", "notes.txt"]
        with connect(running) as sock:
            sock.sendall(b'{"ask":"status"}\n')
            assert line_of(sock)["pid"] == os.getpid()


def test_the_socket_of_another_agent_that_runs_stays(tmp_path):
    folder = tmp_path / "uros"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(folder / "agent-1.sock"))
        sock.listen(1)
        with inspected(folder):
            assert sorted(sockets(folder)) == [1, os.getpid()]


def test_access_of_others_to_the_folder_is_removed(tmp_path):
    folder = tmp_path / "uros"
    folder.mkdir(mode=0o755)
    os.chmod(folder, 0o777)
    assert sockets(folder) == {}
    with inspected(folder):
        assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700


def trouble(folder):
    """Return the log of an agent that cannot open its socket there; boards are served."""
    with inspected(folder) as running:
        served(running)
        assert running.status_socket.path is None
        return running.said.getvalue()


def test_a_folder_that_cannot_be_created_is_a_warning(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for folder, why in (
        (tmp_path / "none" / "uros", "No such file"),
        (tmp_path / "file", "exists"),
        (tmp_path / "link", "is not a directory: remove it"),
        (tmp_path / ("x" * 120), "too long"),
    ):
        log = trouble(folder)
        (warning,) = [line for line in log.splitlines() if "warning" in line]
        assert "no status socket" in warning and why in warning, warning
        assert "'uros agent status' will not find this agent; set XDG_RUNTIME_DIR" in warning
    assert os.listdir(tmp_path / "real") == []


def test_a_folder_of_another_user_is_not_used(tmp_path, monkeypatch):
    """Another user may have created the folder in /tmp."""
    folder = tmp_path / "uros"
    folder.mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    assert "belongs to another user" in trouble(folder)


def test_a_system_without_unix_sockets(monkeypatch, tmp_path):
    with monkeypatch.context() as patch:
        patch.delattr(socket, "AF_UNIX")
        with inspected(tmp_path / "uros") as running:
            served(running)
            assert running.status_socket.path is None
            assert "warning" not in running.said.getvalue()


# --- questions ----------------------------------------------------------------------


def test_queries_are_answered_in_order():
    with inspected() as running, connect(running) as sock:
        deep = b"[" * (module.MAX_LINE - 1)
        sock.sendall(b'{"ask":"status"}\n\n{"ask":"weather"}\n' + deep + b'\n{"ask":')
        assert line_of(sock)["version"] == 1
        for _ in range(2):
            assert line_of(sock)["error"].startswith("not understood: ask ")
        sock.sendall(b'"status","more":[1]}\n')
        assert line_of(sock)["version"] == 1


def test_a_peer_that_closes_its_sending_side_still_gets_the_answer():
    """nc -U closes its sending side in this way."""
    with inspected() as running, connect(running) as sock:
        sock.sendall(b'{"ask":"status"}\n')
        sock.shutdown(socket.SHUT_WR)
        assert line_of(sock)["version"] == 1
        assert sock.recv(1) == b""


@pytest.fixture(scope="module")
def shared_agent(tmp_path_factory):
    with inspected(tmp_path_factory.mktemp("one") / "uros") as running:
        yield running


@given(
    st.one_of(
        st.binary(max_size=3000),
        st.lists(
            st.sampled_from(
                [b'{"ask":', b'"status"', b'"trace"', b"}", b"\n", b"[" * 900, b"null", b"\xff"]
            ),
            max_size=30,
        ).map(b"".join),
    )
)
def test_a_valid_query_is_answered_after_any_invalid_one(shared_agent, data):
    with connect(shared_agent) as sock:
        try:
            sock.sendall(data)
            sock.shutdown(socket.SHUT_WR)
            while sock.recv(65536):
                if b'"trace"' in data:
                    break
        except (ConnectionError, TimeoutError):
            assert b'"trace"' in data or len(data) > module.MAX_LINE
    assert ask(own_agent(shared_agent), "status")["pid"] == os.getpid()
    assert "internal error" not in shared_agent.said.getvalue()


@pytest.mark.parametrize("data", [b"x" * 100_000, b"\n" * 1000, b'{"ask":"status"}\n' * 1000])
def test_a_connection_that_sends_no_lines_is_closed(data):
    with inspected() as running, connect(running) as sock:
        try:
            sock.sendall(data)
            while sock.recv(65536):
                pass
        except ConnectionError:
            pass
        eventually(lambda: not running.status_socket._connections)
        served(running)
        assert ask(own_agent(running), "status")["version"] == 1


def test_connections_over_the_limit_are_refused_and_can_retry():
    with inspected() as running:
        connections = [connect(running) for _ in range(module.MAX_CONNECTIONS)]
        connections[-1].sendall(b'{"ask":"status"}\n')
        assert line_of(connections[-1])["version"] == 1
        with pytest.raises(ToolError, match=f"over {module.MAX_CONNECTIONS} connections"):
            ask(own_agent(running), "status")
        connections.pop().close()
        eventually(lambda: len(running.status_socket._connections) < module.MAX_CONNECTIONS)
        assert ask(own_agent(running), "status")["version"] == 1
        for sock in connections:
            sock.close()


# --- slow ones ----------------------------------------------------------------------


def large(running, count=300):
    """Boards with many endpoints, so that an answer is larger than any socket's buffer."""
    clients = [served(running, 0x1000 + index) for index in range(3)]
    for client in clients:
        for number in range(count):
            client.writer("n", f"rt/{'x' * 150}{number}", TYPE)
    return clients


def is_full(connection):
    """Return whether an answer waits because the tool reads nothing."""
    return connection.out and not select.select([], [connection.sock], [], 0)[1]


def test_a_connection_that_does_not_read_costs_little_and_is_closed(monkeypatch):
    monkeypatch.setattr(module, "RATE_SECONDS", 0.1)
    monkeypatch.setattr(module, "_CHUNK", 4096)
    with inspected() as running:
        large(running)
        now = time.monotonic()
        running.status_socket._monotonic = lambda: now  # the test decides when patience ends
        with connect(running) as slow:
            eventually(lambda: running.status_socket._connections)
            (connection,) = running.status_socket._connections
            connection.sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            slow.sendall(b'{"ask":"status"}\n' * 20)
            eventually(lambda: is_full(connection))
            for _ in range(3):
                assert len(ask(own_agent(running), "status")["clients"]) == 3
                assert 0 < len(connection.out) < 100_000  # a chunk, and one client's part
                assert connection in running.status_socket._connections
            now += module.PATIENCE + 1
            eventually(lambda: connection not in running.status_socket._connections)
        served(running)


# --- messages that pass -------------------------------------------------------------


def test_messages_are_sent_to_watching_connections():
    with inspected() as running, connect(running) as shared_agent, connect(running) as second:
        for sock in (shared_agent, second):
            sock.sendall(b'{"ask":"trace"}\n')
        tracing(running, 2)
        served(running, 0xABCDEF)
        for sock in (shared_agent, second):
            lines = [line_of(sock) for _ in range(4)]
            assert [line["from"] for line in lines] == ["client", "agent", "client", "agent"]
            assert lines[2]["key"] == "0x00ABCDEF" and lines[2]["transport"] == "UDPv4Agent"
            assert bytes.fromhex(lines[2]["hex"])[0] == 0x81
        shared_agent.sendall(b'{"ask":"status"}\n')
        assert line_of(shared_agent)["version"] == 1
        assert len(running.agent.message_hooks) == 1
        shared_agent.close()
        second.close()
        eventually(
            lambda: not running.agent.message_hooks
        )  # without a watcher, messages are not formatted
        served(running, 2)


def test_the_tools_stream():
    with inspected() as running:
        lines = stream(own_agent(running), "trace", PATIENCE)
        client = None
        messages = []
        thread = threading.Thread(target=lambda: messages.append(next(lines)))
        thread.start()
        tracing(running)
        client = served(running)
        thread.join(SECONDS)
        assert b'"from": "client"' in messages[0] or b'"from":"client"' in messages[0]
        lines.close()
        assert client.ping() == 1


def test_a_watcher_that_does_not_read_gets_the_number_of_lost_messages(monkeypatch):
    monkeypatch.setattr(module, "MAX_EVENTS", 10)
    monkeypatch.setattr(module, "_CHUNK", 4096)
    with inspected() as running, connect(running) as sock:
        sock.sendall(b'{"ask":"trace"}\n')
        tracing(running)
        passed = []  # all messages, those that the watcher loses too
        running.agent.message_hooks.append(lambda event: passed.append(event.message.hex()))
        client = served(running)
        (connection,) = running.status_socket._connections
        writer = client.writer("n", "rt/x", TYPE)
        # A burst may also fill the queue while the watcher's socket still takes messages.
        while connection.lost < 50 or not is_full(connection):
            for _ in range(50):
                client.write(writer, bytes(400), stream=ids.STREAM_BEST_EFFORT)
            assert client.ping() == 1  # the agent keeps up
        assert len(connection.events) <= 10 and len(connection.out) < 3 * 4096
        seen = largest = 0
        waiting = b""
        # Once it reads again, the first message behind each gap has the number of lost messages.
        while largest < 50:
            if not select.select([sock], [], [], 0)[0]:
                client.ping()
                continue
            *lines, waiting = (waiting + sock.recv(65536)).split(b"\n")
            for line in map(json.loads, lines):
                lost = line.get("lost", 0)
                largest = max(largest, lost)
                seen += lost + 1
                assert line["hex"] == passed[seen - 1]
