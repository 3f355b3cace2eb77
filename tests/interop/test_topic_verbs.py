"""The verbs of ``uros topic``, as processes, with an rclpy node that publishes and subscribes.

So are the other commands that read topics: ``plot``, ``completion`` and ``doctor --report``.
`test_tools.py` and `test_host_tools.py` have the rest of ``list``, ``info``, ``echo`` and ``pub``.
"""

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.peer import RosPeer

from uros.interfaces import load
from uros.interfaces.codec import from_cdr

pytestmark = pytest.mark.timeout(120)

SECONDS = 40
STRING = "std_msgs/msg/String"
INT32 = "std_msgs/msg/Int32"
HEADER = "std_msgs/msg/Header"

# The process that started the tests may have set SIGINT to be ignored, which children inherit.
UROS = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    " from uros.tools.cli import main; sys.exit(main())"
)


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "topic_peer.py") as running:
        yield running


def start(domain, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", UROS, *arguments, "--domain", str(domain)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.fixture
def uros(domain, peer):
    """Run a command to its end; return standard output, or standard error if it fails."""

    def run(*arguments, status=0):
        process = start(domain, *arguments)
        try:
            out, errors = process.communicate(timeout=SECONDS)
        finally:
            process.kill()
        assert process.returncode == status, out + errors
        return out if status == 0 else errors

    return run


@pytest.fixture
def going(domain, peer):
    """Start commands that run until Ctrl-C, which ends them with status 0 at the end of the block.

    They are read from in turn, so that their starts overlap.
    """

    @contextmanager
    def run(*commands):
        processes = [start(domain, *command.split(" ")) for command in commands]
        try:
            yield processes
            for process in processes:
                process.send_signal(signal.SIGINT)
            for process in processes:
                _, errors = process.communicate(timeout=SECONDS)
                assert process.returncode == 0 and "Traceback" not in errors, errors
        finally:
            for process in processes:
                process.kill()
                process.communicate()

    return run


def lines_until(process, pattern):
    """Read lines of a process until one matches; return the match."""
    for line in process.stdout:
        match = re.fullmatch(pattern, line.rstrip("\n"))
        if match:
            return match
    raise AssertionError(f"nothing matches {pattern}: {process.stderr.read()}")


def test_type_and_find(uros):
    assert uros("topic", "type", "/numbers") == f"{INT32}\n"
    assert "/numbers\n" in uros("topic", "find", INT32)
    assert "did you mean '/numbers'?" in uros("topic", "type", "/number", status=1)


RATE = r"average rate: ([\d.]+)"


def test_hz_bw_and_delay(going):
    """Rates, sizes and ages are those of the publisher, by the system's time and by /clock."""
    with going(
        "topic hz /numbers --window 200",
        "topic hz /numbers --filter m.data%2==0",
        "topic hz /numbers --use-sim-time",
        "topic hz /numbers /poses",
        "topic bw /poses",
        "topic bw /numbers /poses --qos-reliability best_effort",
        "topic delay /poses",
    ) as (hz, filtered, sim, several, bw, table, delay):
        # 50 a second, or fewer on a busy machine.
        assert 5 < float(lines_until(hz, RATE)[1]) < 100
        assert 2 < float(lines_until(filtered, RATE)[1]) < 40
        # On /clock, ten times as much time passes: the same messages come more rarely.
        assert 0.5 < float(lines_until(sim, RATE)[1]) < 15
        lines_until(several, r"Subscribed to \[/poses\]")
        lines_until(several, r" *topic +rate +min_delta +max_delta +std_dev +window *")
        lines_until(several, r"/numbers +[\d.]+ .*")
        lines_until(bw, r"Subscribed to \[/poses\]")
        rate = lines_until(bw, r"([\d.]+) KB/s from \d+ messages")
        size = lines_until(bw, r"\tMessage size mean: ([\d.]+) KB min: .*")
        assert 5 < float(rate[1]) / float(size[1]) < 100
        lines_until(table, r"/numbers +\d+ B/s +\d+ +(8|12) B +.*")
        age = lines_until(delay, r"average delay: ([\d.]+)")
        assert 1.9 < float(age[1]) < 20


def test_delay_of_messages_without_a_header(uros):
    error = uros("topic", "delay", "/numbers", status=1)
    assert error == (
        "uros: std_msgs/msg/Int32 has no header, whose stamp tells when a message was made;"
        " its fields: data\n"
    )


def test_echo_of_elements_filtered(uros):
    x = ("--once", "--field", "poses[1].position.x")
    assert uros("topic", "echo", "/poses", *x, "--filter", "m > 0.5") == "1.0\n---\n"
    both = ("--field", "header.frame_id", "--field", "poses[:].position.y", "--csv")
    assert uros("topic", "echo", "/poses", "--once", *both, "-n", "listener") == (
        "map,array('d', [0.0, 0.0, 0.0])\n"
    )
    error = uros("topic", "echo", "/poses", "--filter", "m.pose", status=1)
    assert "geometry_msgs/msg/PoseArray has no field 'pose'; it has header, poses; did" in error
    error = uros("topic", "echo", "/poses", "--filter", "m.poses[3].position.x", status=1)
    assert "fails on a message: IndexError" in error
    assert uros("topic", "echo", "/evil", "--once") == 'data: "\\e[2J\\u202E"\n---\n'


def test_pub_of_the_messages_of_a_file(uros, peer, tmp_path):
    """What echo prints is published as it came."""
    echoed = uros("topic", "echo", "/numbers", "--once") * 2 + "---\n---\n"
    file = tmp_path / "numbers.yaml"
    file.write_text(echoed)
    peer.do("subscribe", topic="/played", type=INT32)
    printed = uros(
        "topic", "pub", "/played", INT32, "--yaml-file", str(file), "-r", "20", "-w", "1"
    )
    assert printed.count("publishing #") == 2
    number = int(re.search(r"data: (\d+)", echoed)[1])
    assert [from_cdr(load(INT32), peer.message("/played")).data for _ in "12"] == [number] * 2
    peer.do("unsubscribe", topic="/played")
    file.write_text("data: 1\n---\ndata: one\n")
    error = uros("topic", "pub", "/played", INT32, "--yaml-file", str(file), status=1)
    assert "numbers.yaml: message 2: std_msgs/msg/Int32.data takes a whole number" in error


def test_pub_with_the_time_of_the_clock(domain, peer):
    peer.do("subscribe", topic="/stamped", type=HEADER)
    process = start(
        domain, "topic", "pub", "/stamped", HEADER, "stamp: now", "-s", "-n", "player", "-r", "10"
    )
    try:
        first, second = (from_cdr(load(HEADER), peer.message("/stamped")).stamp for _ in "12")
        assert "/player" in peer.do("graph")["full_names"]
        # Ten messages a second on /clock, which began at 100 s.
        assert 100 <= first.sec < 10_000
        period = (second.sec - first.sec) * 1e9 + second.nanosec - first.nanosec
        assert 0 < period < 2e9
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=SECONDS)
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()
    peer.do("unsubscribe", topic="/stamped")


