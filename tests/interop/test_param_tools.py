"""``uros param`` with real rclpy nodes, in a process of their own, and with a board's node."""

import json
import math
from pathlib import Path

import pytest
from support.agent import running_agent
from support.middleware import host_node
from support.peer import RosPeer
from support.spinning import spinning
from unit.tools.param.test_values import TEXTS

from uros import Node
from uros.client.parameter import FloatingPointRange, ParameterDescriptor
from uros.tools import cli
from uros.tools.param.values import from_text, plain
from uros.transport.udp import UdpTransport

pytestmark = pytest.mark.timeout(120)

TUNED = "/lab/tuned"
NAMES = [
    "any", "arm.bools", "arm.ints", "arm.left.doubles", "arm.left.texts", "bool", "count",
    "digits", "double", "fixed", "int", "octets", "speed", "start_type_description_service",
    "text", "use_sim_time",
]  # fmt: skip


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "inspected_peer.py") as running:
        yield running


@pytest.fixture
def uros(domain, capsys):
    """Run a command; return standard output, or both streams where it fails."""

    def run(*arguments, status=0):
        options = [] if "--timeout" in arguments else ["--timeout", "20"]
        options += ["--domain", str(domain)]
        returned = cli.main([*arguments[:2], *options, *map(str, arguments[2:])])
        printed = capsys.readouterr()
        assert returned == status, printed
        return printed.out if status == 0 else printed.out + printed.err

    return run


@pytest.fixture
def reset(peer):
    yield
    peer.do("reset")


# --- list and describe ----------------------------------------------------------------------------


def test_list_of_a_node(uros, peer):
    assert uros("param", "list", TUNED).splitlines() == [f"  {name}" for name in NAMES]
    as_json = json.loads(uros("param", "list", TUNED, "--json"))
    assert as_json == [{"node": TUNED, "name": name} for name in NAMES]
    as_json = json.loads(uros("param", "list", TUNED, "--json", "--param-type", "--filter", "int"))
    assert as_json and all(entry["type"] for entry in as_json)
    printed = uros("param", "list", TUNED, "--param-type", "--filter", r"arm\.|int")
    assert printed.splitlines() == [
        "  arm.bools (type: boolean array)",
        "  arm.ints (type: integer array)",
        "  arm.left.doubles (type: double array)",
        "  arm.left.texts (type: string array)",
        "  int (type: integer)",
    ]
    printed = uros("param", "list", "lab/tuned", "--param-prefixes", "arm.left")
    assert printed.split() == ["arm.left.doubles", "arm.left.texts"]


def test_list_of_all_nodes_names_one_that_does_not_answer(uros, peer):
    printed = uros("param", "list", "--timeout", "1.5", status=1)
    listed = printed.splitlines()
    assert {"/real/peer:", "/lab/tuned:", "/lab/lens:"} <= set(listed)
    assert "/lab/deaf:" not in listed and "  arm.left.texts" in listed
    assert (
        "WARNING: the parameters of /lab/deaf are not listed: /lab/deaf/list_parameters did not"
        " answer within 1.5 s; is its node busy, or not spinning?"
    ) in listed


def test_a_node_that_does_not_answer(uros, peer):
    for verb in (["list", "/lab/deaf"], ["get", "/lab/deaf", "x"]):
        said = uros("param", *verb, "--timeout", "1.5", status=1)
        assert said.startswith("uros: /lab/deaf/") and "did not answer within 1.5 s" in said


def test_describe(uros, peer):
    assert uros("param", "describe", TUNED, "speed", "fixed", "count") == (
        "Parameter name: speed\n"
        "  Type: double\n"
        "  Description: speed in m/s\n"
        "  Constraints:\n"
        "    Min value: 0.0\n"
        "    Max value: 2.0\n"
        "    Step: 0.5\n"
        "    Additional constraints: only \\x1b[31mgood ones\n"
        "Parameter name: fixed\n"
        "  Type: integer\n"
        "  Constraints:\n"
        "    Read only: true\n"
        "Parameter name: count\n"
        "  Type: integer\n"
        "  Constraints:\n"
        "    Min value: -1\n"
        "    Max value: 9\n"
        "    Step: 2\n"
    )
    said = uros("param", "describe", TUNED, "speed", "sped", status=1)
    assert said == "uros: /lab/tuned has no parameter 'sped'; did you mean 'speed'?\n"


