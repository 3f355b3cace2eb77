"""Every verb escapes names, types, messages and lines that contain terminal control characters."""

import io
import json
import os
import subprocess
import sys
import threading
import tty
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.screen import FORGED, HOSTILE, UNENCODABLE, visible_lines
from unit.dashboard.test_pictures import JPEG
from unit.host.test_graph_queries import FAST_DDS, Endpoint, Node
from unit.tools.agent.test_status import client, snapshot

from uros.agent.log import Log
from uros.bag.metadata import TopicMetadata
from uros.bag.writer import BagWriter
from uros.host import network as network_module
from uros.host.graph_queries import Graph
from uros.host.network import Network, Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.middleware.graph import living_nodes
from uros.printable import guarded, printable
from uros.qos import QoSProfile
from uros.tools import cli, demo
from uros.tools.agent import running_agents
from uros.tools.run import listener

STRING = "std_msgs::msg::dds_::String_"
ADD = "example_interfaces::srv::dds_::AddTwoInts_"
LIST = "rcl_interfaces::srv::dds_::ListParameters_"
NAME = HOSTILE + UNENCODABLE
LINE = HOSTILE.replace("\n", "")


@pytest.fixture
def output(capsys):
    """Runs a command line; returns the lines that a terminal shows, of both streams."""

    def run(*arguments, status=None):
        returned = cli.main([*map(str, arguments)])
        printed = capsys.readouterr()
        assert status is None or returned == status, printed
        return visible_lines(printed.out) + visible_lines(printed.err)

    return run


# --- a network with hostile names ---------------------------------------------------------------


class Hostile:
    """A middleware's graph with a participant that announces hostile names."""

    def __init__(self, source):
        self._source = source
        self._participant = FAST_DDS + b"h" * 14
        self._own = {}
        for is_writer in (True, False):
            for topic, kind in (
                (f"rt/{NAME}", STRING),
                ("rt/chatter", STRING),
                ("rt/mixed", f"std_msgs::msg::dds_::{NAME}_"),
                ("rt/mixed", STRING),
                ("rt/typed", f"std_msgs::msg::dds_::{NAME}_"),
                ("rt/image", "sensor_msgs::msg::dds_::CompressedImage_"),
                (f"rq/{NAME}Request", f"{ADD}Request_"),
                (f"rr/{NAME}Reply", f"{ADD}Response_"),
                ("rq/addRequest", f"{ADD}{NAME}_Request_"),
                ("rr/addReply", f"{ADD}{NAME}_Response_"),
                ("rq/evil/list_parametersRequest", f"{LIST}Request_"),
                ("rr/evil/list_parametersReply", f"{LIST}Response_"),
                (f"rt/{NAME}/_action/feedback", f"x::action::dds_::{NAME}_FeedbackMessage_"),
                ("rt/move/_action/feedback", f"x::action::dds_::{NAME}_FeedbackMessage_"),
            ):
                guid = self._participant[:12] + len(self._own).to_bytes(4, "big")
                self._own[guid] = Endpoint(
                    guid, self._participant, is_writer, topic, kind, QoSProfile()
                )
        endpoints = list(self._own)
        self._nodes = [
            Node(f"/{NAME}", NAME, endpoints, endpoints),
            Node("/", "evil", endpoints, endpoints),
            Node("/", "evil", [], []),
        ]

    @property
    def participants(self):
        return {**self._source.participants, self._participant: NAME.encode("utf-8", "replace")}

    @property
    def endpoints(self):
        return {**self._source.endpoints, **self._own}

    @property
    def announced(self):
        return {**self._source.announced, self._participant: self._nodes}


@pytest.fixture
def hostile(monkeypatch, own_domain_id):
    """Replaces the graph by the hostile one; returns the options to join its domain."""
    monkeypatch.setattr(network_module, "Graph", lambda source: Graph(Hostile(source)))
    monkeypatch.setattr(Network, "settle", lambda network, seconds=0.0: None)
    return ["--domain", str(own_domain_id)]


@pytest.fixture
def sends(monkeypatch):
    """Makes a subscription deliver one message, and then raises KeyboardInterrupt."""

    def make(message):
        def listen(network, topic, type_name, qos, on_sample):
            network._samples.append((on_sample, Received(to_cdr(message), 12, 34)))
            return lambda: None

        def spin(network, done, seconds=None):
            while network._samples:
                deliver, received = network._samples.popleft()
                deliver(received)
            if done():
                return True
            raise KeyboardInterrupt

        monkeypatch.setattr(Network, "listen", listen)
        monkeypatch.setattr(Network, "spin", spin)

    return make


