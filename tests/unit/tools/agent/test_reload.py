"""SIGHUP: new rules, admission and certificates without losing a board; a bad file changes nothing.

The agents are processes with real sockets.
"""

import fcntl
import json
import os
import re
import signal
import subprocess
import termios

import pytest
from support.certificates import Authority
from support.client import XrceClient
from support.lines import SECONDS, TlsLine, UdpLine
from support.signals import default_signals
from unit.agent.transports.test_process import TYPE, agent, command

from uros.wire import ids


def hang_up(process):
    process.popen.send_signal(signal.SIGHUP)


@pytest.fixture
def client():
    """Return a function that makes a client at a line of its own; it has no session yet."""
    lines = []

    def make(port, key):
        lines.append(UdpLine(port))
        return XrceClient(lines[-1], key)

    yield make
    for line in lines:
        line.close()


@pytest.fixture
def connected(client):
    """Return a function that makes a client with a session."""

    def make(port, key):
        made = client(port, key)
        assert made.open() == ids.STATUS_OK
        return made

    return make


def reloaded(process, said="rules reloaded"):
    """Reload; return what the log says of it."""
    process.text = ""
    hang_up(process)
    return process.until(rf"\| {said} +\| (.*)")[1]


def problems(process):
    """Return whether the agent is ready, and its problems."""
    status = subprocess.run(
        command("status", "--json", "--agent", process.popen.pid), stdout=subprocess.PIPE,
        check=True,
    )  # fmt: skip
    answer = json.loads(status.stdout)
    return answer["ready"], answer["problems"]


def relays(writer, reader, topic="rt/a"):
    """Return whether samples pass from one client to the other through new endpoints."""
    end = reader.reader("node", topic, TYPE)
    reader.read(end)
    writer.write(writer.writer("node", topic, TYPE), b"\1\0\0\0a")
    return reader.sample(end) == b"\1\0\0\0a"


def test_rules_of_a_file_are_reloaded_and_boards_stay(connected, tmp_path):
    rules = tmp_path / "rules.toml"
    rules.write_text("[[client]]\nkey = 9\nnamespace = '/x'\n")
    with agent("udp4", "-p", 0, "-m", "memory", "--control", rules) as process:
        port = int(process.until(r"UDPv4Agent +\| init .*port: (\d+)")[1])
        one, two = connected(port, 1), connected(port, 2)
        end = one.reader("node", "rt/a", TYPE)
        one.read(end)
        out = two.writer("node", "rt/a", TYPE)
        rules.write_text("[[client]]\nkey = 3\nremap = { '/b' = '/a' }\n[[client]]\nkey = 2\n"
                         "namespace = '/y'\n")  # fmt: skip
        about = reloaded(process)
        assert about == "clients: 2, new rules from their next session on: 0x00000002"
        two.write(out, b"\1\0\0\0a")  # its session, its topic and its names are as before
        assert one.sample(end) == b"\1\0\0\0a"
        three = connected(port, 3)
        three.write(three.writer("node", "rt/b", TYPE), b"\1\0\0\0b")
        assert one.sample(end) == b"\1\0\0\0b"
        assert process.end() == 0


def test_a_bad_new_file_is_named_and_the_old_rules_stay(client, connected, tmp_path):
    rules = tmp_path / "rules.toml"
    good = "[admission]\nkeys = [1, 2]\n"
    rules.write_text(good)
    with agent("udp4", "-p", 0, "-m", "memory", "--control", rules) as process:
        port = int(process.until(r"UDPv4Agent +\| init .*port: (\d+)")[1])
        one = connected(port, 1)
        for text, said in (
            ("[admission]\nkys = [3]\n", "did you mean 'keys'?"),
            ("[admission\n", "no TOML: "),
            ("[[client]]\nmax_rate = 0\nmax_size = 0\n", "; " + f"{rules}: "),
        ):
            rules.write_text(text)
            about = reloaded(process, "not reloaded")
            assert about.startswith(f"{rules}: ") and said in about
            assert about.endswith("(the former rules stay in use)")
        rules.unlink()
        assert reloaded(process, "not reloaded").startswith(f"{rules}: No such file")
        problem = "the last reload was refused, and a restart would fail: "
        assert problems(process) == (True, [f"{problem}{rules}: No such file or directory"])
        assert one.ping()
        connected(port, 2)
        assert client(port, 3).open() == ids.STATUS_ERR_DENIED
        rules.write_text(good)
        assert reloaded(process) == "clients: 2"
        assert problems(process) == (True, [])
        assert process.end() == 0


def test_a_board_that_is_no_longer_admitted_leaves_and_the_others_stay(client, connected, tmp_path):
    config = tmp_path / "agent.toml"
    text = '[agent]\nmiddleware = "memory"\n[[transport]]\ntype = "udp4"\nport = 0\n[admission]\n'
    config.write_text(text + "keys = [1, 2, 3]\n")
    with agent("--config", config) as process:
        port = int(process.until(r"UDPv4Agent +\| init .*port: (\d+)")[1])
        clients = [connected(port, key) for key in (1, 2)]
        config.write_text(text + "keys = [1]\n")
        assert reloaded(process) == "clients: 1, no longer admitted: 0x00000002"
        assert relays(clients[0], clients[0])
        assert client(port, 2).open() == ids.STATUS_ERR_DENIED
        config.write_text(text + "networks = ['10.0.0.0/8']\n")
        assert reloaded(process) == "clients: 0, no longer admitted: 0x00000001"
        clients[0].line.send(b"\x81\0\0\0\x0b\1\0\0")
        process.until(r"address not allowed +\| address: 127")  # it gets no answer
        config.write_text(text + "max_clients = 20\n")
        assert reloaded(process) == "clients: 0"
        connected(port, 7)
        assert process.end() == 0


