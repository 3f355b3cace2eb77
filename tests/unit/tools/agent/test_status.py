"""``uros agent status``: the page, and what it says where there is nothing to show."""

import argparse
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.client import XrceClient
from support.lines import SECONDS, UdpLine
from unit.agent.transports.test_process import agent as process

from uros.agent.observability import status_socket
from uros.tools import cli
from uros.tools.agent import command, running_agents, status
from uros.tools.agent.status import duration, octets, page
from uros.tools.errors import ToolError
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


def client(key="0x4B0CBE99", received=100, sent=50, age=20.0, **more):
    return {
        "key": key, "session_id": "0x81", "transport": "UDPv4Agent",
        "address": "192.168.100.107:2018", "mtu": 512, "age": age, "heard_ago": 0.25,
        "nodes": [{"name": "/left/a_board_of_the_hall", "domain": 3}],
        "objects": {"participant": 1, "topic": 2},
        "received": {"messages": received, "bytes": 5000, "lost": 3, "given_up": 1, "rate": 10.0},
        "sent": {"messages": sent, "bytes": 100, "resent": 2, "dropped": 1, "rate": 5.0},
        "rate_over": 9.6,
        "queues": {"unacknowledged": 3, "stalled": 1, "early": 2, "fragments": 100},
        "endpoints": [
            {"object": "0x001(5)", "kind": "datawriter", "topic": "/sensors/room_temp",
             "type": "sensor_msgs/msg/Temperature", "samples": 12345}
        ],
        "clock_offset": -0.25, **more,
    }  # fmt: skip


def snapshot(**more):
    return {
        "version": 1, "pid": 4711, "uptime": 7500.0, "middleware": "auto", "rss": 61_000_000,
        "cpu": 12.3, "fds": 23, "limits": {},
        "transports": [
            {"name": "UDPv4Agent", "kind": "UDP", "label": "port 8888", "messages": 12345,
             "bytes": 1_200_000},
            {"name": "SerialAgent", "kind": "SERIAL", "label": "/dev/ttyACM0", "messages": 7,
             "bytes": 80, "frames": 7, "crc_errors": 3, "foreign": 0, "skipped": 120,
             "dropped": 0},
        ],
        "clients": [client()],
        "refused": [
            {"key": "0x00000007", "why": "client key in use", "address": "192.168.1.8:2018",
             "times": 12, "ago": 3.0}
        ], **more,
    }  # fmt: skip


def words(lines):
    """The words of wrapped lines."""
    return " ".join(" ".join(lines).split())


PAGE = """\
agent 4711, up 2 h 5 min, middleware auto, CPU 12 s, RSS 61.0 MB, 23 fds

TRANSPORT    WHERE         MESSAGES   BYTES
UDPv4Agent   port 8888       12,345  1.2 MB
SerialAgent  /dev/ttyACM0         7    80 B  3 CRC errors, 120 bytes between frames

BOARD       ADDRESS               NODES                        HEARD  IN/S  OUT/S  LOST  RESENT  WAITING
0x4B0CBE99  192.168.100.107:2018  /left/a_board_of_the_hall@3  0.2 s  10.0    5.0     4       2        6
  in/s, out/s: messages a second, over the last 9.6 s

REFUSED     ADDRESS           TIMES       LAST  WHY
0x00000007  192.168.1.8:2018     12  3.0 s ago  client key in use
  client key in use: another board answers with this key: give each its own (uros: key=, micro-ROS:
  rmw_uros_options_set_client_key), or switch that one off"""  # noqa: E501


def test_the_page():
    assert "\n".join(page(snapshot(), width=120)) == PAGE


def test_noise_on_a_line_is_told_where_there_is_no_board():
    udp, line = snapshot()["transports"]
    noise = dict(line, messages=0, frames=0, skipped=312)
    shown = page(snapshot(transports=[noise], clients=[], refused=[]), width=120)
    assert shown[-3:] == [
        "No boards. Their firmware must send at the baud rate of this agent.",
        "  /dev/ttyACM0 has bytes and no frame: another baud rate, or firmware without micro-ROS;"
        " stop this",
        "  agent, and 'uros doctor --dev /dev/ttyACM0' finds out",
    ]
    earlier = dict(noise, messages=7)  # of an agent of an earlier version
    del earlier["frames"]
    for quiet in (line, dict(noise, skipped=3), earlier):
        shown = page(snapshot(transports=[udp, quiet], clients=[], refused=[]), width=120)
        assert shown[-1] == "No boards. Their firmware must know this host's address and the port."


