"""uros demo: the virtual board, the agent as a process, and what comes by DDS."""

import io
import os
import re
import select
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from support.signals import default_signals
from support.variants import slow_except

from uros.tools import cli, demo
from uros.tools.errors import ToolError


def run(domain, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "uros", "demo", "--domain", str(domain), *arguments],
        capture_output=True, text=True, timeout=50, env=dict(os.environ, COLUMNS="200"),
    )  # fmt: skip


def row(done, topic):
    """The topic's row of the summary: count, rate, delay, value and type."""
    (line,) = re.findall(rf"{topic} .*", done.stdout.split("Summary:")[1])
    return re.split(r" {2,}", line)[1:]


def test_every_topic_is_received_until_the_time_is_over(own_domain_id):
    done = run(own_domain_id, "--seconds", "6")
    assert done.returncode == 0, done.stdout + done.stderr
    for what in ("Waiting for its topics", "Messages received over", "Every topic was received."):
        assert what in done.stdout
    # What matters comes first: no log of an agent that has nothing to warn of.
    first = done.stdout.partition("Messages received over DDS")[0].split("\n")
    assert [line.split()[0] for line in first if line] == ["A", "Its", "Waiting"], first
    assert "device lost" not in done.stdout + done.stderr  # the end is no loss
    for topic, type_name, device in demo.TOPICS:
        count, rate, delay, value, shown_type = row(done, topic)
        assert int(count) >= 1
        assert shown_type == type_name
        if device is None:
            assert (rate, delay, value) == ("-", "-", "data: ra6m5_sensor_node initialized")
        else:
            assert re.fullmatch(r"\d+\.\d Hz", rate), rate
            assert re.fullmatch(r"\d+\.\d\d ms", delay), delay


def test_a_board_that_is_not_ready_in_time_is_an_error_of_one_line(
    own_domain_id, monkeypatch, capsys
):
    monkeypatch.setattr("uros.boards.virtual.engine.runner.START_SECONDS", 0.0)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert cli.main(["demo", "--domain", str(own_domain_id)]) == 1
    assert capsys.readouterr().err == (
        "uros: waited 0 s for the board to start: is this machine busy? Run fewer programs or"
        " boards, and try again\n"
    )


def test_a_missing_sensor_is_reported_as_not_received(own_domain_id):
    done = run(own_domain_id, "--seconds", "5", "--fault", "sht3x:absent")
    assert done.returncode == 1
    assert "Not received: /sensors/room_temp, /sensors/humidity" in done.stderr
    assert "SHT3x read failed" in row(done, "/sensors/diagnostic")[3]


def test_an_unknown_fault_is_rejected_with_the_known_ones(own_domain_id):
    done = run(own_domain_id, "--seconds", "5", "--fault", "sht3x:nonsense")
    assert done.returncode == 1
    assert "nack" in done.stderr and "Traceback" not in done.stderr


def test_a_machine_without_pseudo_terminals_is_an_error():
    agent = SimpleNamespace(ended=False, print_news=lambda: None)
    board = SimpleNamespace(ended=False, usb_error="no line: out of pty devices")
    with pytest.raises(ToolError, match="the board's USB: no line: out of pty devices"):
        demo._watch(None, agent, board, [], None)


def test_delays_are_from_the_last_read_of_the_device():
    reads = demo._Reads()
    for ns in (1_000_000, 5_000_000, 9_000_000):
        reads.ended(0x44, ns)
    reads.ended(0x67, 6_900_000)
    topic = demo._Topic("/t", "std_msgs/msg/UInt16", 0x44, reads)
    assert topic.delays_ms() == []
    topic._heard = [500_000, 2_000_000, 7_000_000, 9_500_000]
    assert topic.delays_ms() == [1.0, 2.0, 0.5]
    assert topic.delays_ms(last=1) == [0.5]


class Terminal(io.StringIO):
    """Standard output as a terminal."""

    def isatty(self):
        return True


