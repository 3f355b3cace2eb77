"""What the test suites of ros2's commands check, on a graph of rclpy nodes (`ros2_graph.py`).

`docs/ros2_cases.md` lists those cases. The commands run in this process, on one network that has
discovered the graph: the tests would take minutes otherwise.
"""

import io
import os
import re
import subprocess
from contextlib import nullcontext
from pathlib import Path

import pytest
from support.peer import START_SECONDS

from uros.host import network as network_module
from uros.host.network import Network
from uros.interfaces import load, registry
from uros.tools import cli
from uros.tools.values.plain import constructed

pytestmark = pytest.mark.timeout(120)

SECONDS = 30.0
BASIC = "test_msgs/srv/BasicTypes"
STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TOPICS = {
    "/arrays": "test_msgs/msg/Arrays",
    "/bounded_sequences": "test_msgs/msg/BoundedSequences",
    "/chatter": STRING,
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/complex/arrays": "test_msgs/msg/Arrays",
    "/complex/strings": "test_msgs/msg/Strings",
    "/defaults": "test_msgs/msg/Defaults",
    "/ears": STRING,
    "/managed/transition_event": "lifecycle_msgs/msg/TransitionEvent",
    "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    "/rosout": "rcl_interfaces/msg/Log",
    "/unbounded_sequences": "test_msgs/msg/UnboundedSequences",
}
HIDDEN_TOPICS = {"/_whisper", "/_complex/arrays", "/complex/fibonacci/_action/feedback"}
NODES = [
    "/complex", "/introspected", "/managed", "/repeater", "/robot/configured", "/talker", "/twin",
    "/twin",
]  # fmt: skip
# Of every node of rclpy.
PARAMETER_SERVICES = {
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}
# The order of the fields of Arrays and of both kinds of sequences.
ELEMENTS = [
    ("bool", "boolean"), ("byte", "octet"), ("char", "uint8"), ("float32", "float"),
    ("float64", "double"), *[(name, name) for bits in (8, 16, 32, 64)
                             for name in (f"int{bits}", f"uint{bits}")],
    ("string", "string"),
]  # fmt: skip


@pytest.fixture(scope="module")
def network(ros_python, domain):
    """A network that has discovered the graph."""
    graph = subprocess.Popen(
        [ros_python, Path(__file__).parent / "ros2_graph.py"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=dict(os.environ, ROS_DOMAIN_ID=str(domain)),
    )  # fmt: skip
    try:
        assert graph.stdout.readline() == b"READY\n"
        with Network(domain) as joined:
            assert joined.spin(lambda: is_complete(joined.graph), START_SECONDS)
            yield joined
    finally:
        graph.stdin.close()
        graph.wait(SECONDS)
        graph.stdout.close()


def is_complete(graph):
    services = graph.services()
    return (
        set(NODES) <= set(graph.nodes())
        and set(TOPICS) | HIDDEN_TOPICS <= set(graph.topics())
        and all(f"{node}/{name}" in services for node in NODES for name in PARAMETER_SERVICES)
    )


@pytest.fixture
def uros(network, monkeypatch, capsys):
    """Runs a command line to its end; returns the exit status, the output and the errors."""
    subscriptions = []

    def listen(*arguments):
        end = Network.listen(network, *arguments)
        subscriptions.append(end)
        return end

    def run(*words):
        status = cli.main([*words])
        while subscriptions:  # a command of its own process ends them by leaving
            subscriptions.pop()()
        return (status, *capsys.readouterr())

    monkeypatch.setattr(network, "listen", listen)
    monkeypatch.setattr(network, "settle", lambda *_: None)  # it is, see is_complete
    monkeypatch.setattr(network_module, "Network", lambda *_: nullcontext(network))
    return run


def check(uros, words, lines, status=0):
    """Run a command; each line of its output is one of ``lines``: a text, or a pattern."""
    done, out, err = uros(*words.split(" ") if isinstance(words, str) else words)
    assert done == status, err
    shown = out.splitlines()
    assert len(shown) == len(lines), out
    for line, expected in zip(shown, lines, strict=True):
        assert expected.fullmatch(line) if isinstance(expected, re.Pattern) else expected == line
    return err


def ids(case):
    return case if isinstance(case, str) else None


# --- topic ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words, lines",
    [
        ("topic list", list(TOPICS)),
        ("topic list -t", [f"{name} [{kind}]" for name, kind in TOPICS.items()]),
        ("topic list -c", [str(len(TOPICS))]),
        (
            "topic list -v",
            [
                "Published topics:",
                *[
                    re.compile(rf" \* {name} \[{kind}\] (1 publisher|\d+ publishers)")
                    for name, kind in TOPICS.items()
                    if name not in ("/complex/strings", "/ears")
                ],
                "",
                "Subscribed topics:",
                " * /complex/strings [test_msgs/msg/Strings] 1 subscriber",
                f" * /ears [{STRING}] 2 subscribers",
                "",
            ],
        ),
        (
            "topic info /chatter",
            [f"Type: {STRING}", "Publisher count: 1", "Subscription count: 0"],
        ),
        (
            "topic info -v /chatter",
            [
                f"Type: {STRING}", "", "Publisher count: 1", "",
                "Node name: talker", "Node namespace: /", f"Topic type: {STRING}",
                f"Topic type hash: {STRING_HASH}", "Endpoint type: PUBLISHER",
                re.compile(r"GID: [0-9a-f]{2}(\.[0-9a-f]{2})*"), "QoS profile:",
                "  Reliability: RELIABLE", "  History (Depth): UNKNOWN", "  Durability: VOLATILE",
                "  Lifespan: Infinite", "  Deadline: Infinite", "  Liveliness: AUTOMATIC",
                "  Liveliness lease duration: Infinite", "", "Subscription count: 0", "",
            ],
        ),
    ],
    ids=ids,
)  # fmt: skip
def test_topic_listings(uros, words, lines):
    assert check(uros, words, lines) == ""


