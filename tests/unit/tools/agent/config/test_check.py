"""``uros agent check``: what a configuration contradicts, what it lacks, and how it is printed."""

import datetime
import os
import pty
import re
import socket
import subprocess
import sys

import pytest
from support.certificates import Authority
from unit.agent.transports.test_process import agent as process
from unit.agent.transports.test_process import refused

from uros.agent.persistence.journal import open_journal
from uros.tools import cli
from uros.tools.agent import running_agents
from uros.tools.agent.config import running
from uros.tools.agent.running_agents import RunningAgent

UDP = '[[transport]]\ntype = "udp4"\nport = 0\n'
NOW = datetime.datetime.now(datetime.timezone.utc)


@pytest.fixture
def check(tmp_path, capsys):
    """Return the exit status and the lines of ``uros agent check``, without the path."""

    def run(text, *options):
        path = tmp_path / "agent.toml"
        path.write_text(text)
        status = cli.main(["agent", "check", str(path), *options])
        printed = capsys.readouterr()
        assert printed.err == ""
        return status, printed.out.replace(f"{path}:", "").splitlines()

    return run


def test_a_good_file(check):
    text = UDP + "[[client]]\nkey = 1\ndomain = 3\n"
    assert check(text) == (0, [" good, 1 transport, 1 rule for single boards"])


def test_a_file_that_cannot_be_read(tmp_path, capsys):
    assert cli.main(["agent", "check", str(tmp_path / "none")]) == 1
    assert capsys.readouterr().err == f"uros: {tmp_path}/none: No such file or directory\n"


def test_mistakes_are_printed_in_the_order_of_lines(check):
    status, lines = check("[limits]\nmax_objects = 0\n[agent]\nverbos = 1\n" + UDP)
    assert status == 1 and [line.partition(":")[0] for line in lines] == ["2", "4"]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('[[transport]]\ntype = "udp4"\n[[transport]]\ntype = "udp4"\n',
         "3: udp4 ([[transport]] number 1) has port 8888 already: choose another"),
        ('[[transport]]\ntype = "tcp4"\nport = 9100\n[monitoring]\nmetrics = 9100\n',
         "5: tcp4 ([[transport]] number 1) has port 9100 already: choose another"),
        ('[[transport]]\ntype = "udp4"\nport = 7400\n[agent]\ndiscovery = true\n',
         "5: discovery: udp4 has port 7400 already: choose another"),
        ('[[transport]]\ntype = "serial"\ndev = "null"\n'
         '[[transport]]\ntype = "multiserial"\ndevs = ["x", "null"]\n',
         "4: [[transport]] number 1 has {folder}/null already"),
        ('[[transport]]\ntype = "serial"\ndev = "null"\nbaudrate = 0\n',
         "1: baud rate 0 does not exist: 1 to 50000000"),
        ('[[transport]]\ntype = "custom"\nspec = "none.py:Mine"\n', "1: "),
        ('[[transport]]\ntype = "tcp4"\ntls_cert = "none.pem"\n', "1: --tls-key is missing"),
        ('[[transport]]\ntype = "tcp4"\nport = 0\ntls_cert = "none.pem"\ntls_key = "none.key"\n',
         "4: --tls-cert {folder}/none.pem cannot be read"),
        (UDP + '[agent]\nstate = "none/a"\n', "5: {folder}/none/a: there is no folder"),
        (UDP + '[audit]\nfile = "none/a"\n', "5: {folder}/none/a: there is no folder"),
        (UDP + '[capture]\nfile = "none/a"\n', "5: {folder}/none/a: there is no folder"),
        (UDP + '[agent]\nstate = "a\\u0000b"\n', "5: "),
        (UDP + '[agent]\nstate = "a"\n[capture]\nfile = "a"\n', "7: state is "),
        (UDP + '[agent]\nrefs = "none"\n', "5: "),
        (UDP + '[rules]\ncontrol = "none"\n', "5: "),
        (UDP + '[rules]\nnamespace = "a b"\n', "5: [rules]: namespace: 'a b' is no ROS name"),
        (UDP + '[admission]\nkeys = ["zz"]\n', "5: [admission]: key is 'zz', not a whole number"),
        (UDP + "[admission]\nmax_clients = 5000\n", "5: max_clients is 5000, not a whole number"),
        (UDP + "[limits]\nmax_memory = 1\nmax_message = 2000000\n",
         "6: max_message is over max_memory, which has 1 MB"),
    ],
)  # fmt: skip
def test_contradictions_and_missing_files_are_errors(check, tmp_path, text, line):
    status, lines = check(text)
    line = line.format(folder=tmp_path)
    assert status == 1 and len([each for each in lines if "warning" not in each]) == 1
    assert any(each.startswith(line) for each in lines), lines


