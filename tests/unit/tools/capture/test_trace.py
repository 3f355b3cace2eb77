"""``uros trace``: what it prints of captures, of files that grow, and of an agent that runs."""

import json
import os
import subprocess
import sys
import threading
import time

import pytest
from support.client import XrceClient
from support.lines import SECONDS, UdpLine
from support.replay import CAPTURES
from support.signals import default_signals
from unit.tools.capture.test_recordings import captured

from uros.agent.observability.jsonl import JsonLinesEncoder
from uros.agent.observability.pcapng import PcapngEncoder
from uros.tools import cli
from uros.tools.capture import trace
from uros.tools.capture.recordings import read


def run(capsys, *args):
    status = cli.main(["trace", *map(str, args)])
    out = capsys.readouterr()
    return status, out.out, out.err


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "it.pcapng"
    path.write_bytes(captured(PcapngEncoder))
    return path


def test_a_conversation(capsys):
    status, out, err = run(capsys, CAPTURES / "serial_publish.jsonl")
    lines = out.splitlines()
    assert (status, err) == (0, "")
    assert lines[0] == "-- client 0 0xAAAABBBB is at SERIAL client 0"
    assert lines[1].endswith(" 0 -> 0x80: CREATE_CLIENT key 0xAAAABBBB session 0x81 mtu 508 XRCE"
                             " 1.0 vendor 010F")  # fmt: skip
    assert lines[2].endswith(" 0 <- 0x81: STATUS_AGENT OK")
    assert lines[1].split()[0] == "0.000000"


def test_the_trace_on_the_page_is_printed(capsys):
    page = (CAPTURES.parents[1] / "docs" / "seeing.md").read_text("utf-8")
    block = page.partition("rclc_int32_publisher.jsonl`")[2].split("```")[1]
    shown = block.strip("\n").splitlines()
    out = run(capsys, CAPTURES / "rclc_int32_publisher.jsonl")[1].splitlines()
    assert shown == [line for line in out if line in shown] and len(shown) > 5


def test_times(capsys, file, monkeypatch):
    monkeypatch.setattr(trace.time, "localtime", time.gmtime)
    absolute = run(capsys, file, "--time", "absolute")[1].splitlines()[1]
    assert absolute.startswith("2025-11-21 18:33:20.123456   0 -> ")
    path = CAPTURES / "time_sync.jsonl"
    relative = [float(line.split()[0]) for line in run(capsys, path)[1].splitlines()[1:]]
    delta = run(capsys, path, "--time", "delta")[1].splitlines()[1:]
    deltas = [float(line.split()[0]) for line in delta]
    assert relative == sorted(relative) and relative[-1] > 5
    assert sum(deltas) == pytest.approx(relative[-1], abs=1e-4)
    assert run(capsys, path, "--time", "absolute")[1] == run(capsys, path)[1]  # it has none


def test_what_is_missing_is_shown(capsys, file):
    assert "-- 5 messages were not captured" in run(capsys, file)[1]


def test_one_client_by_its_number_or_key(capsys, file):
    path = CAPTURES / "service.jsonl"
    both, first = run(capsys, path)[1], run(capsys, path, "--client", 0)[1]
    assert run(capsys, path, "--client", "0x1")[1] == first
    second = run(capsys, path, "--client", "0X00000002")[1]
    assert sorted((first + second).splitlines()) == sorted(both.splitlines())
    status, out, err = run(capsys, path, "--client", 7)
    assert (status, out) == (0, "")
    assert err == f"{path} has no messages of client 7; there are 0 (0x00000001), 1 (0x00000002)\n"


@pytest.mark.parametrize("text", ["0xg", "-1", "x", "0x123456789", ""])
def test_unknown_clients(capsys, file, text):
    status, _, err = run(capsys, file, f"--client={text}")
    assert status == 2 and "is neither a key, such as 0x4B0CBE99, nor a number" in err


def test_bytes(capsys, file):
    out = run(capsys, file, "--hex")[1].splitlines()
    assert out[2] == (
        " " * 18 + "0000  81 00 00 00 02 01 08 00 00 32 FF FD 02 00 00 00  .........2......"
    )


def test_json(capsys, file):
    lines = [json.loads(line) for line in run(capsys, file, "--json")[1].splitlines()]
    assert lines[1] == {
        "t": 1763750000.123456, "from": "agent", "client": 1, "transport": "UDPv4Agent",
        "address": "192.0.2.7:2019", "key": "0x4B0CBE99", "session": "0x81", "stream": "none",
        "number": 0, "submessages": [{"kind": "GET_INFO", "text": "#50 agent activity"}],
        "lost": 5, "hex": "81000000020108000032fffd0200000000",
    }  # fmt: skip