def test_hidden_topics_are_listed_on_demand(uros):
    done, out, _ = uros("topic", "list", "--include-hidden-topics")
    assert done == 0 and set(TOPICS) | HIDDEN_TOPICS <= set(out.splitlines())


def test_an_unknown_topic_has_no_info(uros):
    assert "there is no topic '/unknown_topic'" in check(uros, "topic info /unknown_topic", [], 1)


@pytest.mark.parametrize(
    "words, lines",
    [
        ("/chatter", [re.compile(r"data: 'Hello World: \d+'"), "---"]),
        ("/_whisper", ["data: psst", "---"]),
        ("--no-str /chatter", [re.compile(r"data: '<string length: <\d+>>'"), "---"]),
        ("--truncate-length 5 /chatter", ["data: Hello...", "---"]),
        (
            "--csv /defaults",
            [
                "True,b'2',100,1.125,1.125,-50,200,-1000,2000,-30000,60000,-40000000,50000000",
            ],
        ),
        ("/arrays --field alignment_check", ["0", "---"]),
        ("/cmd_vel --field twist.linear", ["x: 1.0", "y: 0.0", "z: 0.0", "---"]),
        (
            "--raw /_whisper",
            [r"b'\x00\x01\x00\x00\x05\x00\x00\x00psst\x00\x00\x00\x00'", "---"],
        ),
        ("/_whisper std_msgs/String", ["data: psst", "---"]),
        (
            "/_whisper --qos-reliability best_effort --qos-durability volatile",
            ["data: psst", "---"],
        ),
    ],
    ids=ids,
)  # fmt: skip
def test_topic_echo(uros, words, lines):
    check(uros, f"topic echo --once {words}", lines)


@pytest.mark.parametrize(
    "topic, described",
    [
        ("/arrays", "<array type: {}[3]>"),
        ("/unbounded_sequences", "<sequence type: {}, length: {}>"),
        ("/bounded_sequences", "<sequence type: {}[3], length: {}>"),
    ],
    ids=ids,
)
def test_topic_echo_without_arrays(uros, topic, described):
    nested = [("basic_types", "test_msgs/msg/BasicTypes"), ("constants", "test_msgs/msg/Constants"),
              ("defaults", "test_msgs/msg/Defaults")]  # fmt: skip
    lines = [f"{name}_values: '{described.format(of, 0)}'" for name, of in [*ELEMENTS, *nested]]
    lines += [f"{name}_values_default: '{described.format(of, 3)}'" for name, of in ELEMENTS]
    check(uros, f"topic echo --once --no-arr {topic}", [*lines, "alignment_check: 0", "---"])


