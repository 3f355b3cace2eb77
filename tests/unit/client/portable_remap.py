"""Remapping rules and node options. Also runs on MicroPython.

CASES were computed by a real rclpy (Kilted); tests/interop/test_client_names_and_qos.py compares
them again.
"""

import os

from support.board import KEY, FakeAgent, FakeClock, Number

from uros.client import Node
from uros.client.remap import Remap, from_arguments, options

# (rules, node, namespace, [asked], (name, namespace, (topic, service) of each))
CASES = (
    (["a:=b"], "node", "/", ["a", "/a", "~/a", "a/a", "x"],
     ("node", "/", "/b", "/b", "/b", "/b", "/node/a", "/node/a", "/a/a", "/a/a", "/x", "/x")),
    (["/a:=/b"], "node", "/ns", ["a", "/a", "b"],
     ("node", "/ns", "/ns/a", "/ns/a", "/b", "/b", "/ns/b", "/ns/b")),
    (["a:=b"], "node", "/ns", ["a", "/a", "/ns/a"],
     ("node", "/ns", "/ns/b", "/ns/b", "/a", "/a", "/ns/b", "/ns/b")),
    (["~/a:=c"], "node", "/ns", ["a", "~/a", "/ns/node/a"],
     ("node", "/ns", "/ns/a", "/ns/a", "/ns/c", "/ns/c", "/ns/c", "/ns/c")),
    (["~/a:=b"], "node", "/", ["~/a", "/node/a"], ("node", "/", "/b", "/b", "/b", "/b")),
    (["a:=~/c"], "node", "/ns", ["a"], ("node", "/ns", "/ns/node/c", "/ns/node/c")),
    (["__node:=other"], "node", "/ns", ["~/a", "a"],
     ("other", "/ns", "/ns/other/a", "/ns/other/a", "/ns/a", "/ns/a")),
    (["__name:=other"], "node", "/ns", ["~/a"], ("other", "/ns", "/ns/other/a", "/ns/other/a")),
    (["__ns:=/x/y"], "node", "/ns", ["~/a", "a"],
     ("node", "/x/y", "/x/y/node/a", "/x/y/node/a", "/x/y/a", "/x/y/a")),
    (["node:a:=b"], "node", "/", ["a"], ("node", "/", "/b", "/b")),
    (["other:a:=b"], "node", "/", ["a"], ("node", "/", "/a", "/a")),
    (["node:__node:=other", "other:a:=b", "node:a:=c"], "node", "/", ["a"],
     ("other", "/", "/b", "/b")),
    (["node:__node:=other", "node:__ns:=/q"], "node", "/", ["a"], ("other", "/", "/a", "/a")),
    (["node:__node:=other", "other:__ns:=/q"], "node", "/", ["a"],
     ("other", "/q", "/q/a", "/q/a")),
    (["a:=b", "a:=c"], "node", "/", ["a", "b"], ("node", "/", "/b", "/b", "/b", "/b")),
    (["a:=b", "b:=c"], "node", "/", ["a", "b"], ("node", "/", "/b", "/b", "/c", "/c")),
    (["rostopic://a:=b"], "node", "/", ["a"], ("node", "/", "/b", "/a")),
    (["rosservice://a:=b"], "node", "/", ["a"], ("node", "/", "/a", "/b")),
    (["node:rosservice://a:=b"], "node", "/", ["a"], ("node", "/", "/a", "/b")),
    (["__node:=a", "__node:=b"], "node", "/ns", ["a"], ("a", "/ns", "/ns/a", "/ns/a")),
    (["a:=a/b"], "node", "/ns", ["a"], ("node", "/ns", "/ns/a/b", "/ns/a/b")),
    (["__ns:=/"], "node", "/ns", ["a"], ("node", "/", "/a", "/a")),
    ([], "node", "/ns", ["{ns}/{node}/q", "{namespace}/x", "x/{node}"],
     ("node", "/ns", "/ns/node/q", "/ns/node/q", "/ns/x", "/ns/x", "/ns/x/node", "/ns/x/node")),
    ([], "node", "/", ["{node}/q"], ("node", "/", "/node/q", "/node/q")),
)  # fmt: skip

