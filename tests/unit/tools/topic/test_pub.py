import argparse
import io
import subprocess
import sys

import pytest

from uros.host.network import Network
from uros.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile
from uros.tools import cli
from uros.tools.topic import pub
from uros.tools.values import qos_publish
from uros.tools.values.typed_values import load_service, type_and_text


def options(*arguments):
    parser = argparse.ArgumentParser()
    pub.add_arguments(parser)
    return parser.parse_args(["/x", *arguments])


@pytest.mark.parametrize(
    "arguments, found",
    [
        (["std_msgs/msg/Bool", "data: 1"], ("std_msgs/msg/Bool", "data: 1")),
        (["std_msgs/Bool"], ("std_msgs/Bool", "")),
        (["std_msgs::msg::dds_::Bool_"], ("std_msgs::msg::dds_::Bool_", "")),
        ([], (None, "")),
        (["data: 1"], (None, "data: 1")),
        (["{data: a/b}"], (None, "{data: a/b}")),
        (["data: a/b"], (None, "data: a/b")),
    ],
)
def test_type_and_values_may_be_left_out(arguments, found):
    assert type_and_text(options(*arguments)) == found


def test_values_from_standard_input(monkeypatch, capsys):
    def give(octets):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(octets)))

    give("data: ü\n".encode())
    assert type_and_text(options("std_msgs/String", "--stdin")) == ("std_msgs/String", "data: ü\n")
    give(b"\xff")
    assert cli.main(["topic", "pub", "/x", "std_msgs/String", "--stdin"]) == 1
    assert "standard input is not UTF-8" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["/x", "std_msgs/Bool", "data: 2"], 1, "Bool.data takes true or false, 1 or 0 (bool)"),
        (["/x", "std_msgs/Bool", "{data:1}"], 1, "a blank is missing behind the colon"),
        (
            ["/x", "geometry_msgs/msg/Twist", "{linear: {x: 0.0, y: 0.0, z:0.0}}"],
            1,
            "a blank is missing behind the colon of 'z:0.0'",
        ),
        (
            ["/x", "std_msgs/Bool", "data:1"],
            1,
            "std_msgs/msg/Bool: a blank is missing behind the colon of data:1; write 'data: ...'",
        ),
        (["/x", "std_msgs/Bool", "date:1"], 1, "the values are fields by name"),
        # not in quotes, so that the shell has split them
        (["/x", "std_msgs/Bool", "{data:", "1}"], 2, "1}; put VALUES in quotes: '{data: 1}' (help"),
        (["/x", "std_msgs/Bool", "data:", "-2"], 2, "put VALUES in quotes: 'data: -2' (help"),
        (["/x", "std_msgs/Bool", "{data:", "1}", "--onec"], 2, "; put VALUES in quotes (help"),
        (["/x", "{data:", "1}"], 2, "not the name of a type; put VALUES in quotes: '{data: 1}'"),
        (["/x", "data:", "[1,", "2]"], 2, "2]; put VALUES in quotes: 'data: [1, 2]' (help"),
        (["/x", "std_msgs/Bool", "{data: 1}", "2"], 2, "unrecognized arguments: 2 (help"),
        (["/x", "geometry_msg/msg/Twist"], 1, "did you mean geometry_msgs/msg/Twist"),
        (["/x", "std_msgs/Bol"], 1, "std_msgs/msg/Bol"),
        (["/x", "std_msgs/sg/Bool/x"], 1, "'std_msgs/sg/Bool/x' is not the name of a type"),
        (["/x", "std_srvs/srv/Trigger"], 1, "std_srvs/srv/Trigger is not a message"),
        (["/x", "std_msgs/Bool", "data: 1", "--stdin"], 1, "give either VALUES or --stdin"),
        (["/x", "std_msgs/Bool", "--max-wait-time-secs", "1"], 1, "goes with -w, --once or"),
        (
            ["/x", "std_msgs/Bool", "data: 1", "--yaml-file", "f"],
            2,
            "give either VALUES, --stdin or",
        ),
        (["/x", "data: 1", "--yaml-file", "f"], 2, "give either VALUES or --yaml-file"),
        (["/x", "std_msgs/Bool", "--yaml-file", "/no/f"], 1, "/no/f cannot be read: No such file"),
        (["/x", "std_msgs/Bool", "--yaml-file", "/"], 1, "/ cannot be read: Is a directory"),
        (["/x", "std_msgs/Bool", "-n", "a/b"], 2, "'a/b' is not a node name: use letters"),
        (["/x", "std_msgs/Bool", "-n", "1a"], 2, "'1a' is not a node name"),
        (["/x", "std_msgs/Bool", "-r", "0"], 2, "'0' is not a number above 0"),
        (["/x", "std_msgs/Bool", "-t", "-1"], 2, "-t"),
        (["/x", "std_msgs/Bool", "-1", "-t", "2"], 2, "not allowed with argument"),
        (["/x y", "std_msgs/Bool"], 2, "'/x y' is not a topic name"),
        (["/x", "std_msgs/Bool", "--qos-profile", "best"], 2, "invalid choice: 'best'"),
    ],
)
def test_a_wrong_command_line(arguments, status, said, capsys, own_domain_id):
    assert cli.main(["topic", "pub", *arguments, "--domain", str(own_domain_id)]) == status
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == ""