def evil_string():
    return load("std_msgs/String")(data=HOSTILE)


# --- the verbs ----------------------------------------------------------------------------------


def topic_list(output, hostile):
    output("topic", "list", "--include-hidden-topics", "--json", *hostile, status=0)
    for options in ([], ["-t"], ["-v"]):
        lines = output("topic", "list", "--include-hidden-topics", *hostile, *options, status=0)
        assert any(printable(NAME) in line for line in lines)


def topic_info(output, hostile):
    for options in ([], ["-v"], ["--json"]):
        output("topic", "info", "/typed", *hostile, *options, status=0)
    output("topic", "info", "/mixt", *hostile, status=1)


def topic_echo(output, hostile, sends):
    sends(evil_string())
    for options in (
        [], ["--csv"], ["--raw"], ["-i"], ["--flow-style"], ["--clear"],
        ["--csv", "--field", "data", "--field", "data"], ["--filter", "m.data"],
    ):  # fmt: skip
        output("topic", "echo", "/chatter", "--once", *hostile, *options, status=0)
    output("topic", "echo", "/mixed", *hostile, status=1)
    output("topic", "echo", "/typed", *hostile, status=1)
    output("topic", "echo", "/typed", "std_msgs/msg/String", "--once", *hostile, status=0)


def plot(output, hostile, sends):
    sends(evil_string())
    output("plot", "/chatter/data", *hostile, status=1)
    output("plot", "/typed/data", *hostile, status=1)
    output("plot", "/nothing/data", *hostile, status=1)


def topic_hz(output, hostile, sends):
    sends(evil_string())
    output("topic", "hz", "/typed", "/mixed", *hostile, status=0)
    output("topic", "hz", "/chatter", "--filter", "m.data", *hostile, status=0)
    output("topic", "hz", "/chatter", "--filter", "int(m.data)", *hostile, status=1)
    output("topic", "hz", "--all", "--filter", "m.data", *hostile, status=0)


def topic_bw(output, hostile, sends):
    sends(evil_string())
    output("topic", "bw", "/typed", "/mixed", *hostile, status=0)
    output("topic", "bw", "--all", "--include-hidden-topics", *hostile, status=0)


def topic_delay(output, hostile, sends):
    sends(load("std_msgs/msg/Header")(frame_id=HOSTILE))
    output("topic", "delay", "/image", *hostile, status=0)
    output("topic", "delay", "/typed", *hostile, status=1)


def topic_find(output, hostile):
    lines = output("topic", "find", "std_msgs/msg/String", *hostile, status=0)
    assert any(printable(NAME) in line for line in lines)
    output("topic", "find", NAME, *hostile, status=0)


def topic_type(output, hostile):
    lines = output("topic", "type", "/typed", *hostile, status=0)
    assert any(printable(NAME) in line for line in lines)
    output("topic", "type", "/typt", *hostile, status=1)


def topic_pub(output, hostile):
    output("topic", "pub", "--times", "2", "-w", "0", "/mixed", "std_msgs/msg/Int32",
           *hostile, status=0)  # fmt: skip
    output("topic", "pub", "/mixed", *hostile, status=1)
    output("topic", "pub", "--once", "-w", "0", "/new", "std_msgs/msg/String",
           json.dumps({"data": HOSTILE[:-1]}), *hostile, status=0)  # fmt: skip


def bag_record(output, hostile, sends, tmp_path):
    sends(evil_string())  # which interrupts the recording
    options = ["-a", "--include-unpublished-topics", "-o", tmp_path / "bag", *hostile]
    lines = output("bag", "record", *options)
    assert any(printable(NAME) in line for line in lines)
    output("bag", "record", LINE, *hostile, status=2)


def bag_play(output, hostile, sends, tmp_path):
    text = HOSTILE.replace("\n", "")
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(TopicMetadata(f"/{text}", "std_msgs/msg/String"))
        writer.add_topic(TopicMetadata("/x", f"std_msgs/msg/{text}", serialization_format=text))
    sends(evil_string())
    lines = output("bag", "play", tmp_path / "bag", *hostile)
    assert sum(printable(text) in line for line in lines) == 2
    output("bag", "play", tmp_path / "bag", "-m", text, *hostile, status=2)
    output("bag", "play", tmp_path / text, *hostile, status=2)