# --- get and set ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, label, value",
    [
        ("bool", "Boolean value is:", "True"),
        ("int", "Integer value is:", "-4"),
        ("double", "Double value is:", "0.5"),
        ("text", "String value is:", "grün\tline\nend\\x1b[2J \\u202e"),
        ("digits", "String value is:", "0123"),
        ("octets", "Byte values are:", "[b'\\x00', b'\\xff']"),
        ("arm.bools", "Boolean values are:", "[True, False]"),
        ("arm.ints", "Integer values are:", "[1, -9223372036854775808]"),
        ("arm.left.doubles", "Double values are:", "[0.25, -1e+300, inf, nan]"),
        ("arm.left.texts", "String values are:", "['a', '', 'no', '1.5', '☃']"),
    ],
)
def test_get(uros, peer, name, label, value):
    assert uros("param", "get", TUNED, name) == f"{label} {value}\n"


def test_get_without_the_type_and_of_what_is_not_there(uros, peer):
    assert uros("param", "get", TUNED, "int", "--hide-type") == "-4\n"
    said = uros("param", "get", TUNED, "arm.int", status=1)
    assert said.startswith("uros: /lab/tuned has no parameter 'arm.int'; did you mean 'arm.ints'")
    said = uros("param", "get", "/lab/tune", "int", "--timeout", "2", status=1)
    assert "there is no node '/lab/tune' in domain" in said and "did you mean '/lab/tuned'" in said


def test_set_of_every_type(uros, peer, reset):
    pairs = {
        "bool": ("off", 1, False),
        "int": ("0x10", 2, 16),
        "double": ("-0.5", 3, "-0.5"),
        "text": ("a: b: c", 4, "a: b: c"),
        "digits": ("'7'", 4, "7"),
        "octets": ("[!!binary AQ==]", 5, [1]),
        "arm.bools": ("[]", 6, []),
        "arm.ints": ("[]", 7, []),
        "arm.left.doubles": ("[1.0, .nan]", 8, "[1.0, nan]"),
        "arm.left.texts": ('["1", ☃]', 9, ["1", "☃"]),
        "any": ("now text", 4, "now text"),
    }
    words = [word for name, (text, *_) in pairs.items() for word in (name, text)]
    printed = uros("param", "set", TUNED, *words)
    assert printed.splitlines() == [f"Set parameter {name} successful" for name in pairs]
    values = peer.do("values")["values"]
    assert {name: values[name] for name in pairs} == {n: list(p[1:]) for n, p in pairs.items()}
    assert uros("param", "set", "--", TUNED, "double", "-.inf") == "Set parameter successful\n"


def test_what_a_node_refuses_is_not_set_and_the_reason_is_printed(uros, peer, reset):
    before = peer.do("values")["values"]
    said = uros("param", "set", TUNED, "fixed", "2", status=1)
    assert said.startswith("Setting parameter failed: ") and "read-only" in said
    said = uros("param", "set", TUNED, "text", "forbidden", status=1)
    assert said == "Setting parameter failed: forbidden \\x1b[2J is refused\n"
    said = uros("param", "set", TUNED, "double", "1", status=1)
    assert "double is of the type double, and the value of the type integer; write 1.0" in said
    said = uros("param", "set", TUNED, "dubble", "1.0", status=1)
    assert "has no parameter 'dubble'; did you mean 'double'?" in said
    assert "out of range" in uros("param", "set", TUNED, "speed", "7.0", status=1).lower()
    assert peer.do("values")["values"] == before
    said = uros("param", "set", TUNED, "int", "5", "fixed", "2", status=1)
    assert said.startswith("Set parameter int successful\nSet parameter fixed failed: ")
    said = uros("param", "set", TUNED, "--atomic", "int", "6", "fixed", "2", status=1)
    assert said.count("failed: ") == 2
    assert peer.do("values")["values"]["int"] == [2, 5]


def test_delete(uros, peer, reset):
    assert uros("param", "delete", TUNED, "any") == "Deleted parameter successfully\n"
    said = uros("param", "delete", TUNED, "int", status=1)
    assert said.startswith("Deleting parameter failed: ")
    said = uros("param", "delete", TUNED, "any", status=1)
    assert "/lab/tuned has no parameter 'any'" in said


def test_values_mean_what_they_mean_to_rclpy(peer):
    """rclpy raises for some texts; they are strings here."""
    for text, theirs in zip(TEXTS, peer.do("typed", texts=TEXTS)["typed"], strict=True):
        ours = from_text(text)
        if theirs is None:
            assert (ours.kind, ours.value) == (4, text)
        elif theirs[0] in (3, 8):
            assert ours.kind == theirs[0] and str(ours.value) == str(theirs[1]), text
        else:
            assert [ours.kind, plain(ours)] == theirs, text


# --- files ----------------------------------------------------------------------------------------