@pytest.mark.parametrize("field, status", [("not_member", 1), ("/", 2), (".", 2)])
def test_topic_echo_of_a_field_that_there_is_not(uros, field, status):
    err = check(uros, f"topic echo --once /arrays --field {field}", [], status)
    assert "--field" in err and field in err


def test_topic_echo_times_out(uros):
    """Unlike ros2, with exit status 1: a script can tell that nothing came."""
    check(uros, f"topic echo --timeout 0.1 /ears {STRING}", [], 1)
    check(uros, "topic echo --timeout 0.1 /nobody", [], 1)


def test_topic_echo_of_incompatible_publishers(uros):
    words = "topic echo --timeout 0.3 /chatter --qos-durability transient_local"
    assert "volatile publishers do not match" in check(uros, words, [], 1)


def publishing(number, text):
    return [f"publishing #{number}: std_msgs.msg.String(data='{text}')", ""]


BEGIN = "publisher: beginning loop"
LATCHED = "--qos-durability transient_local --qos-reliability reliable"


@pytest.mark.parametrize(
    "words, lines",
    [
        (f"--once {LATCHED} /ears {STRING}", [BEGIN, *publishing(1, "hey")]),
        (f"--once -w 2 {LATCHED} /ears {STRING}", [BEGIN, *publishing(1, "hey")]),
        (
            f"-t 2 -r 100 --max-wait-time-secs 20 {LATCHED} /ears {STRING}",
            [BEGIN, *publishing(1, "hey"), *publishing(2, "hey")],
        ),
        (
            f"-t 5 -r 100 -w 0 /p1 {STRING}",
            [BEGIN, *[line for n in range(1, 6) for line in publishing(n, "hey")]],
        ),
        (
            f"-t 4 -p 2 -r 100 -w 0 /p2 {STRING}",
            [BEGIN, *publishing(2, "hey"), *publishing(4, "hey")],
        ),
    ],
    ids=ids,
)
def test_topic_pub(uros, words, lines):
    shown = ["topic", "pub", *words.split(" "), "{data: hey}", "--keep-alive", "0.01"]
    done, out, err = uros(*shown)
    waited = [line for line in out.splitlines() if not line.startswith("Waiting for at least")]
    assert (done, waited) == (0, lines), err


def test_topic_pub_waits_no_longer_than_it_may(uros):
    words = f"topic pub -t 5 --max-wait-time-secs 0.2 /nobody {STRING}"
    err = check(uros, words, ["Waiting for at least 1 matching subscription(s)..."] * 2, 1)
    assert "timed out waiting for subscribers: 1 expected, 0 there" in err
    err = check(uros, f"topic pub --max-wait-time-secs 1 /nobody {STRING}", [], 1)
    assert "--max-wait-time-secs goes with -w, --once or --times" in err


# --- node -----------------------------------------------------------------------------


def own_services(name):
    """What `node info` prints of the services that every node has."""
    return [re.compile(rf"    {name}/\w+: \w+/srv/\w+")] * (len(PARAMETER_SERVICES) + 1)


def test_node_list(uros):
    assert "same name" in check(uros, "node list", NODES)
    check(uros, "node list -c", [str(len(NODES))])
    done, out, _ = uros("node", "list", "-a")
    own = re.compile(r"/_uros_\d+\n")
    hidden = ["/_complex", "/_managed"]
    assert done == 0 and own.sub("", out).splitlines() == [*hidden, *NODES]
    check(uros, "node list -c -a", [str(len(NODES) + len(hidden) + 1)])


def test_node_info(uros):
    check(
        uros, "node info /complex",
        [
            "/complex",
            "  Subscribers:", "    /complex/strings: test_msgs/msg/Strings",
            "  Publishers:", "    /complex/arrays: test_msgs/msg/Arrays",
            "    /parameter_events: rcl_interfaces/msg/ParameterEvent",
            "    /rosout: rcl_interfaces/msg/Log",
            "  Service Servers:", f"    /complex/basic: {BASIC}", *own_services("/complex"),
            "  Service Clients:", "",
            "  Action Servers:", "    /complex/fibonacci: test_msgs/action/Fibonacci",
            "  Action Clients:", "",
        ],
    )  # fmt: skip