# --- other commands --------------------------------------------------------------------------


def test_plot(going):
    """Where the output is no terminal, each number is a line."""
    with going("plot /numbers/data poses.poses[1].position.x") as (plot,):
        lines_until(plot, "seconds,name,value")
        first = int(lines_until(plot, r"[\d.]+,/numbers/data,(\d+)\.0")[1])
        assert int(lines_until(plot, r"[\d.]+,/numbers/data,(\d+)\.0")[1]) > first
        values = {lines_until(plot, r"[\d.]+,poses\.\S+,(\S+)")[1] for _ in range(2)}
        assert values == {"0.0", "1.0"}


@pytest.mark.parametrize(
    "line, words",
    [
        ("topic echo /num", ["/numbers"]),
        ("topic hz /po", ["/poses"]),
        ("topic pub /numbers ", [INT32]),
        (f"topic pub /numbers {INT32} ", ['"{data:', '0}"']),
        ("plot /poses/header/", ["/poses/header/stamp/"]),
        ("topic find std_msgs/msg/Int32M", ["std_msgs/msg/Int32MultiArray"]),
        ("param get /real/peer use_sim", ["use_sim_time"]),
        ("service type /real/peer/get_parameter_", ["/real/peer/get_parameter_types"]),
    ],
)
def test_completion_offers_what_the_node_has(peer, domain, line, words):
    command = ["completion", "--next", "bash", "--", f"uros {line}"]
    out = subprocess.run(
        [sys.executable, "-c", UROS, *command], check=True, timeout=SECONDS, text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)}, stdout=subprocess.PIPE,
    ).stdout  # fmt: skip
    assert out.split() == words


def test_the_report_of_the_doctor(uros, peer):
    peer.do("subscribe", topic="/numbers", type=INT32, reliability="reliable")
    peer.do(
        "subscribe", topic="/poses", type="geometry_msgs/msg/PoseArray",
        durability="transient_local", seconds=0,
    )  # fmt: skip
    try:
        report = uros("doctor", "--report", "--exclude-packages")
    finally:
        peer.do("unsubscribe", topic="/numbers")
        peer.do("unsubscribe", topic="/poses")
    topics = report.partition("TOPIC LIST")[2]
    assert re.search(r"topic +: /numbers\npublisher count +: 1\nsubscriber count +: 1\n", topics), (
        report
    )
    compatible = report.partition("QOS COMPATIBILITY LIST")[2]
    assert re.search(r"topic \[type\] +: /numbers .*(\n.+)*\n.*: OK\n", compatible), report
    assert "durability offered is volatile, requested transient_local" in compatible, report
