"""--audit: each refusal has its line, a flood has few, hostile names forge none."""

import errno
import json
import os
import re
import stat

import pytest
from support.agent import RunningAgent, running_agent, serving
from support.certificates import Authority
from support.client import XrceClient
from support.lines import UdpLine
from support.waiting import eventually
from unit.agent.transports.faults import wait_for
from unit.agent.transports.test_process import agent as process
from unit.agent.transports.test_process import refused
from unit.agent.transports.test_tls import connected

from uros.agent.log import MAX_LINES
from uros.agent.observability import audit as module
from uros.agent.observability.audit import LINE_BURST, AuditError, AuditTrail
from uros.agent.policy.admission import make_admission
from uros.agent.transports.tls import tls_server
from uros.printable import is_printable
from uros.wire import ids

HUGE = 10**9


@pytest.fixture
def audited(tmp_path):
    """Yield (agent, its audit trail, function that returns the lines)."""
    with running_agent("udp", "memory") as agent:
        trail = AuditTrail(str(tmp_path / "audit"), HUGE)
        agent.server.soon(lambda: trail.open(agent.server))
        eventually(lambda: agent.agent.refusals.listeners)
        yield agent, trail, lambda: lines_of(tmp_path / "audit")
        agent.server.soon(trail.close)
        eventually(lambda: not trail._thread.is_alive())