def node_list(output, hostile):
    lines = output("node", "list", "-a", *hostile, status=0)
    assert any(printable(NAME) in line for line in lines)


def node_info(output, hostile):
    for name in ("/evil", f"/{printable(NAME)}/{printable(NAME)}"):
        lines = output("node", "info", name, "--include-hidden", *hostile, status=0)
        assert any(printable(NAME) in line for line in lines)
    output("node", "info", f"/{NAME.replace(FORGED, '')}", *hostile, status=1)


def service_list(output, hostile):
    for option in ("-t", "--json"):
        output("service", "list", option, *hostile, status=0)


def service_type(output, hostile):
    output("service", "type", "/add", *hostile, status=0)
    output("service", "type", "/ad", *hostile, status=1)


def service_find(output, hostile):
    lines = output("service", "find", "example_interfaces/srv/AddTwoInts", *hostile, status=0)
    assert any(printable(NAME) in line for line in lines)


def service_call(output, hostile, monkeypatch):
    from uros.tools.service import call as service_call

    output("service", "call", "/add", *hostile, status=1)
    output("service", "call", "/add", "std_srvs/srv/Trigger", *hostile, status=1)
    # a service whose response has the hostile text
    answer = load("std_srvs/srv/Trigger").Response(message=HOSTILE)
    client = SimpleNamespace(
        match=lambda seconds: None, request=lambda message: 1, close=lambda: None,
        answer=lambda number, seconds: answer,
    )  # fmt: skip
    served = SimpleNamespace(type_name="std_srvs::srv::dds_::Trigger_Request_")
    monkeypatch.setattr(service_call, "find_servers", lambda *_: [served])
    monkeypatch.setattr(service_call, "ServiceClient", lambda *_: client)
    output("service", "call", "/x", "std_srvs/srv/Trigger", *hostile, status=0)


@pytest.fixture
def parameters(monkeypatch):
    """Makes parameter services answer with hostile text; returns the texts by use."""
    from uros.tools.param import node

    texts = {"name": HOSTILE, "value": LINE}

    def answer(kind, **request):
        response = load(f"rcl_interfaces/srv/{kind}").Response()
        value = load("rcl_interfaces/msg/ParameterValue")
        if kind == "ListParameters":
            response.result.names = [texts["name"], "text"]
        elif kind == "GetParameters":
            text = value(type=4, string_value=texts["value"])
            response.values = [
                value(type=9, string_array_value=[HOSTILE]) if name == "list" else text
                for name in request["names"]
            ]
        elif kind == "DescribeParameters":
            descriptor = load("rcl_interfaces/msg/ParameterDescriptor")(
                name=HOSTILE, type=200, description=HOSTILE, additional_constraints=HOSTILE
            )
            response.descriptors = [descriptor]
        elif kind == "SetParameters":
            result = load("rcl_interfaces/msg/SetParametersResult")
            response.results = [
                result(successful=each.name == "good", reason=HOSTILE)
                for each in request["parameters"]
            ]
        return response

    monkeypatch.setattr(
        node.ParameterNode, "_call", lambda self, kind, service, **request: answer(kind, **request)
    )
    monkeypatch.setattr(
        node, "call_all",
        lambda network, calls, seconds: [
            answer(call.kind.Request._TYPE.split("/")[-1].removesuffix("_Request"))
            for call in calls
        ],
    )  # fmt: skip
    return texts


def param_list(output, hostile, parameters):
    for options in ([], ["--param-type"], ["/evil"]):
        lines = output("param", "list", *options, *hostile, status=0)
        assert any(printable(HOSTILE) in line for line in lines)
    output("param", "list", "--json", "--param-type", *hostile, status=0)
    output("param", "list", f"/{NAME.replace(FORGED, '')}", *hostile, status=1)


def param_get(output, hostile, parameters):
    for name in ("text", "list"):
        output("param", "get", "/evil", name, *hostile, status=0)


def param_describe(output, hostile, parameters):
    output("param", "describe", "/evil", "text", *hostile, status=0)
    output("param", "describe", "/evil", "none", *hostile, status=1)


def param_dump(output, hostile, parameters):
    # PyYAML folds long text, within quotes
    parameters.update(name=HOSTILE.replace(FORGED, ""), value=LINE.replace(FORGED, ""))
    output("param", "dump", "/evil", *hostile, status=0)


