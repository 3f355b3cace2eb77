"""``uros topic`` and ``uros node``, as processes, with the topics of a real rclpy node."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

TALKER = Path(__file__).parent / "talker.py"
SECONDS = 30
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"

# The process that started the tests may have set SIGINT to be ignored, which children inherit.
UROS = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    " from uros.tools.cli import main; sys.exit(main())"
)

# Prints the documents that the test sends by PyYAML, as ros2 does.
PRINT_YAML = """
import json, sys, yaml
from collections import OrderedDict

def mapping(dumper, data):
    return yaml.nodes.MappingNode(
        "tag:yaml.org,2002:map",
        [(dumper.represent_data(k), dumper.represent_data(v)) for k, v in data.items()],
    )

yaml.add_representer(OrderedDict, mapping)
documents = json.load(sys.stdin, object_pairs_hook=OrderedDict)
json.dump(
    [
        yaml.dump(d, allow_unicode=True, width=sys.maxsize, default_flow_style=flow)
        for d in documents
        for flow in (False, True)
    ],
    sys.stdout,
)
"""


@pytest.fixture(scope="module", autouse=True)
def talker(ros_python, domain):
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
    for name in ("CYCLONEDDS_URI", "PYTHONPATH"):
        environment.pop(name, None)
    process = subprocess.Popen(
        [str(ros_python), str(TALKER)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        assert process.stdout.readline() == "READY\n"
        yield
    finally:
        process.stdin.close()
        process.wait(SECONDS)
        process.stdout.close()


@pytest.fixture
def uros(domain):
    """Run a command to its end; return standard output, or standard error if it fails."""

    def run(*arguments, status=0):
        done = subprocess.run(
            [sys.executable, "-c", UROS, *arguments, "--domain", str(domain)],
            capture_output=True,
            text=True,
            timeout=SECONDS,
        )
        assert done.returncode == status, done.stderr
        return done.stdout if status == 0 else done.stderr

    return run


@pytest.fixture
def started(domain):
    """Start a command that runs until it is interrupted."""
    processes = []

    def start(*arguments):
        process = subprocess.Popen(
            [sys.executable, "-c", UROS, *arguments, "--domain", str(domain)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def interrupt(process):
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=SECONDS)
    return process.returncode, errors


# --- topic list, topic info -------------------------------------------------------


def test_topic_list(uros):
    assert uros("topic", "list", "-t").splitlines() == [
        "/camera/compressed [sensor_msgs/msg/CompressedImage]",
        "/chatter [std_msgs/msg/String]",
        "/heard [std_msgs/msg/String]",
        "/latched [std_msgs/msg/String]",
        "/parameter_events [rcl_interfaces/msg/ParameterEvent]",
        "/rosout [rcl_interfaces/msg/Log]",
    ]
    assert uros("topic", "list", "-c") == "6\n"
    assert uros("topic", "list", "--include-hidden-topics").splitlines()[0] == "/_hidden"


def test_topic_list_with_counts(uros):
    published, subscribed = uros("topic", "list", "-v", "--no-daemon").split("\n\n")[:2]
    assert published.splitlines()[:3] == [
        "Published topics:",
        " * /camera/compressed [sensor_msgs/msg/CompressedImage] 1 publisher",
        " * /chatter [std_msgs/msg/String] 1 publisher",
    ]
    assert subscribed.splitlines() == [
        "Subscribed topics:",
        " * /heard [std_msgs/msg/String] 1 subscriber",
    ]


def test_topic_info(uros):
    assert uros("topic", "info", "chatter") == (
        "Type: std_msgs/msg/String\nPublisher count: 1\nSubscription count: 0\n"
    )


@pytest.mark.parametrize(
    "topic, kind, reliability, durability",
    [
        ("/latched", "PUBLISHER", "RELIABLE", "TRANSIENT_LOCAL"),
        ("/heard", "SUBSCRIPTION", "RELIABLE", "VOLATILE"),
        ("/camera/compressed", "PUBLISHER", "BEST_EFFORT", "VOLATILE"),
    ],
)
def test_topic_info_of_endpoints(uros, topic, kind, reliability, durability):
    printed = uros("topic", "info", "-v", topic)
    (block,) = [part for part in printed.split("\n\n") if part.startswith("Node name")]
    lines = block.splitlines()
    assert lines[:2] == ["Node name: talker", "Node namespace: /lab"]
    if topic != "/camera/compressed":
        assert lines[2:4] == [
            "Topic type: std_msgs/msg/String",
            f"Topic type hash: {STRING_HASH}",
        ]
    assert lines[4] == f"Endpoint type: {kind}"
    octets = lines[5].removeprefix("GID: ").split(".")
    assert len(octets) == 16 and octets[:2] == ["01", "0f"]
    assert lines[6:] == [
        "QoS profile:",
        f"  Reliability: {reliability}",
        "  History (Depth): UNKNOWN",
        f"  Durability: {durability}",
        "  Lifespan: Infinite",
        "  Deadline: Infinite",
        "  Liveliness: AUTOMATIC",
        "  Liveliness lease duration: Infinite",
    ]


def test_topic_info_of_a_missing_topic(uros, domain):
    assert uros("topic", "info", "/chater", status=1) == (
        f"uros: there is no topic '/chater' in domain {domain}; did you mean '/chatter'?\n"
    )


def test_listings_as_json(uros):
    """What the text has, and types, counts and QoS beside it."""
    topics = {entry["name"]: entry for entry in json.loads(uros("topic", "list", "--json"))}
    assert list(topics) == uros("topic", "list").splitlines()
    assert topics["/chatter"] == {
        "name": "/chatter", "types": ["std_msgs/msg/String"], "publishers": 1, "subscriptions": 0,
    }  # fmt: skip
    (publisher,) = json.loads(uros("topic", "info", "/latched", "--json"))["publishers"]
    assert publisher["node_name"] == "talker" and publisher["type_hash"] == STRING_HASH
    assert publisher["qos"]["durability"] == "TRANSIENT_LOCAL"
    assert json.loads(uros("node", "list", "--json")) == [{"name": "/lab/talker"}]
    node = json.loads(uros("node", "info", "/lab/talker", "--json"))
    assert node["subscribers"] == [{"name": "/heard", "types": ["std_msgs/msg/String"]}]
    assert node["service_clients"] == [{"name": "/elsewhere", "types": ["std_srvs/srv/Trigger"]}]
    services = json.loads(uros("service", "list", "--json"))
    assert {"name": "/lab/go", "types": ["std_srvs/srv/Trigger"]} in services
    assert json.loads(uros("service", "find", "std_srvs/srv/Trigger", "--json", "-c")) == 2


# --- topic echo -------------------------------------------------------------------


def test_echo_a_string(uros):
    assert uros("topic", "echo", "/chatter", "--once") == "data: hello\n---\n"
    assert uros("topic", "echo", "/chatter", "--once", "--field", "data") == "hello\n---\n"


def test_echo_a_latched_sample(uros):
    assert uros("topic", "echo", "latched", "--once") == "data: 'kept: yes'\n---\n"


def test_echo_an_image(uros):
    head = "header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: cam\nformat: jpeg\n"
    image = [str(i) for i in range(250)] * 60
    printed = uros("topic", "echo", "/camera/compressed", "--once")
    assert printed == (
        head + "data:\n" + "".join(f"- {octet}\n" for octet in image[:128]) + "- '...'\n---\n"
    )
    printed = uros("topic", "echo", "/camera/compressed", "--once", "-f", "--csv")
    assert printed == "0,0,cam,jpeg," + ",".join(image) + "\n"
    printed = uros("topic", "echo", "/camera/compressed", "--once", "--no-arr")
    assert printed == head + "data: '<sequence type: uint8, length: 15000>'\n---\n"


def test_echo_runs_until_it_is_interrupted(started):
    process = started("topic", "echo", "/chatter")
    lines = [process.stdout.readline() for _ in range(6)]
    assert lines == ["data: hello\n", "---\n"] * 3
    assert interrupt(process) == (0, "")


def test_echo_waits_for_a_topic(uros, started):
    error = uros("topic", "echo", "/nobody", "--timeout", "0.1", status=1)
    assert "topic [/nobody] does not appear to be published yet" in error
    assert "uros: topic '/nobody' did not appear" in error
    process = started("topic", "echo", "/nobody")
    assert "waiting for it" in process.stderr.readline()
    assert interrupt(process) == (0, "")


def test_echo_of_a_silent_topic_times_out(uros):
    error = uros("topic", "echo", "/heard", "--timeout", "0.1", status=1)
    assert "no message came on /heard" in error


def test_echo_of_an_unknown_type(uros, tmp_path):
    wanted = ("topic", "echo", "/chatter", "home_msgs/Lamp", "--timeout", "0.1")
    error = uros(*wanted, status=1)
    assert "home_msgs/msg/Lamp" in error and "--interfaces DIR" in error
    folder = tmp_path / "home_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Lamp.msg").write_text("builtin_interfaces/Time stamp\nuint8 level\n")
    error = uros(*wanted, "--interfaces", str(tmp_path), status=1)
    assert "/chatter has the type std_msgs/msg/String: no message will come" in error


def test_echo_with_another_type(uros):
    error = uros("topic", "echo", "/chatter", "std_msgs/Int32", "--timeout", "0.1", status=1)
    assert "/chatter has the type std_msgs/msg/String: no message will come" in error


def test_yaml_is_that_of_pyyaml(ros_python):
    from uros.tools.values.yaml_text import dump

    strings = [
        "",
        "a: b",
        "no",
        "1e5",
        "1.5",
        "- x",
        "a\nb\n",
        "a \nb",
        "\x00\x7f",
        "grün",
        "x#",
        "#",
    ]
    documents = [
        {"text": text, "list": [text, {"inner": text, "more": [text]}], "deep": {"text": text}}
        for text in strings
    ] + [{"numbers": [0, -1, 1.5, 1e20, 1e-7, True, None], "empty": [], "none": {}}]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [str(ros_python), "-c", PRINT_YAML],
        input=json.dumps(documents),
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        timeout=SECONDS,
    )
    assert [dump(d, flow) for d in documents for flow in (False, True)] == json.loads(done.stdout)


# --- topic hz ---------------------------------------------------------------------


def test_hz(started):
    process = started("topic", "hz", "/chatter", "--window", "100")
    first, second = process.stdout.readline(), process.stdout.readline()
    name, rate = first.split(": ")
    assert name == "average rate" and 10 < float(rate) < 30
    assert second.startswith("\tmin: 0.") and " std dev: " in second and " window: " in second
    assert interrupt(process) == (0, "")


# --- nodes ------------------------------------------------------------------------


def test_node_list(uros):
    assert uros("node", "list") == "/lab/talker\n"
    assert uros("node", "list", "-c") == "1\n"
    own, talker = uros("node", "list", "-a").splitlines()
    assert own.startswith("/_uros_") and talker == "/lab/talker"


def test_node_info(uros):
    printed = uros("node", "info", "/lab/talker")
    sections = {}
    for line in printed.splitlines()[1:]:
        if line.startswith("  ") and not line.startswith("   "):
            lines = sections[line.strip()] = []
        else:
            lines.append(line)
    assert printed.startswith("/lab/talker\n")
    assert sections["Subscribers:"] == ["    /heard: std_msgs/msg/String"]
    assert sections["Publishers:"][:3] == [
        "    /camera/compressed: sensor_msgs/msg/CompressedImage",
        "    /chatter: std_msgs/msg/String",
        "    /latched: std_msgs/msg/String",
    ]
    assert sections["Service Servers:"][0] == "    /lab/go: std_srvs/srv/Trigger"
    assert sections["Service Clients:"] == ["    /elsewhere: std_srvs/srv/Trigger"]
    assert sections["Action Servers:"] == sections["Action Clients:"] == [""]
    assert "/_hidden" in uros("node", "info", "lab/talker", "--include-hidden")


def test_node_info_of_a_missing_node(uros, domain):
    assert uros("node", "info", "/lab/talkr", status=1) == (
        f"uros: there is no node '/lab/talkr' in domain {domain}; did you mean '/lab/talker'?\n"
    )