def test_node_info_of_a_hidden_node(uros):
    err = check(uros, "node info /_complex", [], 1)
    assert err == "uros: the node '/_complex' is hidden: --include-hidden prints it\n"
    done, out, _ = uros("node", "info", "/_complex", "--include-hidden")
    assert done == 0 and "    /_complex/arrays: test_msgs/msg/Arrays\n" in out
    assert "    /_complex/fibonacci: test_msgs/action/Fibonacci\n" in out


def test_node_info_of_one_of_several_nodes(uros):
    done, out, err = uros("node", "info", "/twin")
    assert done == 0 and out.startswith("/twin\n  Subscribers:\n")
    assert "2 nodes have the name '/twin'" in err


# --- service ----------------------------------------------------------------------------


def test_service_list(uros):
    _, out, _ = uros("service", "list")
    listed = out.splitlines()
    assert [name for name in listed if name.startswith("/robot/")] == sorted(
        f"/robot/configured/{name}" for name in [*PARAMETER_SERVICES, "get_type_description"]
    )
    assert "/complex/basic" in listed and not [name for name in listed if "/_" in name]
    check(uros, "service list -c", [str(len(listed))])
    _, out, _ = uros("service", "list", "-t")
    assert f"/complex/basic [{BASIC}]" in out.splitlines() and len(out.splitlines()) == len(listed)
    _, out, _ = uros("service", "list", "--include-hidden-services")
    assert set(listed) | {"/_complex/basic"} <= set(out.splitlines())


@pytest.mark.parametrize(
    "words, lines, status",
    [
        (f"find {BASIC}", ["/complex/basic", "/introspected/echo"], 0),
        (
            f"find --include-hidden-services {BASIC}",
            ["/_complex/basic", "/complex/basic", "/introspected/echo"],
            0,
        ),
        (f"find -c {BASIC}", ["2"], 0),
        ("find not_a_service_type", [], 0),
        ("type /complex/basic", [BASIC], 0),
        ("type /not_a_service", [], 1),
    ],
    ids=ids,
)
def test_service_find_and_type(uros, words, lines, status):
    err = check(uros, f"service {words}", lines, status)
    if "not_a_service_type" in words:
        assert "no definition of the type not_a_service_type" in err


FIELDS = [
    {},
    {"bool_value": False, "int32_value": -1, "float64_value": 0.1, "string_value": "bazbar"},
]


@pytest.mark.parametrize("fields", FIELDS, ids=str)
def test_service_call(uros, fields):
    kind = load(BASIC)
    text = "{" + ", ".join(f"{name}: {value}" for name, value in fields.items()) + "}"
    words = ["service", "call", "/complex/basic", BASIC, *([text] if fields else [])]
    request, response = kind.Request(**fields), kind.Response(**fields)
    check(
        uros, words,
        [f"requester: making request: {constructed(request)}", "", "response:",
         constructed(response), ""],
    )  # fmt: skip


# --- action -----------------------------------------------------------------------------

FIBONACCI = "test_msgs/action/Fibonacci"
ACTION = "/complex/fibonacci"
HIDDEN_ACTION = "/_complex/fibonacci"
ACTION_INFO = [f"Action: {ACTION}", "Action clients: 0", "Action servers: 1"]


@pytest.mark.parametrize(
    "words, lines",
    [
        ("list", [HIDDEN_ACTION, ACTION]),  # as in ros2
        ("list -t", [f"{HIDDEN_ACTION} [{FIBONACCI}]", f"{ACTION} [{FIBONACCI}]"]),
        ("list -c", ["2"]),
        (f"info {ACTION}", [*ACTION_INFO, "    /complex"]),
        (f"info -t {ACTION}", [*ACTION_INFO, f"    /complex [{FIBONACCI}]"]),
        (f"info -c {ACTION}", ACTION_INFO),
        (
            "info /not_an_action",
            ["Action: /not_an_action", "Action clients: 0", "Action servers: 0"],
        ),
        (f"type {ACTION}", [FIBONACCI]),
        (f"find {FIBONACCI}", [HIDDEN_ACTION, ACTION]),
        (f"find -c {FIBONACCI}", ["2"]),
    ],
    ids=ids,
)
def test_action_listings(uros, words, lines):
    check(uros, f"action {words}", lines)