def test_all_faults_of_admission_are_printed_at_once(check):
    status, lines = check(
        UDP + '[admission]\nkeys = ["zz", 1, "4B0CBE99"]\nnetworks = ["10.0.0.0/33", "wlan0"]\n'
        "max_clients = 5000\ndead_time = -1\nmax_client = 3\n"
    )
    assert status == 1
    assert lines == [
        "5: [admission]: key is 'zz', not a whole number from 0 to 4294967295 or a text such as"
        ' "0x4B0CBE99"',
        "5: [admission]: key is '4B0CBE99'; did you mean \"0x4B0CBE99\"?",
        "6: [admission]: networks: '10.0.0.0/33' is no network, such as \"192.168.1.0/24\" or"
        ' "fd00::/8"',
        '6: [admission]: networks: \'wlan0\' is no network, such as "192.168.1.0/24" or "fd00::/8"',
        "7: max_clients is 5000, not a whole number from 1 to 4096",
        "8: dead_time: '-1' is not a number of seconds from 0 (never) to 86400",
        "9: [admission] has no 'max_client'; did you mean 'max_clients'?",
    ]


def test_all_faults_of_a_list_are_printed_at_once(check):
    status, lines = check(UDP + "[admission]\nnetworks = [1, true]\n")
    assert (status, lines) == (
        1,
        ["5: networks is 1, not a text", "5: networks is True, not a text"],
    )


RULES = """\
[[client]]
key = ["zz", 1, -1]
address = ["10.0.0.0/33", 7]
domain = 999
namespce = "/a"
max_rate = 0
[client.remap]
"/a" = "b c"
"/d" = 3
[client.qos."/odom"]
reliability = "relyable"
depth = 0
dept = 1
[[client]]
key = 1
"""
RULES_FAULTS = [
    (2, "number 1: key is 'zz', not a whole number from 0 to 4294967295 or a text such as"
        ' "0x4B0CBE99"'),
    (2, "number 1: key is -1, not a whole number from 0 to 4294967295 or a text such as"
        ' "0x4B0CBE99"'),
    (3, "number 1: address is '10.0.0.0/33', which is no network, such as 192.168.1.0/24"),
    (3, "number 1: address is 7, not a text"),
    (4, "number 1: domain is 999, not a whole number from 0 to 232"),
    (5, "number 1: a rule has no 'namespce'; did you mean 'namespace'?"),
    (6, "number 1: max_rate is 0, not a number of messages a second above 0"),
    (8, "number 1: remap: 'b c' is no ROS name: letters, digits and _ between slashes, no part"
        " beginning with a digit"),
    (9, "number 1: remap: 3 is no ROS name: letters, digits and _ between slashes, no part"
        " beginning with a digit"),
    (11, "number 1: qos.\"/odom\".reliability is 'relyable', not reliable or best_effort"),
    (12, 'number 1: qos."/odom".depth is 0, not a whole number from 1 to 1000000'),
    (13, "number 1: qos.\"/odom\" has no 'dept'; did you mean 'depth'?"),
    (14, "number 2: it does nothing; it may have domain, namespace, remap, qos, max_rate,"
         " max_size"),
]  # fmt: skip


def test_all_faults_of_rules_are_printed_at_once_with_their_lines(check):
    status, lines = check(UDP + RULES)
    assert status == 1
    assert lines == [f"{line + 3}: [[client]] {text}" for line, text in RULES_FAULTS]


