"""The agent as a process: how it starts, what it refuses, how it ends."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from support.client import XrceClient
from support.lines import SECONDS, SerialLine, TcpLine, UdpLine
from support.signals import default_signals, ignored_hangup
from unit.agent.helpers import REFS, get_info, message
from unit.agent.test_log import LINE

from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


def command(*args):
    return [sys.executable, "-m", "uros", "agent", *map(str, args)]


def refused(*args, **env):
    """Return (exit status, standard error) of an agent that does not start."""
    done = subprocess.run(
        command(*args), env={**os.environ, **env}, capture_output=True, text=True,
        timeout=SECONDS * 3,
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, done.stderr


class Process:
    """An agent process on the memory middleware, and its output."""

    def __init__(self, *args, signals=default_signals):
        with signals():
            self.popen = subprocess.Popen(
                command(*args), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
            )
        self.text = ""

    def read(self, seconds=SECONDS):
        """Read more output; return False at its end."""
        fd = self.popen.stdout.fileno()
        assert select.select([fd], [], [], seconds)[0], f"it says no more than:\n{self.text}"
        chunk = os.read(fd, 65536)
        self.text += chunk.decode()
        return bool(chunk)

    def until(self, pattern):
        """Wait until the log matches; return the match."""
        deadline = time.monotonic() + 3 * SECONDS
        while not (match := re.search(pattern, self.text)):
            assert time.monotonic() < deadline
            assert self.read(3 * SECONDS), f"it ended, no {pattern!r} in:\n{self.text}"
        return match

    def end(self, number=signal.SIGTERM):
        """Send a signal; return the exit status."""
        self.popen.send_signal(number)
        while self.read():
            pass
        return self.popen.wait(SECONDS)

    def lines(self):
        return [LINE.fullmatch(line.rstrip()) or line for line in self.text.splitlines()]


@contextmanager
def agent(*args, **more):
    process = Process(*args, **more)
    try:
        yield process
    finally:
        if process.popen.poll() is None:
            process.popen.kill()
            process.popen.wait()
        process.popen.stdout.close()


TRANSPORTS = {
    "udp4": (UdpLine, "127.0.0.1", socket.SOCK_DGRAM, socket.AF_INET),
    "udp6": (UdpLine, "::1", socket.SOCK_DGRAM, socket.AF_INET6),
    "tcp4": (TcpLine, "127.0.0.1", socket.SOCK_STREAM, socket.AF_INET),
    "tcp6": (TcpLine, "::1", socket.SOCK_STREAM, socket.AF_INET6),
}


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_second_agent_on_the_port_names_the_fault_and_exits(transport):
    with agent(transport, "-p", 0, "-m", "memory") as first:
        port = int(first.until(r"running\.\.\. +\| port: (\d+)")[1])
        status, output = refused(transport, "-p", port, "-m", "memory")
        assert status == 1
        protocol = transport[:3].upper()
        assert output == (
            f"uros: {protocol} port {port} is in use by another agent (pid {first.popen.pid}):"
            " stop it, or choose another port with --port\n"
        )
        make_line, address, *_ = TRANSPORTS[transport]
        line = make_line(port, address)
        assert XrceClient(line, 1).open() == ids.STATUS_OK
        line.close()
        assert first.end() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_signal_ends_the_agent_cleanly_and_frees_the_port(transport, number):
    make_line, address, kind, family = TRANSPORTS[transport]
    with agent(transport, "-p", 0, "-m", "memory") as process:
        port = int(process.until(r"port: (\d+)")[1])
        line = make_line(port, address)
        client = XrceClient(line, 0x1234)
        assert client.open() == ids.STATUS_OK
        client.writer("node", "rt/a", TYPE)
        assert process.end(number) == 0
        line.close()
        events = [log_line[5].strip() for log_line in process.lines()]
        assert events[-3:] == ["delete", "session closed", "server stopped"]
    with socket.socket(family, kind) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((address, port))


def test_a_hangup_that_nohup_ignores_ends_nothing():
    with agent("udp4", "-p", 0, "-m", "memory", signals=ignored_hangup) as process:
        port = int(process.until(r"port: (\d+)")[1])
        process.popen.send_signal(signal.SIGHUP)
        line = UdpLine(port)
        assert XrceClient(line, 1).open() == ids.STATUS_OK
        line.close()
        assert process.end() == 0


def test_an_agent_whose_disk_is_full_serves_boards():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
    arguments = ("udp4", "-p", port, "-m", "memory", "--capture", "/dev/full")
    with open("/dev/full", "wb") as full, default_signals():
        process = subprocess.Popen(command(*arguments), stdout=full)
    try:
        wait_for_port(port)
        line = UdpLine(port)
        client = XrceClient(line, 1)
        assert client.open() == ids.STATUS_OK
        writer = client.writer("node", "rt/a", TYPE)
        for _ in range(20):
            client.write(writer, b"\1\0\0\0a")
        assert client.ping() == 1
        done = subprocess.run(
            command("status", "--check", "--agent", process.pid), capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert "nothing is captured into /dev/full: No space left on device" in done.stdout
        assert "lines of the log are lost: No space left on device" in done.stdout
        line.close()
        process.terminate()
        assert process.wait(SECONDS * 3) == 0
    finally:
        process.kill()
        process.wait()


def test_one_agent_serves_several_transports_with_common_options(tmp_path):
    (tmp_path / "rules.toml").write_text("[[client]]\nkey = 1\nremap = { a = 'b' }\n")
    with agent(
        "udp4", "-p", 0, "-m", "memory", "tcp4", "-p", 0, "--domain", 5, "pseudoterminal",
        "-v", 4, "--control", tmp_path / "rules.toml",
    ) as process:  # fmt: skip
        udp = int(process.until(r"UDPv4Agent +\| init .*port: (\d+)")[1])
        tcp = int(process.until(r"TCPv4Agent +\| init .*port: (\d+)")[1])
        device = process.until(r"dev: (\S+)")[1]
        lines = [UdpLine(udp), TcpLine(tcp), SerialLine.open(device)]
        clients = [XrceClient(line, key) for key, line in enumerate(lines, 1)]
        for client in clients:
            assert client.open() == ids.STATUS_OK
        readers = [reading_client.reader("node", "rt/a", TYPE) for reading_client in clients[1:]]
        renamed = clients[0].reader("node", "rt/a", TYPE)  # rt/b, by a rule
        for client, reader in zip(clients, [renamed, *readers], strict=True):
            client.read(reader)
        clients[1].write(clients[1].writer("node", "rt/a", TYPE), b"\1\0\0\0a")
        assert clients[2].sample(readers[1]) == b"\1\0\0\0a"
        assert clients[1].sample(readers[0]) == b"\1\0\0\0a"
        clients[2].write(clients[2].writer("node", "rt/b", TYPE), b"\1\0\0\0b")
        assert clients[0].sample(renamed) == b"\1\0\0\0b"
        process.until(r"(?s)(domain_id: 5.*){4}")  # overridden, and three participants
        assert process.end() == 0
        for line in lines:
            line.close()


def test_a_signal_ends_an_agent_that_waits_for_a_device(tmp_path):
    with agent("serial", "-D", tmp_path / "none", "-m", "memory") as process:
        process.until("waiting for device")
        assert process.end() == 0


def test_a_signal_ends_an_agent_on_dds():
    with agent("udp4", "-p", 0) as process:
        port = int(process.until(r"port: (\d+)")[1])
        line = UdpLine(port)
        client = XrceClient(line, 0x1234)
        assert client.open() == ids.STATUS_OK
        reader = client.reader("node", "rt/a", TYPE)
        client.read(reader)
        assert process.end(signal.SIGINT) == 0
        line.close()


def test_a_pseudo_terminal_logs_its_name():
    with agent("pseudoterminal", "-m", "memory") as process:
        line = SerialLine.open(process.until(r"dev: (/\S+)")[1])
        assert XrceClient(line, 1).open() == ids.STATUS_OK
        line.close()
        assert process.end() == 0


def test_a_pseudo_terminal_keeps_its_name_when_a_program_closes_it():
    with agent("pseudoterminal", "-m", "memory") as process:
        device = process.until(r"dev: (/\S+)")[1]
        for key in (1, 2):
            line = SerialLine.open(device)
            assert XrceClient(line, key).open() == ids.STATUS_OK
            line.close()
        assert process.end() == 0
        assert process.text.count("dev: /") == 1


# --- the command line ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "status", "message"),
    [
        (["serial", "-D", "/dev/none", "-b", "0"], 1,
         "uros: baud rate 0 does not exist: 1 to "),
        (["pseudoterminal", "-b", "0"], 1, "baud rate 0 does not exist"),
        (["serial"], 2, "one of the arguments -D/--dev -f/--file is required"),
        (["serial", "-D", "a", "-f", "b"], 2, "not allowed with argument"),
        (["udp5"], 2, "udp4"),
        ([], 2, "name a transport (udp4, "),
        (["udp4", "-p", "eighty"], 2, "'eighty' is not a port (0 to 65535)"),
        (["udp4", "-p", "65536"], 2, "'65536' is not a port (0 to 65535)"),
        (["udp4", "-v", "7"], 2, "'7' is not a verbosity (0 to 6)"),
        (["udp4", "--domain", "233"], 2, "'233' is not a domain; give 0 to 232"),
        (["udp4", "-m", "corba"], 2, "corba"),
        (["udp4", "--prot", "1"], 2, "unrecognized arguments: --prot"),
        (["udp4", "-r", "/nowhere/agent.refs"], 1,
         "uros: /nowhere/agent.refs: No such file"),
    ],
)  # fmt: skip
def test_invalid_options_are_refused(args, status, message):
    result = refused(*args)
    assert result[0] == status
    assert message in result[1]


def test_a_wrong_environment_is_named():
    status, output = refused("udp4", "-p", 0, "-m", "memory", XRCE_DOMAIN_ID_OVERRIDE="many")
    assert status == 2
    assert "XRCE_DOMAIN_ID_OVERRIDE: 'many' is not a domain; give 0 to 232" in output


def test_a_privileged_port_says_what_to_do(monkeypatch):
    from uros.agent.transports.ip import bind_trouble

    error = PermissionError(13, "Permission denied")
    assert bind_trouble("UDP", 80, error) == (
        "UDP port 80 is not permitted: choose one from 1024 on with --port"
    )


def test_a_broken_reference_file_is_named(tmp_path):
    file = tmp_path / "agent.refs"
    file.write_text("<profiles><topic profile_name='a'></profiles>")
    status, output = refused("udp4", "-p", 0, "-m", "memory", "-r", file)
    assert status == 1 and f"uros: {file}: broken XML: mismatched tag" in output


def test_boards_refer_to_a_file_of_profiles(tmp_path):
    file = tmp_path / "agent.refs"
    file.write_text(REFS)
    with agent("udp4", "-p", 0, "-m", "memory", "-r", file) as process:
        line = UdpLine(int(process.until(r"port: (\d+)")[1]))
        client = XrceClient(line, 1)
        client.open()
        node = client.create(1, 1, ids.BY_REFERENCE, "default_xrce_participant", 0)
        client.create(2, 1, ids.BY_REFERENCE, "shapetype_topic", node)
        line.close()
        assert process.end() == 0


def wait_for_port(port):
    """Wait until a ping is answered there."""
    ping = message([get_info()], 0, 0, ids.SESSION_NONE_WITHOUT_KEY)
    deadline = time.monotonic() + 3 * SECONDS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(0.05)
        while True:
            assert time.monotonic() < deadline, "no agent answers"
            try:
                sock.send(ping)
                sock.recv(1000)
                return
            except TimeoutError:
                pass
            except ConnectionRefusedError:
                select.select([], [], [], 0.02)


# --- what it says ------------------------------------------------------------------------------


@pytest.mark.parametrize("level", range(7))
def test_levels_and_columns(level):
    """A client connects, creates a topic, writes without a reader, deletes the topic and leaves."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second_socket:
        second_socket.bind(("127.0.0.1", 0))
        port = second_socket.getsockname()[1]
    with agent("udp4", "-p", port, "-m", "memory", "-v", level) as process:
        wait_for_port(port)  # level 0 logs nothing
        line = UdpLine(port)
        client = XrceClient(line, 0x4B0CBE99)
        assert client.open() == 0
        node = client.participant("ns/board")
        topic = client._topic(node, "rt/a", TYPE)
        client.write(0x0995, b"nobody")
        client.delete(topic)
        assert client.close() == 0
        line.close()
        assert process.end() == 0
        lines = process.lines()
    assert all(not isinstance(log_line, str) for log_line in lines), process.text
    names = {log_line[2].strip() for log_line in lines}
    expected = [set(), set(), set(), {"warning"}, {"warning", "info"}]
    expected += [{"warning", "info", "debug"}, {"warning", "info", "debug", "trace"}]
    assert names == expected[level]
    about = {
        (log_line[3].strip(), log_line[4].strip(), log_line[5].strip()): log_line[6]
        for log_line in lines
    }
    if level >= 4:
        key = "client_key: 0x4B0CBE99"
        assert about["Root", "create_client", "create"] == f"{key}, session_id: 0x81"
        created = about["ProxyClient", "create_participant", "participant created"]
        assert created == f"{key}, participant_id: 0x001(1), domain_id: 0, node: /ns/board"
        created = about["ProxyClient", "create_topic", "topic created"]
        assert created == f"{key}, topic_id: 0x001(2), participant_id: 0x001(1)"
        assert about["Root", "delete_client", "delete"] == key
        where = about["SessionManager", "establish_session", "session established"]
        assert re.fullmatch(key + r", address: 127\.0\.0\.1:\d+", where)
    traces = [
        log_line for log_line in lines if log_line[4].strip() in ("recv_message", "send_message")
    ]
    assert bool(traces) == (level >= 5)
    for log_line in traces:
        assert log_line[3].strip() == "UDPv4Agent"
        sent = log_line[4].strip() == "send_message"
        assert log_line[5].strip() == ("[** <<UDP>> **]" if sent else "[==>> UDP <<==]")
        match = re.fullmatch(
            r"client_key: 0x[0-9A-F]{8}, len: (\d+)(?:, data: ((?:[0-9A-F]{2} ?)+))?", log_line[6]
        )
        assert match
        assert bool(match[2]) == (level == 6)
        if match[2]:
            assert len(bytes.fromhex(match[2])) == int(match[1])
    if level == 6:
        assert "80 00 00 00 00 01 10 00 58 52 43 45 01 00 01 0F 4B 0C BE 99 81 00" in process.text