def test_connections_that_tls_refused_are_below_the_boards():
    refusal = {"kind": "connection", "rule": "tls", "times": 4, "address": "192.168.1.9:2018",
               "why": "its certificate has expired: give the board a new one"}  # fmt: skip
    shown = page(snapshot(clients=[], refused=[], refusals=[refusal]), width=120)
    assert (
        "\n".join(shown)
        .replace("\n  ", " ")
        .endswith(
            "\n\nTLS refused 4 connections, the latest from 192.168.1.9:2018: its certificate has"
            " expired: give the board a new one"
        )
    )
    hostile = dict(refusal, address="\x1b[2J", why="\n\x1b[31m")
    text = "".join(page(snapshot(refusals=[hostile])))
    assert text.isascii() and text.isprintable()
    # With its age; past once no board was refused for long, as after a new certificate.
    shown = words(page(snapshot(refusals=[dict(refusal, ago=3.0)])))
    assert " the latest 3.0 s ago from 192.168.1.9:2018: its certificate has expired: give" in shown
    shown = words(page(snapshot(refusals=[dict(refusal, ago=720.0)])))
    assert shown.endswith(
        " TLS refused 4 connections, but none lately: the latest 12 min ago from 192.168.1.9:2018:"
        " its certificate has expired"
    )
    # An agent of an earlier version has no reasons.
    earlier = {"kind": "connection", "rule": "tls", "times": 4}
    assert page(snapshot(refusals=[earlier])) == page(snapshot())


def test_boards_outside_of_the_networks_are_shown_with_the_rule_where_there_is_no_board():
    refusal = {"kind": "connection", "rule": "allow_net", "times": 135, "address": "127.0.0.1:4",
               "why": "address not allowed", "ago": 3.0}  # fmt: skip
    shown = words(page(snapshot(clients=[], refused=[], refusals=[refusal])))
    assert shown.endswith(
        "No boards. Some may be among what the agent refuses, see below."
        " The rule networks of [admission] (--allow-net) refused 135 messages or connections, the"
        " latest 3.0 s ago from 127.0.0.1:4: address not allowed: add its network to networks of"
        " [admission] (--allow-net), unless the board is not yours"
    )
    past = words(page(snapshot(clients=[], refused=[], refusals=[dict(refusal, ago=400.0)])))
    assert "Their firmware must know this host's address" in past and "none lately" in past


def test_refused_requests_and_connections_beyond_the_limit_are_shown():
    denied = {"kind": "request", "rule": "denied", "times": 2, "address": "10.0.0.5:2018",
              "why": "0x001(5): forbidden", "ago": 3.0}  # fmt: skip
    full = {"kind": "connection", "rule": "connections", "times": 1, "address": "10.0.0.6:9",
            "why": "over 64 connections from one address", "ago": 4.0}  # fmt: skip
    text = words(page(snapshot(refusals=[denied, full])))
    assert "The agent refused 2 requests of boards (denied), the latest 3.0 s ago from" in text
    assert "The limit of connections refused 1 connection, the latest 4.0 s ago from" in text


def test_a_restored_board_that_was_not_heard_since_the_restart():
    shown = page(snapshot(clients=[client(heard_since_restart=False)]), width=150)
    assert any("not since restart" in line for line in shown)


def test_the_endpoints_of_each_board():
    assert "\n".join(page(snapshot(), verbose=True, width=120)).endswith(
        """
0x4B0CBE99: session 0x81, UDPv4Agent, MTU 512, for 20 s; 1 participant, 2 topics
  messages: 3 sent and not acknowledged, 1 wait for the network, 2 came early
  bytes of fragments: 100
  dropped: 1
  its clock minus the agent's: -0.250 s
  ENDPOINT    TOPIC               TYPE                         SAMPLES
  datawriter  /sensors/room_temp  sensor_msgs/msg/Temperature   12,345"""
    )