def test_json_can_be_read_again(capsys, file, tmp_path):
    again = tmp_path / "again"
    again.write_text(run(capsys, file, "--json")[1])
    assert list(read(again)) == list(read(file))


def test_colours_are_for_terminals(capsys, file, monkeypatch):
    assert "\033" not in run(capsys, file)[1]
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert "\033[36m->\033[0m" in run(capsys, file)[1]
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\033" not in run(capsys, file)[1]


def test_text_of_a_capture_is_escaped(capsys, tmp_path):
    path = tmp_path / "it"
    line = {"t": 0, "from": "client", "transport": "\x1b[31mred", "address": "\n", "hex": "1b5b"}
    path.write_text(json.dumps(line) + "\n")
    out = run(capsys, path)[1]
    assert "\x1b" not in out and len(out.splitlines()) == 2


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["not/there"], "not/there cannot be read: No such file"),
        (["not/there", "--follow"], "not/there cannot be read: No such file"),
        ([__file__], "is not a capture: neither pcapng nor JSON lines"),
        (["--follow"], "--follow needs a FILE"),
        (["x", "--agent", "7"], "--agent traces a running agent"),
    ],
)
def test_errors_are_one_line(capsys, args, says):
    status, out, err = run(capsys, *args)
    assert (status, out) == (1, "")
    assert err.startswith("uros: ") and says in err and err.count("\n") == 1


def test_an_empty_file(capsys, tmp_path):
    path = tmp_path / "it"
    path.touch()
    assert run(capsys, path) == (0, "", f"{path} has no messages\n")


# --- files that grow ----------------------------------------------------------------------------


@pytest.mark.parametrize("form", [JsonLinesEncoder, PcapngEncoder])
def test_a_file_is_followed_as_it_grows_and_into_the_next(tmp_path, form):
    path = tmp_path / "it"
    whole = captured(form)
    path.write_bytes(whole[:50])
    steps = [
        lambda: path.write_bytes(whole),
        lambda: (os.replace(path, f"{path}.1"), path.write_bytes(captured(form, 2))),
        lambda: None,
    ]

    def pause():
        if not steps:
            raise KeyboardInterrupt
        steps.pop(0)()

    found = []
    with pytest.raises(KeyboardInterrupt):
        for record in trace.follow(str(path), pause):
            found.append(record)
    assert [record.message[16:] for record in found] == [b"", b"\0", b"\0\0", b"", b"\0"]


def test_a_truncated_file_is_followed(tmp_path):
    path = tmp_path / "it"
    path.write_bytes(captured(JsonLinesEncoder, 3))
    steps = [lambda: path.write_bytes(captured(JsonLinesEncoder, 1))]

    def pause():
        if not steps:
            raise KeyboardInterrupt
        steps.pop()()

    found = []
    with pytest.raises(KeyboardInterrupt):
        for record in trace.follow(str(path), pause):
            found.append(record)
    assert len(found) == 4


# --- an agent that runs --------------------------------------------------------------------------


def test_a_running_agent(tmp_path):
    """By its socket, in a process of its own, until Ctrl-C."""
    env = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    agent = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "-p", "0", "-m", "memory"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=env, bufsize=0,
    )  # fmt: skip
    tracer = None
    try:
        port = 0
        while b"status socket open" not in (line := agent.stdout.readline()):
            assert line, "the agent has ended"
            if b"port: " in line:
                port = int(line.rpartition(b"port: ")[2])
        with default_signals():
            tracer = subprocess.Popen(
                [sys.executable, "-m", "uros", "trace", "--agent", str(agent.pid)],
                env=env, bufsize=0, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
        line = UdpLine(port)
        client = XrceClient(line, 0xCAFE)
        client.open()
        stop = threading.Event()

        def talk():
            while not stop.wait(0.05):
                client.ping()

        talking = threading.Thread(target=talk)
        talking.start()
        try:
            first = tracer.stdout.readline().decode()
            second = tracer.stdout.readline().decode()
        finally:
            stop.set()
            talking.join(SECONDS)
        line.close()
        assert first.startswith("-- client 0 0x0000CAFE is at UDPv4Agent 127.0.0.1:")
        assert "0x81: GET_INFO #" in second or "0x81: INFO #" in second
        tracer.send_signal(2)
        assert tracer.wait(SECONDS) == 0
        assert tracer.stderr.read() == b""
    finally:
        for process in filter(None, (tracer, agent)):
            process.kill()
            process.wait(SECONDS)
            process.stdout.close()
        if tracer is not None:
            tracer.stderr.close()


def test_no_agent_runs(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("uros.agent.observability.status_socket.folders", lambda: [tmp_path])
    status, _, err = run(capsys)
    assert status == 1 and "no uros agent runs here" in err