def lines_of(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def count(agent, *event, **more):
    """Count a refusal in the thread of the server."""
    agent.server.soon(lambda: agent.agent.refusals.count(*event, when=0.0, **more))


def open_status(agent, key):
    line = UdpLine(agent.transport.port)
    status = XrceClient(line, key).open()
    line.close()
    return status


# --- what is recorded -----------------------------------------------------------------------


def test_a_refused_board_has_a_line_with_address_rule_and_time(audited):
    agent, _, lines = audited
    agent.agent.admission = make_admission(keys=["1"])
    assert open_status(agent, 2) == ids.STATUS_ERR_DENIED
    eventually(lambda: lines())
    (line,) = lines()
    assert list(line) == ["time", "kind", "rule", "client_key", "address", "why", "times"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", line["time"])
    assert line["address"].startswith("127.0.0.1:")
    del line["time"], line["address"]
    assert line == {
        "kind": "board", "rule": "allow_key", "client_key": "0x00000002",
        "why": "client key not allowed", "times": 1,
    }  # fmt: skip


def test_refused_requests_and_places_have_lines_and_all_are_counted(audited):
    agent, _, lines = audited
    line = UdpLine(agent.transport.port)
    client = XrceClient(line, 1)
    assert client.open() == ids.STATUS_OK
    node = client.participant("node")
    with pytest.raises(AssertionError):
        client._topic(node, "rt/../x", "T")
    agent.agent.admission.max_clients = 1
    client.writer("node", "rt/a", "T")
    assert open_status(agent, 2) == ids.STATUS_ERR_RESOURCES
    line.close()
    eventually(lambda: len(lines()) == 2)
    assert [(each["kind"], each["rule"]) for each in lines()] == [
        ("request", "denied"), ("board", "max_clients")
    ]  # fmt: skip
    assert "rt/../x" in lines()[0]["why"] and lines()[0]["client_key"] == "0x00000001"
    counted = agent.snapshot()["refusals"]
    assert [(each["kind"], each["rule"], each["times"]) for each in counted] == [
        ("request", "denied", 1), ("board", "max_clients", 1)
    ]  # fmt: skip
    latest = [(each["address"], each["why"]) for each in counted]
    assert latest == [(each["address"], each["why"]) for each in lines()]


def test_a_peer_outside_of_the_networks_has_a_line(audited):
    agent, _, lines = audited
    agent.agent.admission = make_admission(networks=["10.0.0.0/8"])
    line = UdpLine(agent.transport.port)
    line.send(b"\x81\0\0\0\x0b\1\0\0")
    eventually(lambda: lines())
    line.close()
    assert (lines()[0]["kind"], lines()[0]["rule"]) == ("connection", "allow_net")


def test_a_refused_certificate_has_a_line(tmp_path):
    authority = Authority(tmp_path)
    lost = authority.issue("lost")
    crl = authority.revoke(lost[0])
    server = tls_server(0, "127.0.0.1", *authority.agent(), authority.ca, crl)
    running = RunningAgent(server, "memory", 0, 4)
    trail = AuditTrail(str(tmp_path / "audit"), HUGE)
    running.server.attachments.append(trail)
    with serving(running) as agent:
        context = authority.client()
        context.load_cert_chain(*lost)
        with pytest.raises(OSError):
            with connected(agent.transport.port, context) as sock:
                sock.sendall(b"x")
                if not sock.recv(1):
                    raise ConnectionResetError
        wait_for(agent.said.getvalue, "revoked")
        eventually(lambda: lines_of(tmp_path / "audit"))
    (line,) = lines_of(tmp_path / "audit")
    assert (line["kind"], line["rule"]) == ("connection", "tls")
    assert line["why"].startswith("its certificate is revoked by --tls-crl")


@pytest.mark.parametrize("name", ["\n{}", '", "rule": "x', "\x1b[2J", "\ud800\u202e", "x" * 5000])
def test_hostile_names_stay_in_their_line(audited, name):
    agent, _, lines = audited
    count(agent, "request", "denied", f"/dev/{name}", name, key=3)
    eventually(lambda: lines())
    (line,) = lines()
    assert line["rule"] == "denied" and is_printable(line["why"] + line["address"])
    assert len(json.dumps(line)) < 4000


# --- floods and disks --------------------------------------------------------------------------


def test_a_flood_of_refusals_writes_few_lines_and_each_is_counted(audited, monkeypatch):
    agent, trail, lines = audited
    monkeypatch.setattr(trail, "_lines", module.RateLimit(10.0, LINE_BURST, lambda: 100.0))

    def flood():
        for number in range(5000):
            agent.agent.refusals.count("board", "allow_key", "1.2.3.4:5", "no", 0.0, number + 1)
        for number in range(5000):
            host = f"1.2.{number // 250}.{number % 250}"
            agent.agent.refusals.count("board", "allow_net", f"{host}:5", "no", 0.0)

    agent.server.soon(flood)
    eventually(lambda: agent.agent.refusals.counts["board", "allow_net"] == 5000)
    eventually(lambda: len(lines()) >= MAX_LINES - 1)
    assert len(lines()) <= MAX_LINES + 1
    assert len([line for line in lines() if line["rule"] == "allow_key"]) == LINE_BURST
    assert agent.agent.refusals.counts["board", "allow_key"] == 5000


def test_suppressed_refusals_are_counted_by_the_next_line(audited, monkeypatch):
    agent, trail, lines = audited
    now = [100.0]
    monkeypatch.setattr(trail, "_lines", module.RateLimit(10.0, LINE_BURST, lambda: now[0]))
    for _ in range(LINE_BURST + 6):
        count(agent, "board", "allow_key", "1.2.3.4:5", "no")
    agent.server.soon(lambda: now.__setitem__(0, 111.0))
    count(agent, "board", "allow_key", "1.2.3.4:9", "no")
    eventually(lambda: len(lines()) == LINE_BURST + 1)
    assert [line["times"] for line in lines()] == [*[1] * LINE_BURST, 7]


def write_twenty(path, limit):
    """Let an agent record twenty refusals."""
    with running_agent("udp", "memory") as agent:
        trail = AuditTrail(str(path), limit)
        agent.server.soon(lambda: trail.open(agent.server))
        for number in range(20):
            count(agent, "board", f"rule {number}", "1.2.3.4:5", "no")
        agent.server.soon(trail.close)
        eventually(lambda: trail._thread.ident and not trail._thread.is_alive())


def test_two_files_of_limited_size_are_kept_and_an_existing_one_is_continued(tmp_path):
    path = tmp_path / "audit"
    for _ in range(2):
        write_twenty(path, 2000)
        assert path.stat().st_size <= 2000
        assert 1000 < (tmp_path / "audit.1").stat().st_size <= 2000
    rules = [line["rule"] for name in ("audit.1", "audit") for line in lines_of(tmp_path / name)]
    assert rules[-10:] == [f"rule {number}" for number in range(10, 20)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert sorted(os.listdir(tmp_path)) == ["audit", "audit.1"]


def test_a_full_disk_is_logged_once_and_lines_come_again_when_there_is_room(audited, monkeypatch):
    agent, trail, lines = audited
    real, full = os.write, [True]

    def write(file, data):
        if file == trail._file and full[0]:
            if len(data) > 40:
                return real(file, data[:40])  # a part of the line
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(file, data)

    monkeypatch.setattr(module.os, "write", write)
    for number in range(3):
        count(agent, "board", f"rule {number}", "1.2.3.4:5", "no")
    wait_for(agent.said.getvalue, "refusals not recorded")
    eventually(lambda: trail._lost == 3)
    assert "No space left" in trail.trouble()
    assert open_status(agent, 9) == ids.STATUS_OK
    full[0] = False
    count(agent, "board", "rule 4", "1.2.3.4:5", "no")
    wait_for(agent.said.getvalue, "audit goes on")
    assert agent.said.getvalue().count("refusals not recorded") == 1
    assert "lines lost: 3" in agent.said.getvalue() and trail.trouble() == ""
    assert [line["rule"] for line in lines()] == ["rule 4"]


# --- the options -------------------------------------------------------------------------------


def test_an_agent_with_the_option_and_files_that_are_refused(tmp_path):
    path = tmp_path / "audit"
    arguments = ("udp4", "-p", 0, "-m", "memory", "--allow-key", 1, "--audit")
    with process(*arguments, path, "--audit-size", 1) as one:
        port = int(one.until(r"port: (\d+)")[1])
        line = UdpLine(port)
        assert XrceClient(line, 2).open() == ids.STATUS_ERR_DENIED
        line.close()
        assert one.end() == 0
    assert [each["rule"] for each in lines_of(path)] == ["allow_key"]
    note = tmp_path / "note.txt"
    note.write_text("shopping list")
    status, said = refused(*arguments, note)
    assert status == 1 and f"--audit {note}: it is there already and no audit file" in said
    assert note.read_text() == "shopping list"
    status, said = refused(*arguments, tmp_path / "none" / "audit")
    assert status == 1 and "No such file or directory: name a file in a folder" in said


def test_a_second_agent_is_refused_and_changes_nothing(tmp_path):
    path = tmp_path / "audit"
    arguments = ("udp4", "-p", 0, "-m", "memory", "--audit", path)
    with process(*arguments) as one:
        one.until(r"port: (\d+)")
        status, said = refused(*arguments)
        assert (status, said) == (
            1,
            f"uros: --audit {path}: another agent writes it: end that one, or name another file\n",
        )
        assert one.end() == 0
    with process(*arguments) as one:
        one.until(r"port: (\d+)")
        assert one.end() == 0


def test_a_second_agent_is_refused_also_after_the_file_was_renamed(tmp_path):
    path = tmp_path / "audit"
    trail = AuditTrail(str(path), 100)
    for number in range(3):
        trail._write(b'{"time": "%060d"}\n' % number)
    assert len(lines_of(path)) == 1 and len(lines_of(tmp_path / "audit.1")) == 1
    with pytest.raises(AuditError, match="another agent writes it: end that one"):
        AuditTrail(str(path), 100)
    os.close(trail._file)
    os.close(AuditTrail(str(path), 100)._file)