def test_all_faults_of_a_file_of_rules_are_printed_at_once(check, tmp_path):
    (tmp_path / "rules.toml").write_text(RULES + '[admission]\nkeys = "a"\nnetworks = []\n')
    status, lines = check(UDP + '[rules]\ncontrol = "rules.toml"\nnamespace = "a b"\nremap = "c"\n')
    assert status == 1
    file = f"5: {tmp_path}/rules.toml: "
    texts = sorted(text for _, text in RULES_FAULTS)
    assert sorted(lines[: len(texts)]) == [f"{file}[[client]] {text}" for text in texts]
    assert lines[len(texts) :] == [
        f"{file}[admission]: networks is empty, which admits nobody: leave it out to admit all",
        f"{file}[admission]: key is 'a', not a whole number from 0 to 4294967295 or a text such as"
        ' "0x4B0CBE99"',
        "6: [rules]: namespace: 'a b' is no ROS name: letters, digits and _ between slashes, no"
        " part beginning with a digit",
        "7: [rules]: --remap 'c' is not OLD:=NEW",
    ]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[agent]\nverbose = 4\n", "1: warning: there is no [[transport]]"),
        (UDP + "[capture]\nsize = 5\n", "5: warning: size has no effect without file"),
        (UDP + "[monitoring]\ndiagnostics_node = 'a'\n",
         "5: warning: diagnostics_node has no effect without diagnostics"),
        ('[[transport]]\ntype = "pseudoterminal"\n[agent]\ndiscovery = true\n',
         "4: warning: discovery has no effect without a udp or tcp transport"),
        ('[[transport]]\ntype = "serial"\ndev = "/dev/none"\n',
         "1: warning: /dev/none is not there now: an agent waits for it"),
        (UDP + "[admission]\nkeys = [1]\n[[client]]\nkey = [1, 2]\ndomain = 1\n",
         "6: warning: a rule for key 0x00000002, which [admission] does not admit"),
    ],
)  # fmt: skip
def test_what_an_agent_starts_with_nevertheless_is_a_warning(check, text, line):
    status, lines = check(text)
    assert status == 0 and len(lines) == 2 and lines[0].startswith(line), lines
    assert lines[1].endswith(", 1 warning")
    assert check(text, "--strict") == (1, lines[:1])


def test_a_good_file_is_good_for_strict_too(check):
    assert check(UDP, "--strict") == (0, [" good, 1 transport, 0 rules for single boards"])


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"[agent]\nverbose = \n", "2: no TOML: Invalid value (at line 2, column 11)"),
        (b"[agent]\n\nstate = '\xff'\n", "3: no TOML: 'utf-8' codec can't decode byte 0xff"),
    ],
)
def test_a_syntax_error_is_printed_as_other_errors_are(tmp_path, capsys, raw, said):
    path = tmp_path / "agent.toml"
    path.write_bytes(raw)
    assert cli.main(["agent", "check", str(path)]) == 1
    printed = capsys.readouterr()
    assert printed.out.startswith(f"{path}:{said}") and printed.err == ""


@pytest.mark.parametrize(
    ("name", "kind"), [("udp4", socket.SOCK_DGRAM), ("tcp4", socket.SOCK_STREAM)]
)
def test_a_port_that_is_taken_is_a_warning(check, name, kind):
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("", 0))
        if kind == socket.SOCK_STREAM:
            sock.listen()
        port = sock.getsockname()[1]
        status, lines = check(f'[[transport]]\ntype = "{name}"\nport = {port}\n')
    assert status == 0
    assert re.fullmatch(
        rf"3: warning: {name} \(\[\[transport\]\] number 1\): {name[:3].upper()} port {port} is in"
        rf" use by .*\(pid {os.getpid()}\): stop it, or choose another port with --port",
        lines[0],
    )


def test_an_address_that_this_machine_does_not_have_is_an_error(check):
    pytest.importorskip("prometheus_client")
    status, lines = check(UDP + '[monitoring]\nmetrics = "192.0.2.1:9100"\n')
    assert (status, lines) == (
        1,
        ["5: TCP port 9100 cannot be opened: this machine has no address 192.0.2.1: choose one that"
         " it has, or 0.0.0.0 for all"],
    )  # fmt: skip
    status, lines = check(UDP + '[monitoring]\nmetrics = "no.invalid:9100"\n')
    assert status == 1 and lines[0].startswith("5: --metrics: there is no host no.invalid:")