def test_dump_is_read_by_rclpy_rcl_and_uros(uros, peer, reset, tmp_path):
    """What is printed is loaded again; a node that is started with it has the same parameters."""
    before = peer.do("values")["values"]
    file = tmp_path / "tuned.yaml"
    dumped = uros("param", "dump", TUNED)
    assert dumped.startswith(
        "/lab/tuned:\n  ros__parameters:\n    any: 1\n    arm:\n      bools:\n"
    )
    assert '    text: "gr\\xFCn\\tline\\nend\\e[2J \\u202E"\n' in dumped
    file.write_text(dumped)
    words = ("bool", "off", "int", "9", "text", "other", "arm.ints", "[5]", "octets", "[]")
    uros("param", "set", TUNED, *words)
    printed = uros("param", "load", TUNED, file, status=1).splitlines()
    failed = [line.split()[2] for line in printed if " failed: " in line]
    assert len(printed) == len(before)
    assert failed == ["fixed", "start_type_description_service"]  # are read-only
    assert peer.do("values")["values"] == before
    # rcl has no bytes in files
    octets = "    octets:\n    - !!binary |\n      AA==\n    - !!binary |\n      /w==\n"
    text = dumped.replace(octets, "")
    assert text != dumped
    file.write_text(text)
    started = peer.do("started", path=str(file), name="tuned", namespace="/lab")["found"]
    wanted = {name: value for name, value in before.items() if name != "octets"}
    assert {name: started[name] for name in wanted} == wanted
    lines = text.splitlines(keepends=True)  # rclpy cannot read the escape sequence
    file.write_text("".join(line for line in lines if not line.startswith("    text: ")))
    theirs = peer.do("file", path=str(file), node=TUNED)["found"]
    same = ("bool", "int", "double", "arm.bools", "arm.ints", "count", "fixed", "speed")
    assert {name: theirs[name] for name in same} == {name: before[name] for name in same}


def test_load_says_what_is_set_and_what_is_not(uros, peer, reset, tmp_path):
    file = tmp_path / "some.yaml"
    file.write_text(
        "/**: {ros__parameters: {int: 1, bool: false, fixed: 5}}\n"
        "/lab: {tuned: {ros__parameters: {int: 2, arm: {ints: []}, text: null}}}\n"
    )
    assert uros("param", "load", TUNED, file, status=1).splitlines()[:4] == [
        "Set parameter int successful",
        "Set parameter bool successful",
        "Set parameter arm.ints successful",
        f"WARNING: text has no value in {file}, and is left as it is",
    ]
    values = peer.do("values")["values"]
    assert (values["int"], values["bool"], values["arm.ints"]) == ([2, 2], [1, False], [7, []])
    assert uros("param", "load", TUNED, file, "--no-use-wildcard").splitlines() == [
        "Set parameter int successful",
        "Set parameter arm.ints successful",
    ]


# --- boards ---------------------------------------------------------------------------------------


@pytest.fixture(params=["host", "board"])
def motor(request, domain):
    """A node of uros: directly on the network, or on an agent, as those of boards."""
    if request.param == "host":
        yield host_node("motor", domain)
        return
    with running_agent("udp", "rtps", domain) as agent:
        transport = UdpTransport("127.0.0.1", agent.transport.port)
        yield Node("motor", transport, domain_id=domain)


def test_parameters_of_a_node_of_uros(uros, motor):
    limits = ParameterDescriptor(
        description="gain", floating_point_range=[FloatingPointRange(0.0, 2.0)]
    )
    motor.declare_parameter("gain", 0.5, limits)
    motor.declare_parameter("pid.limits", [math.inf, -1.0])
    with spinning(motor):
        assert uros("param", "list", "/motor", "--param-type") == (
            "  gain (type: double)\n  pid.limits (type: double array)\n"
        )
        assert uros("param", "set", "/motor", "gain", "1.5") == "Set parameter successful\n"
        assert "out of range" in uros("param", "set", "/motor", "gain", "9.0", status=1)
        assert uros("param", "get", "/motor", "gain") == "Double value is: 1.5\n"
        assert uros("param", "dump", "motor") == (
            "/motor:\n  ros__parameters:\n    gain: 1.5\n    pid:\n      limits:\n"
            "      - .inf\n      - -1.0\n\n"
        )
        assert "    Max value: 2.0" in uros("param", "describe", "/motor", "gain")


def test_a_node_without_parameters(uros, domain):
    node = host_node("bare", domain)
    with spinning(node):
        said = uros("param", "list", "/bare", "--timeout", "2", status=1)
    assert said.startswith("uros: the node /bare has no parameter services; a board has them with")