@pytest.mark.parametrize("flag", ["", "-f"])
def test_action_send_goal(uros, flag):
    def shown(title, count):
        numbers = [0, 1, 1, 2, 3, 5][:count]
        return [f"{title}:", "    sequence:", *[f"- {number}" for number in numbers], ""]

    words = ["action", "send_goal", ACTION, FIBONACCI, "{order: 5}", *([flag] if flag else [])]
    feedback = [line for count in range(3, 7) for line in shown("Feedback", count)]
    check(
        uros, words,
        [
            "Waiting for an action server to become available...", "Sending goal:",
            "     order: 5", "", re.compile(r"Goal accepted with ID: [0-9a-f]{32}"), "",
            *(feedback if flag else []), *shown("Result", 6),
            "Goal finished with status: SUCCEEDED",
        ],
    )  # fmt: skip


# --- param ------------------------------------------------------------------------------

PARAMETERS = [
    "arm.hand.name", "arm.length", "flag", "flags", "number", "numbers", "ratio", "ratios",
    "start_type_description_service", "text", "texts", "use_sim_time",
]  # fmt: skip
CONFIGURED = "/robot/configured"
DUMPED = """\
/robot/configured:
  ros__parameters:
    arm:
      hand:
        name: left
      length: 0.75
    flag: true
    flags:
    - false
    - true
    number: 42
    numbers:
    - 1
    - 2
    - 3
    ratio: 1.25
    ratios:
    - 0.5
    - 6.25
    start_type_description_service: true
    text: Hello World
    texts:
    - a
    - b c
    use_sim_time: false

"""


@pytest.mark.parametrize(
    "words, lines",
    [
        (f"list {CONFIGURED}", [f"  {name}" for name in PARAMETERS]),
        (f"list {CONFIGURED} --filter flag.*", ["  flag", "  flags"]),
        (f"dump {CONFIGURED}", DUMPED.splitlines()),
        ("get --include-hidden-nodes /_complex use_sim_time", ["Boolean value is: False"]),
    ],
    ids=ids,
)
def test_param_listings(uros, words, lines):
    check(uros, f"param {words}", lines)


@pytest.mark.parametrize("words", ["list", "dump", "load"])
def test_param_of_nodes_that_there_are_not(uros, tmp_path, words):
    file = tmp_path / "some.yaml"
    file.write_text("/**:\n  ros__parameters:\n    text: any\n")
    for node in ("invalid_node", "invalid_ns/configured"):
        line = ["param", words, "--timeout", "0.1", node, *([str(file)] if words == "load" else [])]
        assert f"there is no node '/{node}'" in check(uros, line, [], 1)


def test_param_load_without_its_arguments(uros, tmp_path):
    for line in ("param load", f"param load {CONFIGURED}"):
        assert "required" in check(uros, line, [], 2)
    check(uros, f"param load {CONFIGURED} {tmp_path / 'nowhere.yaml'}", [], 1)


def test_param_load(uros, tmp_path):
    """The values of a node's own section come before those of a wildcard."""
    file = tmp_path / "some.yaml"
    read_only = "    start_type_description_service: true\n"
    changed = DUMPED.replace("42", "-42").replace("Hello World", "Bye").replace("- b c", "- c")

    def load_and_dump(text, *options):
        file.write_text(text)
        done, _, err = uros("param", "load", CONFIGURED, str(file), *options)
        return done, err, uros("param", "dump", CONFIGURED)[1]

    try:
        new = changed.replace(read_only, "")
        assert load_and_dump(new, "--timeout", "3")[::2] == (0, changed)
        wildcard = "/**:\n  ros__parameters:\n    text: Wildcard\n    number: 12345\n"
        assert load_and_dump(wildcard, "--no-use-wildcard")[::2] == (1, changed)
        wild = changed.replace("Bye", "Wildcard").replace("-42", "12345")
        assert load_and_dump(wildcard)[::2] == (0, wild)
        own = f"{CONFIGURED}:\n  ros__parameters:\n    text: Own\n"
        assert load_and_dump(wildcard + own)[::2] == (0, wild.replace("Wildcard", "Own"))
    finally:
        assert load_and_dump(DUMPED.replace(read_only, ""))[::2] == (0, DUMPED)


