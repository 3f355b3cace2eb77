"""What ``uros tf`` prints."""

import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import Net

from uros.host.network import Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools import cli
from uros.tools.tf import echo
from uros.tools.tf.frames import FrameTree, Stamped
from uros.tools.tf.transforms import IDENTITY, Transform
from uros.tools.tf.tree import drawn, faults

S = 1_000_000_000
HALF = 0.5**0.5
NODES = {b"1": "/ekf", b"2": "/arm/publisher"}


def test_a_pose_as_tf2_echo_prints_it():
    quarter = Transform((1.0, -2.5, 0.0), (0.0, 0.0, HALF, HALF))
    assert list(echo._lines(Stamped(quarter, 5 * S + 30), 3)) == [
        "At time 5.000000030",
        "- Translation: [1.000, -2.500, 0.000]",
        "- Rotation: in Quaternion [0.000, 0.000, 0.707, 0.707]",
        "- Rotation: in RPY (radian) [0.000, 0.000, 1.571]",
        "- Rotation: in RPY (degree) [0.000, 0.000, 90.000]",
        "- Matrix:",
        "  0.000 -1.000  0.000  1.000",
        "  1.000  0.000  0.000 -2.500",
        "  0.000  0.000  1.000  0.000",
        "  0.000  0.000  0.000  1.000",
    ]
    assert list(echo._lines(Stamped(IDENTITY, 0), 1))[1] == "- Translation: [0.0, 0.0, 0.0]"


def test_the_tree_and_its_faults():
    tree = FrameTree()

    def add(parent, child, at, writer=b"1", is_static=False):
        tree.add(parent, child, Stamped(IDENTITY, at), at, is_static, writer)

    for tenth in range(11):
        add("map", "odom", tenth * S // 10)
    add("odom", "base", S)
    add("base", "laser", 0, b"2", True)
    add("base", "cam\x1b", 0, b"3", True)
    add("x", "y", 0)
    add("y", "x", 0)
    add("odom", "laser", S, b"2")
    tree.refuse("bad\n", "it has a number that is not finite")
    assert drawn(tree, NODES, 2 * S) == [
        "map",
        "└── odom             /ekf  10.0 Hz  1.000 s old",
        "    ├── base         /ekf  one transform  1.000 s old",
        "    │   └── cam\\x1b  unknown node  static",
        "    └── laser        /arm/publisher  one transform  1.000 s old",
        "loop: x -> y -> x",
    ]
    assert list(faults(tree, NODES)) == [
        "the frame laser has several parents: base (from /arm/publisher) and odom (from"
        " /arm/publisher); let one node place it",
        "the frames x, y are a loop of parents; one of them needs another one",
        "transforms of 'bad\\n' are not used: it has a number that is not finite",
    ]


def test_what_is_missing_is_said_once_until_it_changes(monkeypatch, capsys):
    network = GraphNetwork(Net()).join(monkeypatch)
    kind = load("tf2_msgs/msg/TFMessage")

    def hear(*children):
        message = kind(transforms=[load("geometry_msgs/msg/TransformStamped")() for _ in children])
        for each, child in zip(message.transforms, children, strict=True):
            each.header.frame_id, each.child_frame_id = "map", child
            each.transform.rotation.w = 1.0
        network.listening["/tf"](Received(to_cdr(message), 0, 1, b"1"))

    def nothing():
        pass

    network.script = [nothing, nothing, lambda: hear("odom"), nothing, lambda: hear("base")]
    assert cli.main(["tf", "echo", "map", "base"]) == 0
    captured = capsys.readouterr()
    assert [line.partition(" (frames: ")[2] for line in captured.err.splitlines()] == [
        "none; does a node publish on /tf?)",
        "map, odom)",
    ]
    assert captured.out.startswith("At time 0.0")


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["echo", "map"], "TARGET"),
        (["echo", "map", "base", "0"], "'0' is not a number above 0"),
        (["echo", "map", "base", "-p", "99"], "'99' is more than 17 digits"),
        (["tree", "-t", "x"], "'x' is not a number above 0"),
        (["ech"], "did you mean 'echo'?"),
    ],
)
def test_errors_of_the_command_line(arguments, said, capsys):
    assert cli.main(["tf", *arguments]) == 2
    assert said in capsys.readouterr().err
