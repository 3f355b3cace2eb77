"""`uros doctor`: ports that are taken, and what agents' snapshots tell."""

import os
import shlex
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

from uros.tools.doctor import process as doctor_process
from uros.tools.doctor.agents import (
    _free,
    check_agents,
    check_clocks,
    check_keys,
    check_lines,
    check_middleware,
    check_others_refused,
    check_port,
    check_problems,
    check_refused,
    check_silence,
)
from uros.tools.doctor.snapshots import Agents


def free_port():
    """A port that is free by UDP and by TCP, and so is the next one."""
    for _ in range(100):
        with socket.socket() as sock:
            sock.bind(("127.0.0.1", 0))
            port = sock.getsockname()[1]
        if all(
            doctor_process.taken_port(protocol, number) is None
            for protocol in ("udp", "tcp")
            for number in (port, port + 1)
        ):
            return port
    raise AssertionError("no port is free")


@contextmanager
def taking(kind, port, host="0.0.0.0"):
    """A process that has the port when the block begins."""
    code = (
        "import socket, sys; s = socket.socket("
        f"socket.{'AF_INET6' if ':' in host else 'AF_INET'}, socket.{kind});"
        f" s.bind(({host!r}, {port}));"
        + (" s.listen();" if kind == "SOCK_STREAM" else "")
        + " print(1, flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_free_port():
    (one,) = check_port(free_port())
    assert one.state == "ok"


def can_bind(kind, port):
    """Whether an agent could listen there: connections that have ended leave a TCP port free."""
    with socket.socket(socket.AF_INET, getattr(socket, kind)) as sock:
        if kind == "SOCK_STREAM":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True


def test_the_other_port_is_none_of_a_connection():
    """A connection's own port is listened to by nobody, and yet an agent cannot open it."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as connection:
        connection.bind(("127.0.0.1", 0))
        connection.connect(server.getsockname())
        number = connection.getsockname()[1]
        taken = doctor_process.Taken("tcp", number - 1, ())
        assert _free(taken) != number


@pytest.mark.parametrize("host", ["0.0.0.0", "127.0.0.1", "::1"])
@pytest.mark.parametrize("kind, protocol", [("SOCK_DGRAM", "udp"), ("SOCK_STREAM", "tcp")])
def test_a_taken_port(kind, protocol, host):
    port = free_port()
    with taking(kind, port, host) as process:
        (one,) = check_port(port)
        assert one.state == "problem"
        assert f"{protocol.upper()} port {port} is in use by" in one.what
        assert f"(pid {process.pid})" in one.what
        kill, other = one.fix.split("; or ")
        # The other port is free, and what frees this one does so. Another process may take the
        # other port in the moment between: then the doctor names a further one.
        for _ in range(10):
            number = int(other.split("--port ")[1].split(",")[0])
            assert f"uros agent {protocol}4 --port {number}" in other
            if can_bind(kind, number):
                break
            other = check_port(port)[0].fix.split("; or ")[1]
        else:
            pytest.fail(f"port {number} is not free")
        subprocess.run(shlex.split(kill), check=True)
        process.wait(10)
        assert check_port(port)[0].state == "ok"


def test_a_default_tcp_port_in_use_is_a_note():
    port = free_port()
    with taking("SOCK_STREAM", port):
        (one,) = check_port(port, asked=False)
        assert one.state == "note"


def test_a_connection_from_a_port_does_not_take_it():
    port = free_port()
    with socket.create_server(("127.0.0.1", 0)) as there, socket.socket() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(("127.0.0.1", port))
        sock.connect(there.getsockname())
        assert doctor_process.taken_port("tcp", port) is None


def test_a_port_of_a_uros_agent():
    port = free_port()
    with taking("SOCK_DGRAM", port) as process:
        (one,) = check_port(port, {process.pid})
        assert one.state == "ok" and "a uros agent" in one.what
        assert f"kill {process.pid}" in one.fix


def test_a_port_that_an_agent_of_this_command_line_has():
    """Without its socket: by what it is called."""
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "--port", str(port), "-m", "memory"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        for line in process.stdout:
            if "running" in line:
                break
        (one,) = check_port(port)
        assert one.state == "ok" and f"(pid {process.pid})" in one.what
    finally:
        process.terminate()
        process.communicate()


def test_a_port_of_eprosimas_agent(monkeypatch):
    agent = doctor_process.Process(4711, "MicroXRCEAgent", ("/usr/bin/MicroXRCEAgent", "udp4"))
    monkeypatch.setattr(
        doctor_process,
        "taken_port",
        lambda protocol, port: (
            doctor_process.Taken(protocol, port, (agent,)) if port == 8888 else None
        ),
    )
    one = check_port(8888)[0]
    assert one.state == "problem" and "eProsima's agent" in one.what
    assert one.fix.startswith("kill 4711; or use another port: uros agent udp4 --port 8889")


def test_a_port_of_another_user(monkeypatch):
    monkeypatch.setattr(doctor_process, "_holders", lambda wanted, own=False: [])
    port = free_port()
    with taking("SOCK_DGRAM", port):
        (one,) = check_port(port)
    assert one.state == "problem" and "another user" in one.what
    assert f"sudo ss -lpn 'sport = :{port}'" in one.fix


# --- snapshots ----------------------------------------------------------------------------------


def board(key, address, *nodes, **more):
    return {
        "key": key,
        "address": address,
        "nodes": [{"name": name, "domain": domain} for name, domain in nodes],
        **more,
    }


def snapshot(*clients, pid=7, refused=(), **more):
    return {"version": 1, "pid": pid, "middleware": "auto", "clients": list(clients),
            "refused": list(refused), **more}  # fmt: skip


A = board("0x0000000A", "10.0.0.5:2018", ("/left", 0))
B = board("0x0000000B", "10.0.0.6:2018", ("/right", 5))


def test_which_agents_run():
    one = check_agents([])
    assert one.state == "note" and one.fix == "uros agent udp4 --port 8888"
    one = check_agents([snapshot()])
    assert one.state == "note" and "no board is connected" in one.what
    one = check_agents([snapshot(A, B), snapshot(pid=8)])
    assert one.state == "ok" and "pid 7 with 2 boards, pid 8 with 0 boards" in one.what
    assert one.fix == "to check one of them alone: uros doctor --agent PID"
    assert check_agents([snapshot(A)]).fix == ""
    one = check_agents([snapshot(A, config="/etc/uros/hall.toml")])
    assert one.what == "uros agents: pid 7 (/etc/uros/hall.toml) with 1 board"


def test_keys_that_are_all_different():
    (one,) = check_keys([[snapshot(A, B)], [snapshot(A, B)]])
    assert one.state == "ok"
    assert check_keys([]) == check_keys([[]]) == check_keys([[snapshot()]]) == []


def test_a_key_that_is_refused_because_it_is_in_use():
    refused = {"key": A["key"], "why": "client key in use", "address": "10.0.0.9:2018", "times": 4,
               "ago": 0.5}  # fmt: skip
    (one,) = check_keys([[snapshot(A, refused=[refused])]])
    assert one.state == "problem" and "0x0000000A" in one.what
    assert "10.0.0.5:2018" in one.what and "10.0.0.9:2018" in one.what
    assert "rmw_uros_options_set_client_key" in one.fix and "key=KEY" in one.fix
    assert check_refused([snapshot(A, refused=[refused])]) == []


def test_two_boards_with_alternating_takeovers():
    other = dict(A, address="10.0.0.9:2018")
    (one,) = check_keys([[snapshot(A)], [snapshot(other)], [snapshot(A)]])
    assert one.state == "problem"
    assert "10.0.0.5:2018 and 10.0.0.9:2018" in one.what and "key" in one.fix


def test_one_key_on_two_agents():
    """Each agent has clients of its own."""
    far = dict(A, address="10.0.0.9:2018")
    (one,) = check_keys([[snapshot(A), snapshot(far, pid=8)]] * 2)
    assert one.state == "ok" and "of an agent" in one.what
    (one,) = check_keys([[snapshot(A, far), snapshot(A, pid=8)]])
    assert one.state == "problem" and one.what.count("(agent 7)") == 2
    assert "(agent 8)" not in one.what


def test_a_board_that_has_moved_once_is_a_note():
    (one,) = check_keys([[snapshot(A)], [snapshot(dict(A, address="10.0.0.5:3000"))]])
    assert one.state == "note" and "changed its address" in one.what


def test_other_refusals():
    refused = {"key": "0x000000FF", "why": "client key not allowed", "address": "10.0.0.9:1",
               "times": 2, "ago": 0.5}  # fmt: skip
    (one,) = check_refused([snapshot(refused=[refused])])
    assert one.state == "problem" and "client key not allowed" in one.what
    assert "keys of [admission] (--allow-key)" in one.fix
    assert check_refused([snapshot(refused=[dict(refused, ago=301.0)])]) == []


def test_tls_that_was_refused():
    refusal = {"kind": "connection", "rule": "tls", "times": 4, "address": "10.0.0.9:1",
               "why": "its certificate has expired: give the board a new one"}  # fmt: skip
    (one,) = check_others_refused([snapshot(A, refusals=[refusal])])
    assert (one.check, one.state, one.what, one.fix) == (
        "tls",
        "note",
        "agent 7: TLS refused 4 connections, the latest from 10.0.0.9:1: its certificate has"
        " expired",
        "give the board a new one",
    )
    # It is no stranger's if no board gets through, and past if none was refused for long.
    (one,) = check_others_refused([snapshot(refusals=[dict(refusal, ago=2.0)])])
    assert one.state == "problem" and "the latest 2.0 s ago from 10.0.0.9:1" in one.what
    (one,) = check_others_refused([snapshot(refusals=[dict(refusal, why="closed", ago=2.0)])])
    assert one.state == "problem" and one.fix
    (one,) = check_others_refused([snapshot(refusals=[dict(refusal, ago=301.0)])])
    assert (one.state, one.fix) == ("ok", "") and "none lately: the latest 5 min ago" in one.what
    # An agent of an earlier version has no reasons, and one without refusals no list.
    del refusal["why"], refusal["address"]
    assert check_others_refused([snapshot(A, refusals=[refusal]), snapshot(A)]) == []


def test_peers_outside_of_the_networks_are_a_finding_with_the_remedy():
    refusal = {"kind": "connection", "rule": "allow_net", "times": 135, "address": "127.0.0.1:4",
               "why": "address not allowed", "ago": 3.0}  # fmt: skip
    alone = snapshot(refusals=[refusal])
    (one,) = check_others_refused([alone])
    assert (one.check, one.state) == ("refused", "problem")
    assert one.what == (
        "agent 7: the rule networks of [admission] (--allow-net) refused 135 messages or"
        " connections, the latest 3.0 s ago from 127.0.0.1:4: address not allowed"
    )
    assert one.fix.startswith("add its network to networks of [admission] (--allow-net)")
    assert check_agents([alone]).fix == "the board may be among what is refused, see below"
    assert "baud rate" in check_agents([snapshot(refusals=[dict(refusal, ago=301.0)])]).fix
    (one,) = check_others_refused([snapshot(A, refusals=[refusal])])
    assert one.state == "note"


def test_requests_that_were_refused_are_a_note():
    refusal = {"kind": "request", "rule": "denied", "times": 1, "address": "10.0.0.5:2018",
               "why": "0x001(5): the name is forbidden", "ago": 3.0}  # fmt: skip
    (one,) = check_others_refused([snapshot(refusals=[refusal])])
    assert one.state == "note" and one.what.endswith(
        "the agent refused 1 request of boards (denied), the latest 3.0 s ago from 10.0.0.5:2018:"
        " 0x001(5): the name is forbidden"
    )
    assert "baud rate" in check_agents([snapshot(refusals=[refusal])]).fix


def test_an_agents_own_problems():
    texts = ["sessions are not kept in /run/s: no space", "nothing is captured into /run/c: full"]
    found = check_problems([snapshot(A, problems=texts), snapshot(pid=8, problems=[])])
    assert [one.state for one in found] == ["problem", "problem"]
    assert found[0].what == f"the agent 7 has a problem: {texts[0]}"
    assert found[0].fix.endswith("uros agent status --agent 7")


def test_boards_that_are_silent_are_a_note():
    silent = dict(A, heard_ago=60.0, heard_since_restart=True)
    restored = dict(B, heard_ago=180.0, heard_since_restart=False)
    first, second = check_silence([snapshot(silent, restored, dict(A, heard_ago=59.0))])
    assert (first.state, first.what) == (
        "note", "the board 0x0000000A at 10.0.0.5:2018 has sent nothing to the agent 7 for 60 s"
    )  # fmt: skip
    assert second.what.endswith("nothing to the agent 7 since the agent's restart 3 min ago")


def test_an_agent_with_the_memory_middleware():
    (one,) = check_middleware([snapshot(A, middleware="memory")])
    assert one.state == "problem" and "-m memory" in one.fix
    assert check_middleware([snapshot(A), snapshot(middleware="memory")]) == []


@pytest.mark.parametrize("offset, word", [(0.3, "ahead of"), (-7200.0, "behind")])
def test_a_boards_clock_that_is_off(offset, word):
    (one,) = check_clocks([snapshot(dict(A, clock_offset=offset))])
    assert one.state == "note" and "/left" in one.what and word in one.what
    assert "rmw_uros_sync_session" in one.fix


@pytest.mark.parametrize("offset", [None, 0.02, -0.1, -1.7e9])
def test_clocks_without_a_finding(offset):
    assert check_clocks([snapshot(dict(A, clock_offset=offset))]) == []


def line(**counters):
    return {"name": "SerialAgent", "label": "/dev/ttyACM0", "messages": 0, "bytes": 0,
            "crc_errors": 0, "foreign": 0, "skipped": 0, "dropped": 0, **counters}  # fmt: skip


@pytest.mark.parametrize(
    "counters, state, words",
    [
        ({"frames": 100, "skipped": 5000}, "ok", "100 sound frames"),
        ({"frames": 0, "skipped": 5000}, "problem", "5000 bytes came over /dev/ttyACM0"),
        ({"frames": 100, "crc_errors": 30}, "problem", "30 of 130 frames"),
        ({"frames": 100, "crc_errors": 2}, "ok", "100 sound frames"),
    ],
)
def test_a_line_that_an_agent_serves(counters, state, words):
    (one,) = check_lines([snapshot(transports=[line(**counters)])])
    assert one.state == state and words in one.what
    if "bytes came" in words:
        assert one.fix == "kill 7, then: uros doctor --dev /dev/ttyACM0"


def test_many_healthy_lines_are_one_finding():
    (one,) = check_lines([snapshot(transports=[line(frames=n) for n in range(1, 21)])])
    assert one.state == "ok" and "over 20 lines" in one.what


def test_lines_without_a_finding():
    udp = {"name": "UDPv4Agent", "label": "port 8888", "messages": 5, "bytes": 99}
    assert check_lines([snapshot(transports=[udp, line(frames=0, skipped=3)])]) == []


# --- asking them --------------------------------------------------------------------------------


def test_agents_are_queried_in_turn():
    told = {"a": snapshot(A, pid=7), "b": snapshot(B, pid=8)}
    agents = Agents(find=lambda: list(told), ask=told.__getitem__)
    agents.look()
    assert agents.pids == {7, 8} and not agents.failed
    assert agents.nodes() == [("/left", 0), ("/right", 5)]
    agents.look()
    assert len(agents.looks) == 2
    only = Agents(8, find=lambda: list(told), ask=told.__getitem__)
    only.look()
    assert only.pids == {8}
    told["b"]["config"] = "/etc/uros/hall.toml"
    only = Agents("hall", find=lambda: list(told), ask=told.__getitem__)
    only.look()
    assert only.pids == {8} and not only.failed


def test_agents_that_do_not_answer():
    def ask(which):
        raise TimeoutError("timed out")

    agents = Agents(find=lambda: ["/run/agent-7.sock"], ask=ask)
    agents.look()
    (one,) = agents.failed
    assert one.state == "unknown" and "/run/agent-7.sock" in one.what and agents.now == []


def test_a_missing_agent():
    agents = Agents(os.getpid(), find=lambda: [], ask=lambda which: {})
    agents.look()
    (one,) = agents.failed
    assert one.state == "unknown" and str(os.getpid()) in one.what and one.fix


def test_boards_of_a_memory_agent_are_in_no_domain():
    agents = Agents(find=lambda: [1], ask=lambda which: snapshot(A, middleware="memory"))
    agents.look()
    assert agents.nodes() == []