def param_load(output, hostile, parameters, tmp_path):
    file = tmp_path / "x.yaml"
    file.write_text("/evil: {ros__parameters: {good: 1, bad: 2}}")
    output("param", "load", "/evil", file, *hostile, status=1)
    file.write_text(f"? {json.dumps(HOSTILE)}\n: {{ros__parameters: {{good: 1}}}}\n")
    output("param", "load", "/evil", file, *hostile, status=1)


def param_set(output, hostile, parameters):
    output("param", "set", "/evil", "good", "1", "bad", LINE[:-1], *hostile, status=1)


def param_delete(output, hostile, parameters):
    output("param", "delete", "/evil", "bad", *hostile, status=1)


@pytest.fixture
def states(monkeypatch, parameters):
    """Makes lifecycle services answer with hostile text, as those of parameters."""
    from uros.tools.lifecycle import node

    state = load("lifecycle_msgs/msg/State")(id=1, label=HOSTILE)
    change = load("lifecycle_msgs/msg/TransitionDescription")(start_state=state, goal_state=state)
    change.transition.label = HOSTILE
    answer = SimpleNamespace(available_transitions=[change], success=False)
    monkeypatch.setattr(node, "_has_life_cycle", lambda network, name: True)
    monkeypatch.setattr(
        node, "call_all", lambda network, calls, seconds: [SimpleNamespace(current_state=state)]
    )
    for verb in ("list", "set"):
        module = import_module(f"uros.tools.lifecycle.{verb}")
        monkeypatch.setattr(module, "call", lambda *args, **options: answer)


def lifecycle_nodes(output, hostile, states):
    for options in ([], ["--json"]):
        output("lifecycle", "nodes", "-a", *options, *hostile, status=0)


def lifecycle_list(output, hostile, states):
    lines = output("lifecycle", "list", "/evil", *hostile, status=0)
    assert any(printable(HOSTILE) in line for line in lines)


def lifecycle_get(output, hostile, states):
    output("lifecycle", "get", "/evil", *hostile, status=0)


def lifecycle_set(output, hostile, states):
    output("lifecycle", "set", "/evil", "go", *hostile, status=1)
    output("lifecycle", "set", "/evil", HOSTILE, *hostile, status=1)


def evil_transforms():
    place = load("geometry_msgs/msg/TransformStamped")
    message = load("tf2_msgs/msg/TFMessage")()
    for parent, child, w in (
        (HOSTILE, "b", 1.0), ("other", "b", 1.0), ("c", LINE, 1.0), (LINE, "c", 1.0),
        ("d", HOSTILE, 9.0),
    ):  # fmt: skip
        message.transforms.append(place(child_frame_id=child))
        message.transforms[-1].header.frame_id = parent
        message.transforms[-1].transform.rotation.w = w
    return message


def tf_echo(output, hostile, sends):
    sends(evil_transforms())
    for frames in (("other", "b"), (LINE[:-1], "b")):
        output("tf", "echo", *frames, *hostile, status=0)


def tf_tree(output, hostile, sends, monkeypatch):
    sends(evil_transforms())
    spin = Network.spin

    def spin_once(network, done, seconds=None):
        with suppress(KeyboardInterrupt):
            spin(network, done, seconds)

    monkeypatch.setattr(Network, "spin", spin_once)
    lines = output("tf", "tree", *hostile, status=1)
    assert any(printable(HOSTILE) in line for line in lines)


def service_info(output, hostile):
    for options in ([], ["-v"], ["--json"]):
        output("service", "info", "/add", *hostile, *options, status=0)
    output("service", "info", "/ad", *hostile, status=1)


def service_echo(output, hostile, sends):
    sends(load("std_srvs/srv/Trigger_Event")(
        response=[load("std_srvs/srv/Trigger").Response(message=HOSTILE)]
    ))  # fmt: skip
    for options in ([], ["--csv"], ["--flow-style"]):
        output("service", "echo", "/new", "std_srvs/srv/Trigger", *hostile, *options, status=0)
    output("service", "echo", "/add", *hostile, status=1)
    output("service", "echo", "/ad", *hostile, status=1)


def action_list(output, hostile):
    for options in ([], ["-t"], ["--json"]):
        lines = output("action", "list", *hostile, *options, status=0)
        assert any("owned" in line for line in lines)


