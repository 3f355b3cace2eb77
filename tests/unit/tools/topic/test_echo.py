import argparse
import io

import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import Net

from uros.host.network import Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from uros.tools import cli
from uros.tools.errors import ToolError, UsageError
from uros.tools.topic import echo as topic_echo
from uros.tools.topic.output import Output
from uros.tools.values.qos_subscribe import choose

STRING = load("std_msgs/String")


def options(*arguments):
    parser = argparse.ArgumentParser()
    topic_echo.add_arguments(parser)
    return parser.parse_args(["/x", *arguments])


@pytest.fixture
def echo(capsys):
    def show(message, *arguments):
        printer = topic_echo.Printer(options(*arguments))
        printer.expect(None if "--raw" in arguments else type(message))
        printer.show(Received(to_cdr(message), 12, 34))
        return capsys.readouterr().out

    return show


def test_yaml(echo):
    assert echo(STRING(data="kept: yes")) == "data: 'kept: yes'\n---\n"


def test_csv(echo):
    assert echo(STRING(data="a"), "--csv") == "a\n"
    assert echo(STRING(data="a"), "--csv", "-i") == "12,34,,,a\n"


def test_field(echo):
    assert echo(STRING(data="a: b"), "--field", "data") == "a: b\n---\n"
    header = load("std_msgs/Header")(frame_id="f")
    assert echo(header, "--field", "stamp") == "sec: 0\nnanosec: 0\n---\n"
    assert echo(header, "--field", "stamp", "--csv") == "0,0\n"
    with pytest.raises(ToolError, match="--field stamp.x: .* has no field 'x'"):
        echo(header, "--field", "stamp.x")
    with pytest.raises(ToolError, match="names no field"):
        echo(header, "--field", ".")


def test_raw(echo):
    assert (
        echo(STRING(data="a"), "--raw")
        == "b'\\x00\\x01\\x00\\x00\\x02\\x00\\x00\\x00a\\x00'\n---\n"
    )


def test_message_info(echo):
    assert echo(STRING(data="a"), "-i") == (
        "publication_sequence_number: null\nreceived_timestamp: 34\n"
        "reception_sequence_number: null\nsource_timestamp: 12\n---\ndata: a\n---\n"
    )
    assert "---Message data:---\na\n---\n" in echo(STRING(data="a"), "-i", "--field", "data")


def test_length_and_style(echo):
    text = STRING(data="x" * 200)
    assert echo(text) == f"data: {'x' * 128}...\n---\n"
    assert echo(text, "-f") == f"data: {'x' * 200}\n---\n"
    assert echo(text, "-l", "3") == "data: xxx...\n---\n"
    assert echo(text, "--no-str") == "data: '<string length: <200>>'\n---\n"
    numbers = load("std_msgs/UInt8MultiArray")(data=b"\1\2")
    assert echo(numbers, "--flow-style").splitlines()[-2] == "data: [1, 2]"
    assert "data: '<sequence type: uint8, length: 2>'" in echo(numbers, "--no-arr")


def test_once(capsys):
    printer = topic_echo.Printer(options("--once"))
    printer.expect(STRING)
    for _ in range(3):
        printer.show(Received(to_cdr(STRING(data="a")), 0, 0))
    assert printer.done
    assert capsys.readouterr().out == "data: a\n---\n"


def test_a_broken_message_does_not_end_the_command(capsys):
    printer = topic_echo.Printer(options())
    printer.expect(STRING)
    printer.show(Received(b"\0\1\0\0\xff\0\0\0", 0, 0))
    captured = capsys.readouterr()
    assert captured.out == "" and "could not be read: std_msgs/msg/String" in captured.err
    assert not printer.count


POSES = load("geometry_msgs/msg/PoseArray")


def poses(*xs):
    message = POSES(poses=[load("geometry_msgs/msg/Pose")() for _ in xs])
    for pose, x in zip(message.poses, xs, strict=True):
        pose.position.x = x
    return message


def test_several_fields_and_elements(echo):
    assert echo(poses(1.0, 2.0), "--field", "poses[1].position.x") == "2.0\n---\n"
    assert echo(poses(1.0, 2.0, 3.0), "--field", "poses[-2:].position.x") == (
        "array('d', [2.0, 3.0])\n---\n"
    )
    both = ("--field", "header.frame_id", "--field", "poses[0].position")
    assert echo(poses(1.5), *both) == "\n---\nx: 1.5\ny: 0.0\nz: 0.0\n---\n"
    assert echo(poses(1.5), *both, "--csv") == ",1.5,0.0,0.0\n"
    with pytest.raises(ToolError, match=r"--field .*: poses has 1 elements, and so no \[4\]"):
        echo(poses(1.0), "--field", "poses[4]")
    with pytest.raises(UsageError, match=r"'poses\[x\]' is not a field, with an index such as"):
        echo(poses(1.0), "--field", "poses[x]")