def test_rates_are_between_two_snapshots():
    before = snapshot()
    after = snapshot(uptime=7502.0, cpu=12.5, clients=[client(received=120, sent=51, age=22.0)])
    text = "\n".join(page(after, before, width=120))
    assert "CPU 10.0 %" in text and "  10.0    0.5  " in text
    assert "messages a second, since the previous time" in text
    # A session that is another one has no look before.
    anew = snapshot(uptime=7502.0, clients=[client(received=3, age=1.0)])
    assert "  10.0    5.0  " in "\n".join(page(anew, before, width=120))


@pytest.mark.parametrize("width", [40, 80, 120, 200])
@pytest.mark.parametrize("verbose", [False, True])
def test_no_line_is_wider_than_the_terminal(width, verbose):
    for lines in (
        page(snapshot(), None, verbose, width),
        page(snapshot(clients=[client(f"0x{key:08X}") for key in range(9)]), None, verbose, width),
        page(snapshot(clients=[], refused=[]), None, verbose, width),
    ):
        assert max(map(len, lines)) <= width or width < 80


def test_on_a_narrow_terminal_the_nodes_stand_below():
    lines = page(snapshot(), width=80)
    at = next(number for number, line in enumerate(lines) if line.startswith("0x4B0CBE99"))
    assert lines[at + 1] == "  /left/a_board_of_the_hall@3"
    assert "192.168.100.107:2018" in lines[at]


@given(st.text(max_size=50))
def test_texts_of_boards_do_not_reach_the_terminal(text):
    evil = client(
        address=text, nodes=[{"name": text, "domain": 0}],
        endpoints=[{"object": "0x001(5)", "kind": "datawriter", "topic": text, "type": text,
                    "samples": 1}],
    )  # fmt: skip
    for line in page(snapshot(clients=[evil]), None, True, 120):
        assert line.isascii() and line.isprintable()


@pytest.mark.parametrize(
    "seconds, text",
    [(0, "0.0 s"), (9.99, "10.0 s"), (10, "10 s"), (119, "119 s"), (120, "2 min"),
     (7199, "119 min"), (7500, "2 h 5 min"), (172_800, "2 d 0 h"), (1e7, "115 d 17 h")],
)  # fmt: skip
def test_durations(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    "count, text",
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (999_949, "999.9 kB"), (999_960, "1.0 MB"),
     (12_345_678_901, "12.3 GB"), (5 * 10**15, "5000.0 TB")],
)  # fmt: skip
def test_bytes(count, text):
    assert octets(count) == text


@pytest.mark.parametrize(
    "why",
    ["client key in use", "client key not allowed", "address not allowed", "over 3 clients",
     "memory for clients used up", "MTU of 3 is under 32", "invalid cookie"],
)  # fmt: skip
def test_every_refusal_has_its_remedy(why):
    refused = [{"key": "0x01", "why": why, "address": "a", "times": 1, "ago": 0.0}]
    lines = page(snapshot(refused=refused), width=1000)
    (remedy,) = [line for line in lines if line.startswith(f"  {why}: ")]
    assert len(remedy) > len(why) + 20


# --- the command ---------------------------------------------------------------------------