def action_info(output, hostile):
    for options in ([], ["-t"], ["--json"]):
        output("action", "info", "/move", *hostile, *options, status=0)
    output("action", "info", "/mov", *hostile, status=0)


def action_type(output, hostile):
    lines = output("action", "type", "/move", *hostile, status=0)
    assert any(printable(NAME) in line for line in lines)
    output("action", "type", "/mov", *hostile, status=1)


def action_find(output, hostile):
    for options in ([], ["--json"]):
        output("action", "find", "x/action/Nothing", *hostile, *options, status=0)


def action_echo(output, hostile, sends):
    sends(evil_string())  # which is no status of goals
    output("action", "echo", "/new", "test_msgs/action/Fibonacci", *hostile, status=0)
    for name in ("/move", "/mov"):
        output("action", "echo", name, *hostile, status=1)


def action_send_goal(output, hostile, monkeypatch):
    """A server with a hostile type, and an action whose goal and result have the hostile text."""
    from uros.tools.action import send_goal

    output("action", "send_goal", "/move", *hostile, "-t", "0.1", status=1)
    result = SimpleNamespace(status=6, result=evil_string())
    goal = SimpleNamespace(
        id=b"", match=lambda seconds: None, send=lambda message: None,
        is_accepted=lambda seconds: True, result=lambda seconds: result,
    )  # fmt: skip
    kind = SimpleNamespace(_TYPE=NAME, Goal=load("std_msgs/String"))
    monkeypatch.setattr(send_goal, "load_action", lambda name: kind)
    monkeypatch.setattr(send_goal, "Goal", lambda *_: nullcontext(goal))
    monkeypatch.setattr(send_goal, "wait_for_server", lambda *_: [NAME])
    text = json.dumps({"data": HOSTILE[:-1]})
    output("action", "send_goal", "/x", "a/action/B", text, *hostile, status=0)
    monkeypatch.setattr(send_goal, "wait_for_server", lambda *_: [NAME, "a/action/B"])
    output("action", "send_goal", "/x", text, *hostile, status=1)


def image_view(output, hostile, sends):
    picture = load("sensor_msgs/msg/CompressedImage")(format=HOSTILE, data=b"no picture")
    picture.header.frame_id = HOSTILE
    sends(picture)
    output("image", "view", "/image", "--no-open", "--port", "0", *hostile, status=0)
    output("image", "view", "/typed", "--no-open", "--port", "0", *hostile, status=0)


def image_save(output, hostile, sends, tmp_path):
    for data in (b"no picture", JPEG):
        picture = load("sensor_msgs/msg/CompressedImage")(format=HOSTILE, data=data)
        picture.header.frame_id = HOSTILE
        sends(picture)
        output("image", "save", "/image", "--count", "1", "--out", tmp_path, *hostile)
    output("image", "save", "/typed", "--count", "1", "--out", tmp_path, *hostile)


def pid(output, monkeypatch):
    import socket

    from uros.tools.rover import pid as pid_view

    connected = threading.Event()

    real = pid_view.Tuning.notes_since

    def notes_since(tuning, last, seconds):
        """Let a rover send the text; raise KeyboardInterrupt when its note was read."""
        if not connected.is_set():
            connected.set()
            rover = socket.create_connection(("127.0.0.1", tuning.port))
            rover.sendall(HOSTILE.encode() + b"\n")
            tuning.rover = rover
        number, fresh = real(tuning, last, seconds)
        if any("HOSTILE" in note or "owned" in note for note in fresh) or last > 1:
            tuning.rover.close()
            raise KeyboardInterrupt
        return number, fresh

    monkeypatch.setattr(pid_view.Tuning, "notes_since", notes_since)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    output("pid", "--no-open", "--port", "0", "--page-port", "0", "--host", "127.0.0.1", status=0)


def run_node(output, capsys):
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=print))
    cli._guard(lambda: listener.Listener.heard(node, evil_string()) or 0)
    visible_lines(capsys.readouterr().out)


def interface_folder(tmp_path):
    folder = tmp_path / "evil_msgs"
    (folder / "msg").mkdir(parents=True)
    comment = " ".join(LINE.replace(FORGED, "").splitlines())
    (folder / "msg" / "Evil.msg").write_text(f"# {comment}\nstring text\n", "utf-8")
    return folder