@pytest.mark.parametrize("name", ["dds", "ros2"])
def test_a_middleware_without_its_library_is_an_error(check, monkeypatch, name):
    library = {"dds": "cyclonedds", "ros2": "rclpy"}[name]
    own = f"uros.middleware.{name}"
    for module in [each for each in sys.modules if each.startswith((library, own))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    status, lines = check(f'[agent]\nmiddleware = "{name}"\n' + UDP)
    assert status == 1 and len(lines) == 1
    assert re.match(rf"2: the {name} middleware needs {library}[^:]*: ", lines[0])


# --- the files that an agent writes ----------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[agent]\nstate = "."\n', "it is a directory: name a file in it"),
        ('[agent]\nstate = "other"\n', "it is no state file of uros and is not changed"),
        ('[audit]\nfile = "."\n', "it is a directory: name a file in it"),
        ('[audit]\nfile = "other"\n', "it is there already and no audit file"),
        ('[capture]\nfile = "."\n', "it is a directory: name a file in it"),
        ('[capture]\nfile = "other"\n', "other is there already and no capture"),
        ('[capture]\nfile = "new"\n', "new.1 is there already and no capture"),
        ('[agent]\nstate = "none/a"\n', "folder"),
        ('[audit]\nfile = "none/a"\n', "folder"),
        ('[capture]\nfile = "none/a"\n', "folder"),
    ],
)
def test_a_file_that_the_agent_refuses_is_an_error(check, tmp_path, text, said):
    for name in ("other", "new.1"):
        (tmp_path / name).write_text("of somebody else\n")
    text = UDP + "[monitoring]\ninspection = false\n" + text
    status, lines = check(text)
    assert status == 1 and len(lines) == 1
    assert re.match(r"7: .*" + said, lines[0]), lines
    assert sorted(os.listdir(tmp_path)) == ["agent.toml", "new.1", "other"]
    assert (tmp_path / "other").read_text() == "of somebody else\n"
    assert refused("--config", tmp_path / "agent.toml", "-m", "memory")[0] == 1


def test_files_of_an_agent_before_are_good(check, tmp_path):
    (tmp_path / "audit").write_text('{"time": ""}\n')
    (tmp_path / "capture").write_text('{"t": 1.0, "from": "client"}\n')
    journal = open_journal(str(tmp_path / "state"))
    journal.rewrite({}, [])
    journal.close(True)
    text = UDP + '[agent]\nstate = "state"\n[audit]\nfile = "audit"\n[capture]\nfile = "capture"\n'
    assert check(text, "--strict")[0] == 0
    open_journal(str(tmp_path / "state")).close(True)  # neither locked nor changed


def test_a_file_that_this_user_may_not_read_is_a_warning(check, tmp_path, monkeypatch):
    (tmp_path / "state").touch(0)
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may read everything
    status, lines = check(UDP + '[agent]\nstate = "state"\n')
    assert status == 0 and "may not read and write it" in lines[0]


# --- beside a running agent ------------------------------------------------------------------

needs_proc = pytest.mark.skipif(
    not os.path.exists("/proc"), reason="not on this platform: it has no /proc"
)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@pytest.fixture
def text_and_device(tmp_path):
    """A configuration with whatever an agent has open, and its device."""
    ours, theirs = pty.openpty()
    device = os.ttyname(theirs)
    yield (
        (
            f'[agent]\nmiddleware = "memory"\nstate = "state"\n'
            f'[[transport]]\ntype = "udp4"\nport = {free_port()}\n'
            f'[[transport]]\ntype = "tcp4"\nport = {free_port()}\n'
            f'[[transport]]\ntype = "serial"\ndev = "{device}"\n'
            '[audit]\nfile = "audit"\n[capture]\nfile = "capture"\n'
        ),
        device,
    )
    os.close(theirs)
    os.close(ours)


@needs_proc
@pytest.mark.parametrize("form", ["--config PATH", "--config=PATH", "relative"])
def test_what_an_agent_with_this_file_has_open_is_no_fault(
    check, tmp_path, monkeypatch, text_and_device, form
):
    text, _ = text_and_device
    check(text)  # which writes the file
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "agent.toml"
    words = {"--config PATH": ["--config", path], "--config=PATH": [f"--config={path}"],
             "relative": ["--config", "agent.toml"]}[form]  # fmt: skip
    with process(*words) as one:
        one.until(r"\| init .*dev: /dev/")
        assert check(text, "--strict")[0] == 0
        one.end()


