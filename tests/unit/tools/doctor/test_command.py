"""`uros doctor` as a process, with a real agent, real boards and real nodes on loopback.

Faults are planted, the doctor names them, what it says is done, and they are gone.
"""

import json
import os
import re
import socket
import threading
import tty

import pytest
from conftest import leased_domain
from support.doctor import agent, board, listener, one_of, run_doctor, spare_port
from support.portable import framed
from support.waiting import eventually

import uros
from uros.agent.observability import status_socket
from uros.tools import cli
from uros.tools.doctor import command, process
from uros.tools.doctor.finding import NOTE, OK, PROBLEM, UNKNOWN, Finding
from uros.transport.udp import UdpTransport

BEST_EFFORT = {"reliability": "best_effort"}


@pytest.fixture
def place(tmp_path, monkeypatch, own_domain_id):
    """A domain and a port, and a folder of its own for agents' sockets.

    Other agents may run on this machine: the doctor is told which one to look at."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(status_socket, "folders", lambda: [tmp_path / "uros"])
    return own_domain_id, spare_port()


def test_a_healthy_system_has_no_problem(place):
    domain, port = place
    with agent(port) as which, board(port, domain), listener(domain):
        problems, found = run_doctor(which, domain, port)
    assert problems == []
    for check in ("agents", "port", "domain", "types", "qos", "clock", "client key"):
        assert one_of(found, check).state == OK, check


def test_qos_of_a_board_and_the_option_that_fixes_it(place):
    domain, port = place
    with listener(domain):
        with agent(port) as which, board(port, domain, BEST_EFFORT):
            (one,), _ = run_doctor(which, domain, port)
        assert one.check == "qos" and "/board publishes on /temp" in one.what
        option = re.fullmatch(r"start the agent with --qos (\S+)", one.fix)[1]
        assert option == "/temp:reliability=reliable"
        with agent(port, "--qos", option) as which, board(port, domain, BEST_EFFORT):
            problems, found = run_doctor(which, domain, port)
        assert problems == [] and one_of(found, "qos").state == OK


def test_a_board_in_another_domain_and_the_options_that_fix_it(place):
    domain, port = place
    with leased_domain() as other, listener(domain):
        with agent(port) as which, board(port, other):
            (one,), _ = run_doctor(which, domain, port)
            assert one.check == "domain"
            assert f"/board in domain {other} publishes /temp" in one.what
            assert f"/listener subscribes to it in domain {domain}" in one.what
            assert f"export ROS_DOMAIN_ID={other} before /listener starts" in one.fix
            number = re.search(r"start the agent with --domain (\d+)$", one.fix)[1]
            # The first way: the listener goes to where the board is.
            with listener(other):
                assert run_doctor(which, other, port)[0] == []
        # And the second one.
        with agent(port, "--domain", number) as which, board(port, other):
            assert run_doctor(which, domain, port)[0] == []


@pytest.mark.slow
def test_a_type_that_differs(place):
    domain, port = place
    from uros.interfaces.std_msgs.msg import Float32

    with agent(port) as which, board(port, domain), listener(domain, Float32):
        (one,), _ = run_doctor(which, domain, port)
        assert one.check == "types" and "sensor_msgs/msg/Temperature in /board" in one.what
        assert "std_msgs/msg/Float32 in /listener" in one.what
    new = re.search(r"--remap (\S+)\)", one.fix)[1]
    with agent(port, "--remap", new) as which, board(port, domain), listener(domain, Float32):
        assert run_doctor(which, domain, port)[0] == []


def test_a_boards_clock(place):
    domain, port = place
    with agent(port) as which:
        with board(port, domain, clock=-5.0):
            (one,), _ = run_doctor(which, domain, port)
            assert one.check == "clock" and "/temp by /board are 5" in one.what
            assert "behind" in one.what and "rmw_uros_sync_session" in one.fix
        with board(port, domain, clock=0.0):
            assert run_doctor(which, domain, port)[0] == []


def test_a_problem_of_the_agent_itself(place):
    domain, port = place
    with agent(port, "--max-clients", "1") as which, board(port, domain):
        (one,), _ = run_doctor(which, domain, port)
    assert one.check == "agent" and f"the agent {which.pid} has a problem" in one.what
    assert "--max-clients" in one.what


@pytest.mark.slow
def test_two_boards_with_one_key(place):
    domain, port = place
    with agent(port) as which, board(port, domain):
        stop = threading.Event()

        def intrude():
            node = uros.Node(
                "twin", UdpTransport("127.0.0.1", port), key=0x0D0C0001, domain_id=domain
            )
            while not stop.is_set():
                node.spin_once(0.02)
            node.destroy_node()

        twin = threading.Thread(target=intrude)
        twin.start()
        try:
            from uros.tools.agent.running_agents import ask, find_agent

            eventually(
                lambda: ask(find_agent(which.pid), "status")["refused"],
                "the agent refuses nobody", pause=0.05,
            )  # fmt: skip
            problems, _ = run_doctor(which, domain, port)
        finally:
            stop.set()
            twin.join()
    (one,) = problems
    assert one.check == "client key" and "0x0D0C0001" in one.what
    assert len(set(re.findall(r"127\.0\.0\.1:\d+", one.what))) == 2
    assert "rmw_uros_options_set_client_key" in one.fix


def test_another_key_fixes_it(place):
    domain, port = place
    with (
        agent(port) as which,
        board(port, domain),
        board(port, domain, key=0x0D0C0002, name="twin"),
    ):
        assert run_doctor(which, domain, port)[0] == []


@pytest.mark.slow
def test_a_port_and_a_device(place, tmp_path):
    domain, port = place
    with agent(port) as which, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
        missing = str(tmp_path / "ttyACM0")
        problems, _ = run_doctor(which, domain, port, "--dev", missing)
    checks = {problem.check: problem for problem in problems}
    assert set(checks) == {"port", "device"}
    assert f"(pid {os.getpid()})" in checks["port"].what and missing in checks["device"].what


@pytest.mark.slow
def test_discovery_switched_off_in_the_agents_environment(place, monkeypatch):
    """Its environment is looked at too."""
    domain, port = place
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    with agent(port) as which:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        (one,), _ = run_doctor(which, domain, port)
    assert one.check == "discovery" and f"the agent {which.pid}" in one.what
    assert one.fix == "unset ROS_AUTOMATIC_DISCOVERY_RANGE, and start it again"


@pytest.mark.parametrize(
    "said, state, words",
    [
        (framed(bytes([0x80, 0, 0, 0, 1]), 1), OK, "sound XRCE frames come over"),
        (b"I (31) boot: ESP-IDF v5.1 2nd stage bootloader\r\n", PROBLEM, "only text comes"),
        (bytes(range(128, 256)), PROBLEM, "nor at the usual rates"),
        (b"", PROBLEM, "nothing came"),
    ],
    ids=["frames", "text", "noise", "silence"],
)
def test_a_board_on_a_line(place, monkeypatch, capsys, said, state, words):
    master, slave = os.openpty()
    tty.setraw(slave)
    device = os.ttyname(slave)
    end = threading.Event()

    def send():
        while not end.wait(0.005):
            try:
                os.write(master, said)
            except BlockingIOError:
                pass  # nobody reads now

    os.set_blocking(master, False)
    thread = threading.Thread(target=send)
    os.close(slave)
    keep = os.open(device, os.O_RDWR | os.O_NOCTTY)
    monkeypatch.setattr(process, "holders_of_file", lambda path: [])
    thread.start()
    try:
        status = cli.main(
            ["doctor", "--json", "--dev", device, "--domain", str(place[0]), "--port",
             str(place[1]), "--seconds", "0.05"]
        )  # fmt: skip
    finally:
        end.set()
        thread.join()
        os.close(keep)
        os.close(master)
    one = one_of(
        [Finding(**finding) for finding in json.loads(capsys.readouterr().out)["findings"]], "baud"
    )
    assert one.state == state and words in one.what and device in one.what
    assert status == (state == PROBLEM)
    assert one.fix or state == OK


@pytest.mark.slow
def test_security_in_the_shell(place, monkeypatch):
    domain, port = place
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    with agent(port) as which:
        (one,), _ = run_doctor(which, domain, port)
    assert one.check == "security" and "unset ROS_SECURITY_ENABLE" in one.fix


def test_an_invalid_domain(place, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", "banana")
    assert cli.main(["doctor", "--json", "--seconds", "0.1", "--port", str(place[1])]) == 1
    found = json.loads(capsys.readouterr().out)["findings"]
    (one,) = [finding for finding in found if finding["state"] == PROBLEM]
    assert "banana" in one["what"] and one["fix"] == "export ROS_DOMAIN_ID=0"


# --- what it looks like -------------------------------------------------------------------------


def test_lines_are_whole_and_commands_are_not_broken():
    fix = "uros agent serial --dev /dev/serial/by-id/usb-" + "x" * 90 + " --baudrate 921600"
    text = command.lines(Finding("baud", PROBLEM, "the board sends " + "slowly " * 20, fix))
    assert text.splitlines()[0].startswith("problem  baud           the board sends")
    assert text.splitlines()[-1] == " " * 9 + "fix:           " + fix
    assert all(len(line) <= 100 for line in text.splitlines()[:-1])
    assert command.lines(Finding("port", OK, "free")) == "ok       port           free"
    assert "hint:" in command.lines(Finding("port", NOTE, "taken", "kill 5"))


def test_a_fix_is_broken_between_its_parts_and_not_within_a_command():
    fix = "kill 4711; or use another port: uros agent udp4 --port 8889, and set it in the boards"
    text = command.lines(Finding("port", PROBLEM, "port 8888 is in use", fix), 72)
    first, *rest = text.splitlines()[1:]
    assert first == " " * 9 + "fix:           kill 4711; or use another port:"
    indent = " " * 24
    assert rest == [indent + "uros agent udp4 --port 8889,", indent + "and set it in the boards"]
    assert " ".join([first.split(maxsplit=1)[1], *map(str.strip, rest)]) == fix


def test_a_terminal_gets_lines_that_fit_and_the_state_in_colour(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("NO_COLOR", raising=False)
    finding = Finding("baud", PROBLEM, "the board sends " + "slowly " * 20, "x")
    command.print_finding(finding)
    piped = capsys.readouterr().out
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    command.print_finding(finding)
    shown = capsys.readouterr().out
    monkeypatch.setenv("NO_COLOR", "1")
    command.print_finding(finding)
    plain = capsys.readouterr().out
    assert "\033" not in piped and max(map(len, piped.splitlines())) > 80
    assert shown.startswith("\033[1;31mproblem\033[0m  baud ")
    assert "\033" not in plain and max(map(len, plain.splitlines())) <= 80
    assert re.sub(r"\033\[[0-9;]*m", "", shown) == plain


def test_text_from_outside_is_escaped():
    text = command.lines(Finding("qos", PROBLEM, "/a\x1b[2J\n/b", "--qos '/a\x1b[2J'"))
    assert "\x1b" not in text and len(text.splitlines()) == 2 and "\\x1b[2J" in text


def test_many_alike_are_printed_as_one_and_counted_each():
    told = []
    doctor = command.Doctor(None, None, told.append)
    each = [Finding("clock", NOTE, f"/b{number} is late", "", f"/b{number}") for number in range(9)]
    doctor._found([*each, *each])
    doctor._found(each[:5])
    assert [finding.what for finding in told] == [
        "9 alike: /b0 is late; also /b1, /b2, /b3 and 5 more (--json has each)"
    ]
    assert doctor.findings == each
    assert command._summary(doctor.findings) == "\n0 problems, 9 notes"


def test_the_summary():
    found = [Finding("a", PROBLEM, "x", "y"), Finding("b", NOTE, "x"), Finding("c", UNKNOWN, "x")]
    assert command._summary(found) == "\n1 problem, 1 note, 1 check could not be made"
    assert command._summary([]) == "\n0 problems"


def test_findings_are_printed_at_once(place, capsys):
    domain, port = place
    status = cli.main(["doctor", "--domain", str(domain), "--port", str(port), "--seconds", "0.1"])
    said = capsys.readouterr()
    assert status == 0 and "0 problems" in said.out.splitlines()[-1]
    assert f"... looking at domain {domain}" in said.err


@pytest.mark.parametrize(
    "options, words",
    [
        (["--baudrate", "fast"], "not a baud rate"),
        (["--baudrate", "9" * 5000], "not a baud rate"),
        (["--port", "0"], "not a port"),
        (["--port", "9" * 5000], "not a port"),
        (["--domain", "233"], "not a domain"),
        (["--seconds", "0"], "not a number above 0"),
        (["--agent", "0"], "not an integer"),
        (["--agent", ""], "neither a pid nor a configuration file"),
    ],
)
def test_invalid_options(options, words, capsys):
    assert cli.main(["doctor", *options]) == 2
    assert words in capsys.readouterr().err