def run(*arguments):
    done = subprocess.run(
        [sys.executable, "-m", "uros", "agent", "status", *map(str, arguments)],
        capture_output=True, text=True, timeout=3 * SECONDS,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return done


def parser():
    one = argparse.ArgumentParser()
    command.add_arguments(one)
    return one


def test_status_of_a_running_agent_and_of_one_of_two():
    with process("udp4", "-p", 0, "-m", "memory") as first:
        port = int(first.until(r"running\.\.\. +\| port: (\d+)")[1])
        first.until("status socket open")
        pid = first.popen.pid
        line = UdpLine(port)
        board = XrceClient(line, 0x1234)
        assert board.open() == ids.STATUS_OK
        board.writer("talker", "rt/numbers", TYPE)
        done = run("--agent", pid, "-v")
        assert done.returncode == 0
        for word in (f"agent {pid}, up", f"port {port}", "0x00001234", "/talker", "/numbers"):
            assert word in done.stdout
        with process("udp4", "-p", 0, "-m", "memory") as second:
            second.until("status socket open")
            done = run()
            assert done.returncode == 0 and "--agent PID" in done.stdout
            rows = {row[0]: row for line in done.stdout.splitlines() if (row := line.split())}
            assert rows[str(pid)][-3:] == ["UDPv4Agent", "port", str(port)]
            assert rows[str(pid)][-5:-3] == ["1", "0"] and str(second.popen.pid) in rows
            assert json.loads(run("--agent", second.popen.pid, "--json").stdout)["clients"] == []
            assert second.end() == 0
        done = run("--agent", 1)
        assert done.returncode == 1
        assert "there is no agent with pid 1, but " in done.stderr and str(pid) in done.stderr
        line.close()
        assert first.end() == 0


def test_an_agent_is_chosen_by_its_configuration_file(tmp_path):
    name = f"hall{os.getpid()}"
    file = tmp_path / f"{name}.toml"
    file.write_text('[[transport]]\ntype = "udp4"\nport = 0\n[agent]\nmiddleware = "memory"\n')
    with process("--config", file) as one:
        one.until("status socket open")
        done = run("--agent", name, "--json")
        answer = json.loads(done.stdout)
        assert (answer["pid"], answer["config"]) == (one.popen.pid, str(file))
        os.kill(one.popen.pid, signal.SIGSTOP)
        try:
            done = run("--agent", name)
        finally:
            os.kill(one.popen.pid, signal.SIGCONT)
        assert done.returncode == 1 and f"{one.popen.pid} has not answered" in done.stderr
        assert one.end() == 0


def test_watch_prints_the_state_repeatedly_until_the_agent_ends():
    with process("udp4", "-p", 0, "-m", "memory") as one:
        one.until("status socket open")
        watching = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", "status", "--watch", "0.05",
             "--agent", str(one.popen.pid)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            heads = 0
            while heads < 3:
                line = watching.stdout.readline()
                assert line
                heads += line.startswith("agent ")
            assert one.end() == 0
            _, said = watching.communicate(timeout=SECONDS)
            assert watching.returncode == 1 and "Traceback" not in said
            assert f"the agent with pid {one.popen.pid}" in said
        finally:
            watching.kill()
            watching.communicate()


def test_without_an_agent_the_error_has_the_remedy(monkeypatch):
    monkeypatch.setattr(status_socket, "folders", list)
    with pytest.raises(ToolError, match="no uros agent runs here .*: start one, such as"):
        command.run(parser().parse_args(["status"]))


SEVERAL = """\
AGENT  UP         MIDDLEWARE  BOARDS  DOMAINS  SERVES
4711   2 h 5 min  auto             1  3        UDPv4Agent port 8888
                                               SerialAgent /dev/ttyACM0
4712   12 s       memory           0  -        MultiSerialAgent A, B, C and 2 more
4713   2 h 5 min  auto             0  -        -

'uros agent status --agent PID' shows the boards of one agent, -v those of all."""


def agents_that_answer(monkeypatch, *answers):
    """The agents of this machine; an answer may be an error."""
    agents = [running_agents.RunningAgent(4711 + at, Path("x")) for at in range(len(answers))]

    def ask(agent, question):
        answer = answers[agent.pid - 4711]
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(running_agents, "find_agents", lambda: agents)
    monkeypatch.setattr(running_agents, "ask", ask)


def test_several_agents_are_listed_with_what_each_serves(monkeypatch, capsys):
    lines = [{"name": "MultiSerialAgent", "label": label} for label in "ABCDE"]
    agents_that_answer(
        monkeypatch,
        snapshot(),
        snapshot(pid=4712, uptime=12, middleware="memory", clients=[], transports=lines),
        snapshot(pid=4713, clients=[], transports=[]),
    )
    assert cli.main(["agent", "status"]) == 0
    assert capsys.readouterr().out.rstrip() == SEVERAL
    assert max(map(len, status.overview([snapshot()] * 2, 60))) <= 60
    # All pages, and all answers for programs.
    monkeypatch.setattr(running_agents, "ask", lambda agent, _: snapshot(pid=agent.pid))
    assert cli.main(["agent", "status", "-v"]) == 0
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if " up " in line][1].startswith("agent 4712, up")
    assert cli.main(["agent", "status", "--json"]) == 0
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [answer["pid"] for answer in answers] == [4711, 4712, 4713]


