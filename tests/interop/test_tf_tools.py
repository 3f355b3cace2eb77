"""``uros tf`` with the transforms of a node of uros in a thread of its own.

The rclpy of these tests has no tf2_msgs, so that no real ROS 2 node can publish transforms here.
"""

import pytest
from support.middleware import host_node
from support.spinning import spinning

from uros.client.tf import StaticTransformBroadcaster, TransformBroadcaster
from uros.interfaces import load
from uros.tools import cli

pytestmark = pytest.mark.timeout(120)

HALF = 0.5**0.5


def transform(parent, child, x, z=0.0, w=1.0):
    message = load("geometry_msgs/msg/TransformStamped")(child_frame_id=child)
    message.header.frame_id = parent
    message.transform.translation.x = x
    message.transform.rotation.z, message.transform.rotation.w = z, w
    return message


@pytest.fixture(scope="module")
def robot(domain):
    """A node that publishes a moving and two static frames, and one that places the last twice."""
    moving = host_node("wheels", domain, namespace="/robot")
    broadcaster = TransformBroadcaster(moving)

    def move():
        placed = transform("odom", "base", 1.0, HALF, HALF)
        placed.header.stamp.sec, placed.header.stamp.nanosec = moving.clock.now()
        broadcaster.sendTransform(placed)

    moving.create_timer(0.05, move)
    static = host_node("mounts", domain)
    StaticTransformBroadcaster(static).sendTransform(
        [transform("base", "laser", 2.0), transform("base", "arm", 3.0)]
    )
    with spinning(moving), spinning(static):
        yield


@pytest.fixture
def uros(domain, capsys):
    """Run a command; return standard output, or both streams where it fails."""

    def run(*arguments, status=0):
        returned = cli.main(["tf", *arguments, "--domain", str(domain)])
        printed = capsys.readouterr()
        assert returned == status, printed
        return printed.out if status == 0 else printed.out + printed.err

    return run


def test_echo_through_moving_and_static_frames(uros, robot):
    lines = uros("echo", "odom", "laser", "--once", "--timeout", "30", "-p", "2").splitlines()
    assert lines[0].startswith("At time ") and int(lines[0].split()[2].split(".")[0]) > 1.7e9
    assert lines[1:3] == [
        "- Translation: [1.00, 2.00, 0.00]",
        "- Rotation: in Quaternion [0.00, 0.00, 0.71, 0.71]",
    ]
    back = uros("echo", "laser", "odom", "--once", "--timeout", "30").splitlines()
    assert back[1] == "- Translation: [-2.000, 1.000, 0.000]"
    beside = uros("echo", "laser", "arm", "--once", "--timeout", "30").splitlines()
    assert beside[:2] == ["At time 0.000000000", "- Translation: [1.000, 0.000, 0.000]"]


def test_echo_names_the_frames_that_there_are(uros, robot):
    said = uros("echo", "odom", "lasr", "--timeout", "3", status=1)
    assert "WARNING: waiting for the transform odom -> lasr: " in said
    assert said.splitlines()[-1] == (
        "uros: no transform within 3 s: there is no frame 'lasr'; did you mean 'laser'?"
        " (frames: arm, base, laser, odom)"
    )


def test_tree(uros, robot):
    lines = uros("tree", "--wait-time", "3").splitlines()
    assert lines[0] == "odom" and lines[2:] == [
        "    ├── arm    /mounts  static",
        "    └── laser  /mounts  static",
    ]
    name, node, rate, unit, age, *_ = lines[1].removeprefix("└── ").split()
    assert (name, node, unit) == ("base", "/robot/wheels", "Hz")
    assert 1 < float(rate) < 25 and float(age) < 5


def test_tree_names_faults(uros, robot, domain):
    other = host_node("other", domain)
    StaticTransformBroadcaster(other).sendTransform(
        [transform("wall", "laser", 2.0), transform("x", "bad", 1.0, 0.0, 0.0)]
    )
    with spinning(other):
        said = uros("tree", "--wait-time", "3", status=1)
    assert "WARNING: the frame laser has several parents: " in said
    assert "base (from /mounts)" in said and "wall (from /other)" in said
    assert "transforms of 'bad' are not used: its quaternion has the length 0" in said