@pytest.mark.parametrize(
    "text, said",
    [
        (b"", "has no message"),
        (b"---\n---\n", "has no message"),
        (b"data: 1\n---\ndata: 2\n", "message 2: std_msgs/msg/Bool.data takes true or false"),
        (b"data: 1\n---\ndat: 2\n", "message 2: std_msgs/msg/Bool has no field 'dat'"),
        (b"data: 1\n---\n[1]\n", "message 2: std_msgs/msg/Bool: the values are fields by name"),
        (
            b"data: 1\n---\ndata: 'x\n",
            "this is not YAML: line 4, column 1: the closing quote is missing",
        ),
        (b"data: \xff\n", "is not UTF-8"),
    ],
)
def test_a_file_that_does_not_fit(text, said, tmp_path, capsys, own_domain_id):
    """Nothing is published, whichever message is wrong."""
    file = tmp_path / "messages\x1b.yaml"
    file.write_bytes(text)
    command = ["topic", "pub", "/x", "std_msgs/Bool", "--yaml-file", str(file)]
    assert cli.main([*command, "--domain", str(own_domain_id)]) == 1
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == "" and "\x1b" not in captured.err


def test_the_messages_of_a_file_are_published_once_each(tmp_path, capsys, own_domain_id):
    file = tmp_path / "messages.yaml"
    file.write_text("---\ndata: a\n---\n---\ndata: 'b: c'\n---\ndata: ''\n---\n")
    command = ["topic", "pub", "/x", "std_msgs/String", "--yaml-file", str(file), "-r", "100"]
    command += ["--domain", str(own_domain_id), "-w", "0", "--keep-alive", "0.01"]
    texts = [f"std_msgs.msg.String(data={text!r})" for text in ("a", "b: c", "")]
    for options, count in (([], 3), (["-t", "2"], 2), (["-t", "9"], 3), (["--once"], 1)):
        assert cli.main([*command, *options]) == 0
        lines = [f"publishing #{i + 1}: {text}\n\n" for i, text in enumerate(texts[:count])]
        assert capsys.readouterr().out == "publisher: beginning loop\n" + "".join(lines)


def chosen(*arguments):
    return qos_publish.choose(options(*arguments))


def test_qos():
    assert (chosen().depth, chosen().reliable, chosen().transient_local) == (10, True, False)
    assert chosen("--qos-profile", "sensor_data").depth == 5
    assert not chosen("--qos-profile", "sensor_data").reliable
    assert chosen("--qos-profile", "sensor_data", "--qos-reliability", "reliable").reliable
    for adapting in ("system_default", "best_available"):
        assert chosen("--qos-profile", adapting).reliable
        assert chosen("--qos-reliability", adapting).reliable
    latched = chosen("--qos-durability", "transient_local", "--qos-depth", "3")
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL and latched.depth == 3
    assert chosen("--qos-history", "keep_all").history == HistoryPolicy.KEEP_ALL
    lease = chosen(
        "--qos-liveliness", "manual_by_topic", "--qos-liveliness-lease-duration-seconds", "0.5"
    )
    assert lease.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC and lease.liveliness_lease_ms == 500