def interface(*arguments):
    """Run the verb in a process, since loaded definitions stay; return the exit status."""
    command = [sys.executable, "-m", "uros", "interface", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONUTF8": "1"})
    visible_lines(done.stdout.decode("utf-8", "surrogateescape"))
    visible_lines(done.stderr.decode("utf-8", "surrogateescape"))
    return done.returncode


def interface_show(tmp_path):
    folder = interface_folder(tmp_path)
    assert interface("show", "evil_msgs/msg/Evil", "--interfaces", folder) == 0
    (folder / "msg" / "Evil.msg").write_text(f"string {HOSTILE}\n", "utf-8")
    assert interface("show", "evil_msgs/msg/Evil", "--interfaces", folder) == 1


def interface_any(verb):
    def feed(tmp_path):
        folder = interface_folder(tmp_path)
        (folder / "msg" / f"Evil{NAME[:10]}\u202e.msg").write_text("")
        more = {
            "package": ["evil_msgs"], "proto": ["evil_msgs/msg/Evil"],
            "build": ["--for-board", tmp_path / "out", "evil_msgs/msg/Evil"],
        }.get(verb, [])  # fmt: skip
        assert interface(verb, *more, "--interfaces", folder) in (0, 1)

    return feed


def trace(output, tmp_path):
    for file in captures(tmp_path):
        for options in ([], ["--hex"], ["--json"], ["--client", "77"]):
            output("trace", file, *options)


def captures(folder):
    """Yield forged captures."""
    name = NAME
    begin = "8000000000011000585243450100010faaaabbbb8100fc01"
    create = "81800000" + "0101" + "1000" + "000a01000200" + "0a000000"
    named = create + HOSTILE.encode().hex()
    line = {"t": 1.0, "from": "client", "client": 0, "transport": name, "address": name}
    good = folder / "good.jsonl"
    good.write_text(
        "\n".join(json.dumps({**line, "hex": octets}) for octets in (begin, named)) + "\n"
    )
    yield good
    for number, text in enumerate(
        [
            json.dumps({**line, "hex": begin, "from": name}),
            json.dumps({**line, "hex": name}),
            json.dumps({**line, "t": name, "hex": ""}),
            json.dumps({**line, "client": name, "hex": begin}),
            name.encode("utf-8", "replace").decode(),
        ]
    ):
        file = folder / f"bad{number}.jsonl"
        file.write_text(text + "\n")
        yield file


def replay(output, tmp_path):
    for file in captures(tmp_path):
        output("replay", file, "udp4://127.0.0.1:9", "--fast", "--patience", "0.01", status=1)


def board_run(output, tmp_path):
    # The console shows the lines that the program prints.
    (tmp_path / "main.py").write_text(f"print({LINE!r})\nprint({UNENCODABLE!r})\n")
    output("board", "run", "esp32_publisher", "--firmware", tmp_path, "--no-agent",
           "--seconds", "3")  # fmt: skip


def fleet(output, tmp_path):
    (tmp_path / "main.py").write_text(f"raise RuntimeError({HOSTILE!r})\n")
    file = tmp_path / "fleet.toml"
    file.write_text('[[board]]\nrun = "esp32_publisher"\nfirmware = "."\ncount = 2\n')
    output("fleet", file, "--no-agent", "--seconds", "3")
    file.write_text(json.dumps(HOSTILE) + " = 1\n")
    output("fleet", file, status=1)


@contextmanager
def sending(data):
    """A pseudo-terminal on which a board sends the data repeatedly."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ended = threading.Event()

    def send():
        while not ended.wait(0.05):
            try:
                os.read(master, 65536)
            except OSError:
                pass
            try:
                os.write(master, data)
            except OSError:
                pass

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        thread.join()
        os.close(slave)
        os.close(master)


def board_console(output):
    with sending(LINE.encode() + b"\xff\x1b[") as device:
        output("board", "console", "--port", device, "--seconds", "0.5", status=0)


def board_deploy(output, tmp_path, monkeypatch):
    from uros.boards.deploy import raw_repl

    short = raw_repl.Seconds(enter=0.5, attempt=0.1, answer=0.2, run=0.3, long=0.3)
    monkeypatch.setattr(raw_repl, "SECONDS", short)
    (tmp_path / "main.py").write_text("print()\n")
    answers = (
        HOSTILE.encode(),
        b"raw REPL; CTRL-B to exit\r\n>soft reboot\r\n" + HOSTILE.encode(),
        b"raw REPL; CTRL-B to exit\r\n>soft reboot\r\nraw REPL; CTRL-B to exit\r\n>R\x01\x80\0\x04"
        + b"\x04"
        + HOSTILE.encode()
        + b"\x04>",
    )
    for data in answers:
        with sending(data) as device:
            output("board", "deploy", tmp_path, "--port", device, "--no-console", status=1)


def doctor(output, hostile, monkeypatch):
    status = snapshot(clients=[client(nodes=[{"name": NAME, "domain": 3}], address=NAME)])
    status["transports"][0].update(label=NAME, name=NAME)
    status["refused"][0].update(why=NAME, address=NAME)
    agents = [running_agents.RunningAgent(1, Path("x"))]
    monkeypatch.setattr(running_agents, "find_agents", lambda: agents)
    monkeypatch.setattr(running_agents, "ask", lambda *_: status)
    output("doctor", "--report", *hostile, status=0)
    for options in ([], ["--json"]):
        output("doctor", *hostile, "--seconds", "0.1", *options)


def agent_status(output, monkeypatch):
    evil = client(nodes=[{"name": NAME, "domain": 3}], address=NAME)
    evil["endpoints"][0].update(topic=NAME, type=NAME)
    status = snapshot(clients=[evil])
    status["transports"][0].update(label=NAME)
    status["refused"][0].update(why=NAME, address=NAME)
    monkeypatch.setattr(running_agents, "ask", lambda *_: status)
    for agents in ([None], [None, None]):
        monkeypatch.setattr(running_agents, "chosen_agents", lambda pid=None, all=agents: all)
        for options in ([], ["-v"], ["--json"]):
            output("agent", "status", *options, status=0)


def agent(capsys):
    """The log escapes the text of each level."""
    for level in range(1, 7):
        out = io.StringIO()
        Log(6, guarded(out))(level, "part", "function", NAME, NAME)
        assert len(visible_lines(out.getvalue())) == 2


def multicast_receive(output, monkeypatch):
    import socket

    from uros.tools.multicast import receive

    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    sender.sendto(NAME.encode("utf-8", "surrogatepass") + b"\xff", receiver.getsockname())
    sender.close()
    monkeypatch.setattr(receive, "receiver", lambda *_: receiver)
    output("multicast", "receive", status=0)


def demonstration(output, capsys):
    topic = demo._Topic("/sensors/diagnostic", "std_msgs/msg/String", None, demo._Reads())
    topic.heard(Received(to_cdr(evil_string()), 1, 2))
    cli._guard(lambda: demo._summary([topic], False))
    visible_lines(capsys.readouterr().out)


def no_foreign_text(reason):
    """Return the feed of a verb that prints no text from outside; ``reason`` says why."""
    assert reason
    return lambda: None


def bag_any(verb):
    def feed(output, tmp_path):
        for storage in ("mcap", "sqlite3"):
            folder = tmp_path / storage
            event = f"/{HOSTILE}/_service_event"
            with BagWriter(folder, storage, custom_data={HOSTILE: HOSTILE}) as writer:
                for name, kind in ((f"/{HOSTILE}", HOSTILE), (event, f"a/srv/{HOSTILE}_Event")):
                    topic = TopicMetadata(name, kind, serialization_format=HOSTILE)
                    writer.write(writer.add_topic(topic), bytes(60), 5, 5)
            if verb == "info":
                for options in ([], ["-t"], ["-v"], ["--json"], ["--sort", "type"]):
                    output("bag", "info", folder, *options, status=0)
            file = folder / writer.metadata.files[0].path
            output("bag", verb, folder, status=0)
            file.write_bytes(file.read_bytes()[:-30])
            output("bag", verb, folder)
            hostile = folder / "metadata.yaml"
            hostile.write_text(json.dumps({HOSTILE: HOSTILE}))
            output("bag", verb, folder)

    return feed


def bag_convert(output, tmp_path):
    with BagWriter(tmp_path / "in") as writer:
        writer.add_topic(TopicMetadata(f"/{HOSTILE}", HOSTILE))
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic(TopicMetadata(f"/{HOSTILE}", HOSTILE[1:]))
    output("bag", "convert", tmp_path / "in", tmp_path / f"out{LINE}".replace("\0", ""), status=0)
    output("bag", "convert", tmp_path / "in", tmp_path / "other", tmp_path / "no", status=1)
    options = tmp_path / "out.yaml"
    for wrong in ({HOSTILE: 1}, {"uri": 1}, {"uri": "x", "regex": f"({HOSTILE}"}, {"all": HOSTILE}):
        options.write_text(json.dumps({"output_bags": [wrong]}))
        output("bag", "convert", "-i", tmp_path / "in", "-o", options, status=1)


FEEDS = {
    "agent": agent,
    "agent status": agent_status,
    "demo": demonstration,
    "topic list": topic_list,
    "topic info": topic_info,
    "topic echo": topic_echo,
    "topic hz": topic_hz,
    "topic bw": topic_bw,
    "topic delay": topic_delay,
    "topic find": topic_find,
    "topic type": topic_type,
    "topic pub": topic_pub,
    "bag play": bag_play,
    "bag record": bag_record,
    "node list": node_list,
    "node info": node_info,
    "bag convert": bag_convert,
    "bag info": bag_any("info"),
    "bag recover": bag_any("recover"),
    "bag reindex": bag_any("reindex"),
    "image view": image_view,
    "image save": image_save,
    "plot": plot,
    "pid": pid,
    "calibrate": no_foreign_text("it takes numbers of an Odometry alone"),
    "service list": service_list,
    "service type": service_type,
    "service find": service_find,
    "service call": service_call,
    "lifecycle get": lifecycle_get,
    "lifecycle list": lifecycle_list,
    "lifecycle nodes": lifecycle_nodes,
    "lifecycle set": lifecycle_set,
    "tf echo": tf_echo,
    "tf tree": tf_tree,
    "param delete": param_delete,
    "param describe": param_describe,
    "param dump": param_dump,
    "param get": param_get,
    "param list": param_list,
    "param load": param_load,
    "param set": param_set,
    "service info": service_info,
    "service echo": service_echo,
    "action list": action_list,
    "action info": action_info,
    "action type": action_type,
    "action find": action_find,
    "action send_goal": action_send_goal,
    "action echo": action_echo,
    "run": run_node,
    "interface list": interface_any("list"),
    "interface packages": interface_any("packages"),
    "interface package": interface_any("package"),
    "interface show": interface_show,
    "interface proto": interface_any("proto"),
    "interface build": interface_any("build"),
    "trace": trace,
    "replay": replay,
    "board new": no_foreign_text("it prints the user's own names of files"),
    "board stubs": no_foreign_text("it prints the user's own folder, and modules that uros has"),
    "board list": no_foreign_text("its table is in the code"),
    "board run": board_run,
    "board build": no_foreign_text("it reads the user's own program"),
    "board index": no_foreign_text("it prints names of packages, which the parser holds"),
    "board deploy": board_deploy,
    "board console": board_console,
    "fleet": fleet,
    "doctor": doctor,
    "multicast receive": multicast_receive,
    "multicast send": no_foreign_text("it prints a text of the code"),
    "multicast test": no_foreign_text("names of interfaces, which an administrator gives"),
    "completion": no_foreign_text("names that are no ROS names are left out"),
}


def verbs(group=cli._ROOT, words=()):
    for name, member in group.members.items():
        if isinstance(member, cli.Verb):
            yield " ".join((*words, name))
        else:
            yield from verbs(member, (*words, name))


def test_every_verb_has_a_feed():
    assert {*verbs(), "agent status"} == set(FEEDS), "add a feed for a new verb"


@pytest.mark.parametrize("verb", FEEDS)
def test_text_from_outside_is_escaped_on_the_terminal(verb, request):
    feed = FEEDS[verb]
    names = feed.__code__.co_varnames[: feed.__code__.co_argcount]
    feed(*[request.getfixturevalue(name) for name in names])


def test_a_field_of_text_keeps_only_its_line_breaks(capsys, hostile, sends):
    text = "<robot>\n\t<link/>\n</robot>"
    for data, shown in ((text, text), (f"{text}\x1b[2J\r", f"{text}\\x1b[2J\\r")):
        sends(load("std_msgs/String")(data=data))
        assert cli.main(["topic", "echo", "/chatter", "--once", "--field", "data", *hostile]) == 0
        assert capsys.readouterr().out == f"{shown}\n---\n"


def test_the_hostile_network_is_discovered(hostile, own_domain_id):
    """The tests above would also pass with an empty network."""
    with Network(own_domain_id) as network:
        assert len(living_nodes(network.graph._source)) >= 3
        assert f"/{printable(NAME)}" in network.graph.topics()