def test_filter(echo):
    assert echo(STRING(data="ab"), "--filter", "m.data.startswith('a')") == "data: ab\n---\n"
    assert echo(STRING(data="b"), "--filter", "m.data == 'a'") == ""
    # With one field, m is that field, as in ros2; with several, it is the message.
    assert echo(STRING(data="a"), "--field", "data", "--filter", "m == 'a'") == "a\n---\n"
    both = ("--field", "data", "--field", "data", "--filter", "m.data == 'a'")
    assert echo(STRING(data="a"), *both) == "a\n---\na\n---\n"
    with pytest.raises(ToolError, match="has no field 'dat'; it has data; did you mean 'data'"):
        echo(STRING(), "--filter", "m.dat == 1")
    with pytest.raises(UsageError, match="--raw prints whole messages"):
        echo(STRING(), "--raw", "--filter", "m.data")


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def test_clear(echo, monkeypatch):
    assert echo(STRING(data="a"), "--clear") == "data: a\n---\n"  # no terminal
    terminal = Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    echo(STRING(data="\x1b[2J"), "-c")
    assert terminal.getvalue() == '\x1b[H\x1b[2Jdata: "\\e[2J"\n---\n'


def test_what_a_slow_reader_has_no_room_for_is_skipped_and_counted(echo, monkeypatch):
    printer = topic_echo.Printer(options())
    printer.expect(STRING)
    monkeypatch.setattr(Output, "full", True)
    printer.show(Received(to_cdr(STRING(data="a")), 0, 0))
    assert (printer.count, printer.skipped) == (0, 1)


# --- QoS ------------------------------------------------------------------------

LATCHED = QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOSSY = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)


def chosen(*arguments, offered=()):
    return choose(options(*arguments), offered)


def test_without_publishers_the_subscription_matches_all():
    profile, notes = chosen()
    assert not profile.reliable and not profile.transient_local and not notes


def test_qos_follows_the_publishers():
    profile, notes = chosen(offered=[LATCHED])
    assert profile.reliable and profile.transient_local and not notes
    profile, notes = chosen(offered=[LATCHED, LOSSY])
    assert not profile.reliable and not profile.transient_local and len(notes) == 2
    profile, _ = chosen("--qos-reliability", "best_available", offered=[LATCHED])
    assert profile.reliable


def test_qos_options_override_the_publishers():
    profile, notes = chosen(
        "--qos-reliability", "best_effort", "--qos-durability", "volatile", offered=[LATCHED]
    )
    assert not profile.reliable and not profile.transient_local and not notes
    profile, notes = chosen("--qos-reliability", "reliable", offered=[LOSSY])
    assert profile.reliable and "do not match" in notes[0]
    profile, notes = chosen("--qos-durability", "transient_local", offered=[LOSSY])
    assert profile.transient_local and "do not match" in notes[0]


def test_depth_and_history():
    assert chosen("--qos-profile", "sensor_data")[0].depth == 5
    assert chosen("--qos-depth", "7")[0].depth == 7
    assert chosen("--qos-history", "keep_all")[0].history == HistoryPolicy.KEEP_ALL
    profile, _ = chosen("--qos-profile", "action_status_default")
    assert profile.reliable and profile.transient_local and profile.depth == 1


def test_liveliness():
    profile, _ = chosen(
        "--qos-liveliness", "manual_by_topic", "--qos-liveliness-lease-duration-seconds", "0.5"
    )
    assert profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    assert profile.liveliness_lease_ms == 500


# --- on a network -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options, told",
    [([], True), (["--lost-messages"], True), (["--no-lost-messages"], False), (["-s"], True),
     (["--use-sim-time"], True)],
)  # fmt: skip
def test_lost_messages_are_told_unless_that_is_not_wanted(monkeypatch, capsys, options, told):
    net = Net()
    net.endpoint(net.participant(), "rt/x", "std_msgs::msg::dds_::String_", True)
    network = GraphNetwork(net).join(monkeypatch)

    def receive():
        network.samples_lost = 3
        network.listening["/x"](Received(to_cdr(STRING(data="a")), 0, 0))

    network.script = [receive]
    assert cli.main(["topic", "echo", "/x", "--once", *options]) == 0
    captured = capsys.readouterr()
    assert captured.out == "data: a\n---\n"
    assert captured.err == "WARNING: 3 messages were lost or skipped, 3 in all\n" * told