@needs_proc
def test_what_another_agent_has_open_is_a_warning(check, tmp_path, text_and_device):
    text, device = text_and_device
    other = tmp_path / "other.toml"
    other.write_text(text)
    with process("--config", other) as one:
        one.until(r"\| init .*dev: /dev/")
        status, lines = check(text)
        pid = one.popen.pid
        one.end()
    assert status == 0
    texts = [line.partition(": warning: ")[2] for line in lines[:-1]]
    assert len(texts) == 6
    for name in ("state", "audit", "capture"):
        assert (
            f"{tmp_path}/{name} is in use by another agent (pid {pid}): give each agent a file of"
            " its own"
        ) in texts
    assert sum(f"is in use by another agent (pid {pid}): stop it" in each for each in texts) == 2
    assert sum(each.startswith(f"{device} is in use by ") for each in texts) == 1


def test_without_proc_the_agents_of_this_user_are_asked(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "can_look", lambda: False)
    path = tmp_path / "agent.toml"
    agents = {1: {}, 2: {"config": None}, 3: {"config": str(tmp_path / "a")}}
    monkeypatch.setattr(
        running_agents, "find_agents", lambda: [RunningAgent(pid, tmp_path) for pid in agents]
    )
    monkeypatch.setattr(running_agents, "ask", lambda agent, question: agents[agent.pid])
    assert not running.OwnAgents(str(path)).has(None)
    agents[4] = {"config": str(path)}
    assert running.OwnAgents(str(path)).has(None)


# --- devices ---------------------------------------------------------------------------------


def test_a_relative_device_starts_from_the_folder_of_the_file(check, tmp_path):
    text = '[[transport]]\ntype = "serial"\ndev = "board"\n'
    status, lines = check(text)
    assert status == 0
    assert lines[0] == f"1: warning: {tmp_path}/board is not there now: an agent waits for it"
    (tmp_path / "board").touch()
    assert check(text, "--strict")[0] == 0


def test_names_that_are_no_files_are_not_looked_for(check):
    text = '[[transport]]\ntype = "serial"\ndev = "socket://127.0.0.1:1"\n'
    assert check(text, "--strict")[0] == 0


# --- TLS -------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name != "posix", reason="modes of files are of POSIX")
@pytest.mark.parametrize(("mode", "status"), [(0o600, 0), (0o640, 0), (0o644, 1), (0o602, 1)])
def test_a_private_key_that_every_user_can_read_is_a_warning(check, tmp_path, mode, status):
    cert, key = Authority(tmp_path).agent()
    os.chmod(key, mode)
    text = f'[[transport]]\ntype = "tcp4"\nport = 0\ntls_cert = "{cert}"\ntls_key = "{key}"\n'
    assert check(text)[0] == 0
    found, lines = check(text, "--strict")
    assert found == status
    if status:
        assert lines[0].startswith(f"5: warning: --tls-key {key}: every user of this machine may")
        assert f": chmod 600 {key}" in lines[0]


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
def test_a_device_that_is_in_use_is_a_warning(check):
    ours, theirs = pty.openpty()
    device = os.ttyname(theirs)
    holder = subprocess.Popen([sys.executable, "-c", "input()"], stdin=theirs)
    os.close(theirs)
    try:
        status, lines = check(f'[[transport]]\ntype = "serial"\ndev = "{device}"\n')
    finally:
        holder.kill()
        holder.wait()
        os.close(ours)
    assert status == 0 and lines[1].endswith(", 1 warning")
    assert re.fullmatch(
        rf"1: warning: {device} is in use by python.* \(pid {holder.pid}\): an agent waits until it"
        " is free",
        lines[0],
    )


@pytest.mark.parametrize(
    ("begins", "ends", "said"),
    [
        (-20, -1, "--tls-cert {cert} expired on {day}: make a new one"),
        (-20, 5, "--tls-cert {cert} expires on {day}: make a new one before"),
        (5, 90, "is valid from {first} on: is this machine's clock right?"),
    ],
)
def test_a_certificate_that_has_ended_or_will_soon_is_a_warning(
    check, tmp_path, begins, ends, said
):
    authority = Authority(tmp_path)
    first, last = NOW + datetime.timedelta(begins), NOW + datetime.timedelta(ends)
    cert, key = authority.agent(not_before=first, not_after=last)
    status, lines = check(
        f'[[transport]]\ntype = "tcp4"\nport = 0\ntls_cert = "{cert}"\ntls_key = "{key}"\n'
        f'tls_ca = "{authority.ca}"\n'
    )
    said = said.format(cert=cert, day=f"{last:%Y-%m-%d}", first=f"{first:%Y-%m-%d}")
    assert status == 0 and lines[0].startswith("4: warning: ") and said in lines[0], lines