@pytest.mark.parametrize(
    "name", ["std_srvs/srv/Trigger", "std_srvs/Trigger", "std_srvs::srv::dds_::Trigger_"]
)
def test_names_of_services_types(name):
    assert load_service(name).Request._TYPE == "std_srvs/srv/Trigger_Request"


PROBE = (
    "import sys; from uros.tools.cli import main\n"
    "for verb in (['topic', 'pub'], ['service', 'call'], ['service', 'list'], ['run']):\n"
    "    try: main([*verb, '--help'])\n"
    "    except SystemExit: pass\n"
    "main(['run', '--list'])\n"
    "heavy = ('cyclonedds', 'ctypes', 'rclpy', 'yaml', 'uros.middleware', 'uros.interfaces')\n"
    "print([name for name in heavy if name in sys.modules])\n"
)


def test_help_loads_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


# --- names that are nearly right ------------------------------------------------------------------


@pytest.fixture
def subscriber(own_domain_id):
    """Somebody who subscribes to /led_brightness."""
    with Network(own_domain_id) as network:
        network.listen("/led_brightness", "std_msgs/msg/Float32", QoSProfile(), print)
        yield ["--domain", str(own_domain_id)]


def test_waiting_for_subscribers_of_a_misspelt_topic_prints_a_hint(subscriber, capsys):
    wrong = ["topic", "pub", "--once", "--max-wait-time-secs", "3", "/led_brightnes"]
    assert cli.main([*wrong, "std_msgs/msg/Float32", "data: 0.2", *subscriber]) == 1
    said = capsys.readouterr().err
    assert "nobody subscribes to /led_brightnes in domain" in said
    assert said.count("did you mean '/led_brightness'?") == 1


def test_publishing_on_a_misspelt_topic_prints_a_hint_once(subscriber, capsys):
    wrong = ["topic", "pub", "--times", "30", "-w", "0", "-r", "10", "/led_brightnes"]
    assert cli.main([*wrong, "std_msgs/msg/Float32", "data: 0.2", *subscriber]) == 0
    said = capsys.readouterr().err
    assert said.count("did you mean '/led_brightness'?") == 1


def test_publishing_without_subscribers_prints_no_hint(subscriber, capsys):
    alone = ["topic", "pub", "--times", "15", "-w", "0", "-r", "10", "/another"]
    assert cli.main([*alone, "std_msgs/msg/Float32", "data: 0.2", *subscriber]) == 0
    assert capsys.readouterr().err == ""


class SteppedNetwork:
    """A network on which /clock tells these times, in tenths of a second, one after the other."""

    def __init__(self, times):
        self._times = iter(times)
        self.now_ns = 0

    def listen(self, *_):
        pass

    def spin(self, done, seconds=None):
        while not done():
            self.now_ns = next(self._times) * 100_000_000
        return True


@pytest.mark.parametrize(
    "times, published",
    [
        ([10, 11, 12, 13], [10, 11, 12, 13]),
        ([10, 12, 13, 15], [10, 12, 13, 15]),  # a time is that of one message
        ([10, 11, 30, 31, 32], [10, 11, 30, 31, 32]),  # what was missed is not caught up on
        ([30, 31, 10, 11], [30, 31, 10, 11]),  # a time that went back
    ],
)
def test_a_rate_in_simulation_time(monkeypatch, times, published):
    network = SteppedNetwork(times)
    monkeypatch.setattr(pub, "clock", lambda network, _: lambda: network.now_ns)
    pace = pub._Pace(network, options("std_msgs/Bool", "-s", "-r", "10"))
    said = []
    with pytest.raises(StopIteration):
        while True:
            said.append(pace.now() // 100_000_000)
            pace.wait()
    assert said == published