# --- lifecycle ----------------------------------------------------------------------------

# Transition, its number, and the states at its start and its goal.
TRANSITIONS = """\
configure 1 unconfigured configuring
transition_success 10 configuring inactive
transition_failure 11 configuring unconfigured
transition_error 12 configuring errorprocessing
cleanup 2 inactive cleaningup
transition_success 20 cleaningup unconfigured
transition_failure 21 cleaningup inactive
transition_error 22 cleaningup errorprocessing
activate 3 inactive activating
transition_success 30 activating active
transition_failure 31 activating inactive
transition_error 32 activating errorprocessing
deactivate 4 active deactivating
transition_success 40 deactivating inactive
transition_failure 41 deactivating active
transition_error 42 deactivating errorprocessing
shutdown 5 unconfigured shuttingdown
shutdown 6 inactive shuttingdown
shutdown 7 active shuttingdown
transition_success 50 shuttingdown finalized
transition_failure 51 shuttingdown finalized
transition_error 52 shuttingdown errorprocessing
transition_success 60 errorprocessing unconfigured
transition_failure 61 errorprocessing finalized
transition_error 62 errorprocessing finalized
""".splitlines()


def transitions(*numbers):
    """The lines of these transitions, or of all."""
    return [
        line
        for name, number, start, goal in map(str.split, TRANSITIONS)
        if not numbers or int(number) in numbers
        for line in (f"- {name} [{number}]", f"\tStart: {start}", f"\tGoal: {goal}")
    ]


@pytest.mark.parametrize(
    "words, lines",
    [
        ("nodes", ["/managed"]),
        ("nodes -a", ["/_managed", "/managed"]),
        ("nodes -c", ["1"]),
        ("nodes -a -c", ["2"]),
        ("get /managed", ["unconfigured [1]"]),
        ("get", ["/managed: unconfigured [1]"]),
        ("get --include-hidden-nodes /_managed", ["unconfigured [1]"]),
        ("get /_managed", ["unconfigured [1]"]),
        ("list managed", transitions(1, 5)),
        ("list managed -a", transitions()),
        ("list --include-hidden-nodes _managed -a", transitions()),
    ],
    ids=ids,
)
def test_lifecycle_listings(uros, words, lines):
    check(uros, f"lifecycle {words}", lines)


@pytest.mark.parametrize("words", ["get /nothing", "list nothing -a", "set /nothing configure"])
def test_lifecycle_of_nodes_that_there_are_not(uros, words):
    assert "there is no node '/nothing'" in check(uros, f"lifecycle {words} --timeout 0.1", [], 1)


def test_lifecycle_of_a_transition_that_there_is_not(uros):
    done, out, err = uros("lifecycle", "set", "/managed", "noop")
    assert done == 1 and "configure" in out + err and "shutdown" in out + err


def test_lifecycle_of_a_node(uros):
    for state, transition in (
        ("unconfigured [1]", "configure"), ("inactive [2]", "activate"),
        ("active [3]", "deactivate"), ("inactive [2]", "cleanup"), ("unconfigured [1]", ""),
    ):  # fmt: skip
        check(uros, "lifecycle get --include-hidden-nodes /_managed", [state])
        if transition:
            words = f"lifecycle set --include-hidden-nodes /_managed {transition}"
            check(uros, words, ["Transitioning successful"])


# --- interface ------------------------------------------------------------------------------

NAME = re.compile(r"    \w+/(msg|srv|action)/\w+")
KINDS = {"-m": ("Messages:", "msg"), "-s": ("Services:", "srv"), "-a": ("Actions:", "action")}
SAMPLES = {
    "msg": ["BasicTypes", "Constants", "Strings"],
    "srv": ["Arrays", "BasicTypes", "Empty"],
    "action": ["Fibonacci"],
}