BAD = (
    "bad", "a:=", ":=a", "a-b:=c", "a:=1c", "__node:=a/b", "__node:=", "__ns:=x", "__ns:=/1",
    "/ns/*:=b", "a:=b:=c", "/ns/node:a:=b", "{node}/a:=b", "a:={ns}/b", "~:=b",
)  # fmt: skip


def remapped(rules, name="node", namespace="", **more):
    clock = FakeClock()
    return Node(
        name, FakeAgent(clock), namespace, key=KEY, clock=clock, remap=Remap(*rules), **more
    )


def refused(call, *arguments):
    try:
        call(*arguments)
    except ValueError as error:
        return str(error)
    raise AssertionError(arguments)


def test_names_are_those_of_rclpy() -> None:
    for rules, name, namespace, asked, expected in CASES:
        node = remapped(rules, name, namespace)
        full_names = [node.get_name(), node.get_namespace()]
        for asked_name in asked:
            full_names += [
                node.resolve_topic_name(asked_name),
                node.resolve_service_name(asked_name),
            ]
        assert tuple(full_names) == expected, (rules, full_names)


def test_entities_have_remapped_names() -> None:
    class Ask:
        Request = Response = Number
        _TYPE = "test_msgs/srv/Ask"

    node = remapped(["a:=b", "__node:=other", "rosservice://go:=~/went"])
    assert node.create_publisher(Number, "a").name == "/b"
    assert node.create_subscription(Number, "a", print).name == "/b"
    assert node.create_service(Ask, "go", print).name == "/other/went"
    assert node.create_client(Ask, "go").name == "/other/went"
    assert node.get_fully_qualified_name() == "/other"


def test_malformed_rules_are_refused_and_named() -> None:
    for rule in BAD:
        text = refused(Remap, rule)
        assert repr(rule) in text and "remapping rule" in text, text


def test_rules_among_arguments() -> None:
    remap = from_arguments(
        ["prog", "-r", "x:=y", "--ros-args", "-r", "a:=b", "-p", "c:=3", "--remap", "d:=e", "--",
         "-r", "f:=g"]
    )  # fmt: skip
    node = remapped([])
    names = [remap.name(node, topic, False) for topic in ("x", "a", "c", "d", "f")]
    assert names == ["/x", "/b", "/c", "/e", "/f"]
    assert "behind it" in refused(from_arguments, ["--ros-args", "-r"])


def test_options_from_a_dict_and_from_a_file() -> None:
    given = {"name": "talker", "namespace": "/garden", "domain_id": 7, "silence_ms": 5000}
    clock = FakeClock()
    node = Node(transport=FakeAgent(clock), clock=clock, **options(given))
    assert node.get_fully_qualified_name() == "/garden/talker" and node.domain_id == 7
    assert node.connection.silence_ms == 5000
    path = "options_of_a_test.json"
    with open(path, "w") as file:
        file.write('{"name": "talker", "remap": ["chatter:=news"]}')
    try:
        node = Node(transport=FakeAgent(clock), clock=clock, **options(path))
    finally:
        os.remove(path)
    assert node.create_publisher(Number, "chatter").name == "/news"


def test_wrong_options_are_named() -> None:
    for given, text in (
        ([], "object"), ({"nam": 1}, "nam"), ({"name": 1}, "name is a text"),
        ({"domain_id": "1"}, "domain_id is a number"), ({"remap": "a:=b"}, "list of rules"),
        ({"remap": ["a"]}, "remapping rule"),
    ):  # fmt: skip
        assert text in refused(options, given), given
    path = "options_of_a_test.json"
    with open(path, "w") as file:
        file.write("{name")
    try:
        assert path in refused(options, path)
    finally:
        os.remove(path)
    try:
        options("no_such_file.json")
    except OSError:
        pass
    else:
        raise AssertionError("no file")