def shown_on(monkeypatch, columns, lines, news):
    """The lines of a terminal after three turns; ``news`` are those of the agent in each turn."""
    screen = Terminal()
    monkeypatch.setattr(sys, "stdout", screen)
    size = os.terminal_size((columns, lines))
    monkeypatch.setattr(demo.shutil, "get_terminal_size", lambda: size)
    topics = [demo._Topic(*topic, demo._Reads()) for topic in demo.TOPICS]
    for topic in topics:
        topic.count, topic.value = 1, "data: ra6m5_sensor_node initialized, and more"
    turns = iter(news)
    agent = SimpleNamespace(ended=False, print_news=lambda: print(*next(turns), sep="\n", end=""))
    board = SimpleNamespace(ended=False, usb_error="")
    left = len(news)

    def spin(done, seconds):
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        demo._watch(SimpleNamespace(spin=spin), agent, board, topics, None)
    return terminal_lines(screen.getvalue())


def terminal_lines(output):
    """The lines that stand on a terminal: what scrolls up, and what is drawn over."""
    lines = [""]
    for part in re.split(r"(\033\[\d*[AJ]|\n)", output):
        if part == "\n":
            lines.append("")
        elif part.endswith("A") and part.startswith("\033"):
            del lines[len(lines) - 1 - int(part[2:-1]) :]
            lines.append("")
        elif part != "\033[J":
            lines[-1] += part
    return lines


@pytest.mark.parametrize(
    ("columns", "lines", "last"),
    [(80, 24, "VALUE"), (200, 24, "TYPE"), (40, 24, "…"), (80, 5, "VALUE")],
)
def test_the_table_fits_the_terminal_and_stays_below_the_log(monkeypatch, columns, lines, last):
    warning = "[1] warning | Watchdog | run | the process stood still" * 3 + "\n"
    shown = shown_on(monkeypatch, columns, lines, [[], [warning], [], [warning], []])
    head = [line for line in shown if line.startswith("TOPIC")]
    assert len(head) == 1 and head[0].endswith(last), shown  # drawn over, and not again below
    table = shown[shown.index(head[0]) :]
    assert len([line for line in table if line]) == min(1 + len(demo.TOPICS), lines - 1)
    assert all(len(line) <= columns for line in table)
    assert shown.count(warning.rstrip()) == 2
    assert table[-1] == "" and warning.rstrip() not in table


@pytest.mark.parametrize("arguments", [["--seconds", "0"], ["--seconds", "x"], ["--domain", "233"]])
def test_bad_options(arguments):
    done = run(1, *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("uros demo: error: ") and done.stderr.count("\n") == 1


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
@pytest.mark.parametrize(
    "number", slow_except([signal.SIGKILL, signal.SIGTERM, signal.SIGHUP], signal.SIGKILL)
)
def test_the_agent_ends_with_the_demo_however_it_ends(own_domain_id, number):
    with default_signals():
        demo_process = subprocess.Popen(
            [sys.executable, "-m", "uros", "demo", "--domain", str(own_domain_id)],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert demo_process.stdout is not None
    while "Messages received" not in demo_process.stdout.readline():
        pass
    children = f"/proc/{demo_process.pid}/task/{demo_process.pid}/children"
    with open(children) as file:
        child = os.pidfd_open(int(file.read().split()[0]))
    demo_process.send_signal(number)
    demo_process.wait(20)
    demo_process.stdout.close()
    assert select.select([child], [], [], 20)[0], "the agent lives on"
    os.close(child)


def test_an_interrupt_before_every_topic_was_received_has_its_own_status(own_domain_id):
    with default_signals():
        demo_process = subprocess.Popen(
            [
                sys.executable, "-m", "uros", "demo", "--domain", str(own_domain_id),
                "--fault", "sht3x:absent",
            ],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert demo_process.stdout is not None
    assert any("Messages received" in line for line in demo_process.stdout)
    demo_process.send_signal(signal.SIGINT)
    _, said = demo_process.communicate(timeout=20)
    assert demo_process.returncode == 130
    assert "Not received until Ctrl-C: /sensors/room_temp" in said and "Traceback" not in said