@pytest.mark.parametrize("flag", ["", *KINDS])
def test_interface_list_and_packages(capsys, flag):
    titles = [title for option, (title, _) in KINDS.items() if flag in ("", option)]
    kinds = [kind for option, (_, kind) in KINDS.items() if flag in ("", option)]
    assert cli.main(["interface", "list", *([flag] if flag else [])]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if not NAME.fullmatch(line)] == titles
    assert {NAME.fullmatch(line)[1] for line in lines if line not in titles} == set(kinds)
    for kind in kinds:
        assert {f"    test_msgs/{kind}/{name}" for name in SAMPLES[kind]} <= set(lines)
    assert cli.main(["interface", "packages", *([flag] if flag else [])]) == 0
    packages = capsys.readouterr().out.splitlines()
    assert "test_msgs" in packages and ("std_msgs" in packages) == ("msg" in kinds)


@pytest.mark.parametrize("flag", ["", *KINDS])
def test_interface_package(capsys, flag):
    kinds = [kind for option, (_, kind) in KINDS.items() if flag in ("", option)]
    assert cli.main(["interface", "package", "test_msgs", *([flag] if flag else [])]) == 0
    names = capsys.readouterr().out.splitlines()
    assert {name.split("/")[1] for name in names} == set(kinds)
    for kind in kinds:
        assert {f"test_msgs/{kind}/{name}" for name in SAMPLES[kind]} <= set(names)


def test_interfaces_that_there_are_not(capsys):
    for words, said in (
        ("package not_a_package", "there is no package 'not_a_package'"),
        ("show not_a_package/msg/String", "not_a_package"),
        ("show test_msgs/msg/NotAMessageTypeName", "test_msgs/msg/NotAMessageTypeName"),
    ):
        assert cli.main(["interface", *words.split(" ")]) == 1
        out, err = capsys.readouterr()
        assert out == "" and said in err


INNER = (
    "# A short type\n# A constant\nbool ON=true # the first\n"
    "\nbool value\nbool[<=3] values # last\n# The end\n"
)
OUTER = "# A nested type\nInner inner # a comment\n# The end\n"
NESTED = {
    "": ["Inner inner # a comment", "\tbool ON=true", "\tbool value", "\tbool[<=3] values"],
    "--all-comments": [
        "Inner inner # a comment", "\t# A short type", "\t# A constant",
        "\tbool ON=true # the first", "\t", "\tbool value", "\tbool[<=3] values # last",
        "\t# The end",
    ],
    "--no-comments": ["Inner inner", "\tbool ON=true", "\tbool value", "\tbool[<=3] values"],
}  # fmt: skip


@pytest.fixture
def no_added_types(monkeypatch):
    """Forgets at the end which types a test has added."""
    monkeypatch.setattr(registry, "_added", {})
    registry._definition.cache_clear()
    yield
    registry._definition.cache_clear()


@pytest.mark.usefixtures("no_added_types")
@pytest.mark.parametrize("flag", NESTED)
@pytest.mark.parametrize("kind", ["msg", "srv", "action"])
def test_interface_show(tmp_path, capsys, kind, flag):
    """Comments of nested types are printed on demand; all comments can be left out."""
    package = tmp_path / "shown_msgs"
    for folder, name, text in (
        ("msg", "Inner", INNER), ("msg", "Outer", OUTER),
        ("srv", "Outer", f"{OUTER}---\n# Response\nbool done # it is\n"),
        ("action", "Outer", f"{OUTER}---\n# Result\nbool done # it is\n---\nbool[3] bits\n"),
    ):  # fmt: skip
        (package / folder).mkdir(parents=True, exist_ok=True)
        (package / folder / f"{name}.{folder}").write_text(text)
    words = ["interface", "show", f"shown_msgs/{kind}/Outer", "--interfaces", str(package)]
    assert cli.main([*words, *([flag] if flag else [])]) == 0
    bare = flag == "--no-comments"
    first = [*NESTED[flag]] if bare else ["# A nested type", *NESTED[flag], "# The end"]
    answer = "# Response" if kind == "srv" else "# Result"
    second = ["---", *([] if bare else [answer]), "bool done" + ("" if bare else " # it is")]
    third = ["---", "bool[3] bits"]
    lines = first + {"msg": [], "srv": second, "action": second + third}[kind]
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        line.rstrip() for line in lines
    ]


def test_interface_show_reads_the_name_from_standard_input(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("std_msgs/msg/Int8\n"))
    assert cli.main(["interface", "show", "-", "--no-comments"]) == 0
    assert capsys.readouterr().out == "int8 data\n"