def test_what_needs_a_restart_is_named_and_the_rest_is_used(tmp_path):
    config = tmp_path / "agent.toml"
    text = '[[transport]]\ntype = "udp4"\nport = 0\n[agent]\nmiddleware = "memory"\n'
    config.write_text(text)
    with agent("--config", config) as process:
        process.until(r"UDPv4Agent +\| init .*port: (\d+)")
        config.write_text(
            text.replace("port = 0", "port = 7") + 'verbose = 5\nstate = "a"\n'
            "[limits]\nmax_memory = 16\n[rules]\nnamespace = '/x'\n"
        )
        about = reloaded(process, "restart needed")
        assert about == ("changed, and used from the next start on: max_memory, state, transports")
        assert reloaded(process, "restart needed") == about  # it still is
        config.write_text(text.replace("port = 0", "port = 7"))
        about = reloaded(process, "restart needed")
        assert about == "changed, and used from the next start on: transports"
        config.write_text(text)  # as at the start
        process.text = ""
        for times in (1, 2):
            hang_up(process)
            process.until(rf"(?s)(rules reloaded.*){{{times}}}")
        assert "restart needed" not in process.text
        config.write_text("[agent]\nverbos = 3\n")
        about = reloaded(process, "not reloaded")
        assert about.startswith(f"{config}:2: [agent] has no 'verbos'; did you mean 'verbose'?")
        assert process.end() == 0


def test_an_option_of_the_command_line_wins_after_a_reload_too(client, connected, tmp_path):
    config = tmp_path / "agent.toml"
    config.write_text("[admission]\nkeys = [1]\n")
    with agent("--config", config, "udp4", "-p", 0, "-m", "memory", "--allow-key", 5) as process:
        port = int(process.until(r"UDPv4Agent +\| init .*port: (\d+)")[1])
        config.write_text("[admission]\nkeys = [2]\n")
        reloaded(process)
        connected(port, 5)
        assert client(port, 2).open() == ids.STATUS_ERR_DENIED
        assert process.end() == 0


def test_certificates_are_rotated_and_a_bad_one_is_named(client, tmp_path):
    old, new = Authority(tmp_path / "old"), Authority(tmp_path / "new")
    cert, key = old.agent()
    crl = old.revoke()
    with agent(
        "tcp4", "-p", 0, "-m", "memory", "--tls-cert", cert, "--tls-key", key, "--tls-ca", old.ca,
        "--tls-crl", crl,
    ) as process:  # fmt: skip
        port = int(process.until(r"TLSv4Agent +\| init .*port: (\d+)")[1])
        lines = [TlsLine(port, old.client(name)) for name in ("stays", "lost")]
        clients = [XrceClient(line, number) for number, line in enumerate(lines, 1)]
        for client in clients:
            assert client.open() == ids.STATUS_OK
        for path, content in zip((cert, key), new.agent(), strict=True):
            os.replace(content, path)
        old.revoke(tmp_path / "old" / "lost.pem", path=crl)
        hang_up(process)
        process.until("certificates loaded")
        process.until("its certificate is revoked by --tls-crl")
        process.until(r"session closed +\| client_key: 0x00000002")
        assert clients[0].ping()
        trust_new = old.client("other", trust=new.ca)
        line = TlsLine(port, trust_new)
        assert XrceClient(line, 3).open() == ids.STATUS_OK
        with open(cert, "w") as file:
            file.write("a slip of the editor")
        hang_up(process)
        about = process.until(r"cannot use new files +\| (.*)")[1]
        assert about.startswith(f"--tls-cert {cert} holds no valid certificate in PEM form")
        assert clients[0].ping()
        assert process.end() == 0
        for each in (*lines, line):
            each.close()


# --- terminals -----------------------------------------------------------------------------------


def test_an_agent_whose_terminal_is_closed_ends_and_a_signal_before_reloads(tmp_path):
    master, slave = os.openpty()

    def take_terminal():
        fcntl.ioctl(slave, termios.TIOCSCTTY, 0)

    with default_signals():
        process = subprocess.Popen(
            command("udp4", "-p", 0, "-m", "memory"), stdin=slave, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, start_new_session=True, preexec_fn=take_terminal,
        )  # fmt: skip
    try:
        os.close(slave)
        lines = iter(process.stdout)
        assert any(b"running..." in line for line in lines)
        process.send_signal(signal.SIGHUP)
        assert any(re.search(rb"rules reloaded", line) for line in lines)
        os.close(master)
        assert any(b"server stopped" in line for line in lines)
        assert process.wait(SECONDS) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_file_whose_transports_the_command_line_replaces_needs_no_restart(tmp_path):
    config = tmp_path / "agent.toml"
    text = '[[transport]]\ntype = "udp4"\nport = 0\n'
    config.write_text(text)
    with agent("udp4", "-p", 0, "-m", "memory", "--config", config) as process:
        said = process.until(r"transports of the file not served +\| (.*)")[1]
        assert said == f"{config}: 1; the command line has its own"
        process.until(r"UDPv4Agent +\| init .*port: (\d+)")
        more = text.replace("port = 0", "port = 7") + text + "[limits]\nmax_memory = 16\n"
        config.write_text(more)
        about = reloaded(process, "restart needed")
        assert about == "changed, and used from the next start on: max_memory"
        assert f"{config}: 2; the command line" in process.text
        assert process.end() == 0