def test_the_configuration_file_of_an_agent_is_shown_and_selects_it(monkeypatch, capsys):
    hall = snapshot(config="/etc/uros/hall.toml")
    unheard = client(heard_since_restart=False)
    yard = snapshot(pid=4712, config="/etc/uros/yard.toml", clients=[client(), unheard])
    agents_that_answer(monkeypatch, hall, yard, snapshot(pid=4713))
    assert cli.main(["agent", "status"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[1] for row in rows if row[:1] in (["AGENT"], ["4711"], ["4713"])] == [
        "CONFIG", "/etc/uros/hall.toml", "-"
    ]  # fmt: skip
    for name in ("yard", "yard.toml", "/etc/uros/yard.toml", "/etc/uros/../uros/yard.toml"):
        assert cli.main(["agent", "status", "--agent", name]) == 0
        assert capsys.readouterr().out.startswith("agent 4712, /etc/uros/yard.toml, up ")
    assert cli.main(["agent", "status", "--agent", "yard", "--check"]) == 0
    assert capsys.readouterr().out == (
        "agent 4712 (/etc/uros/yard.toml): ready; boards: 2 (1 not heard since the restart)\n"
    )
    assert cli.main(["agent", "status", "--agent", "barn"]) == 1
    assert capsys.readouterr().err == (
        "uros: no agent runs here with the configuration file 'barn', but /etc/uros/hall.toml,"
        " /etc/uros/yard.toml\n"
    )
    agents_that_answer(monkeypatch, ToolError("busy"), hall)
    assert cli.main(["agent", "status", "--agent", "barn"]) == 1
    assert capsys.readouterr().err.endswith("but /etc/uros/hall.toml; busy\n")


def test_of_several_agents_one_does_not_answer(monkeypatch, capsys):
    agents_that_answer(monkeypatch, snapshot(), ToolError("busy"))
    assert cli.main(["agent", "status"]) == 1
    printed = capsys.readouterr()
    assert printed.out.startswith("agent 4711, up ") and printed.err == "WARNING: busy\n"
    agents_that_answer(monkeypatch, ToolError("busy"), ToolError("lost"))
    assert cli.main(["agent", "status"]) == 1
    assert capsys.readouterr().err == "uros: busy\n"


def test_a_command_for_one_agent_names_all_of_them(monkeypatch, capsys):
    agents_that_answer(monkeypatch, snapshot(), snapshot(pid=4712))
    assert cli.main(["trace"]) == 1
    assert capsys.readouterr().err == (
        "uros: 2 agents run here: give --agent PID of one (4711, 4712); 'uros agent status' shows"
        " what each serves\n"
    )


def test_no_inspection_leaves_no_socket():
    with process("udp4", "-p", 0, "-m", "memory", "--no-inspection") as one:
        one.until(r"running\.\.\.")
        path = status_socket.folders()[0] / f"agent-{one.popen.pid}.sock"
        assert one.end() == 0
        assert "status socket open" not in one.text and not path.exists()


def test_status_cannot_be_combined_with_transports():
    with pytest.raises(ToolError, match="status is not a transport"):
        command.run(parser().parse_args(["udp4", "-p", "0", "status"]))
    with pytest.raises(SystemExit):
        parser().parse_args(["status", "udp4"])
    assert parser().parse_args(["status", "--watch"]).watch == status._WATCH


@pytest.mark.parametrize(
    "text, address",
    [("9100", ("127.0.0.1", 9100)), ("0.0.0.0:0", ("0.0.0.0", 0)), ("[::1]:80", ("::1", 80)),
     ("::1:80", ("::1", 80)), ("host.lan:65535", ("host.lan", 65535))],
)  # fmt: skip
def test_addresses_for_metrics(text, address):
    args = parser().parse_args(["udp4", "--metrics", text])
    assert args.metrics == address


@pytest.mark.parametrize("text", ["", "x", "65536", ":80", "host:", "-1", "1e3", "9" * 5000])
def test_invalid_addresses_for_metrics(text, capsys):
    with pytest.raises(SystemExit):
        parser().parse_args(["udp4", f"--metrics={text}"])
    assert "is not an address, such as 9100" in capsys.readouterr().err


def test_the_help_of_the_agent_mentions_status(capsys):
    with pytest.raises(SystemExit):
        parser().parse_args(["--help"])
    assert "uros agent status" in capsys.readouterr().out
