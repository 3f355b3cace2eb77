"""Client programs on CPython and MicroPython with a real rclpy node, and with each other."""

import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest
from conftest import ROOT
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr, to_cdr

pytestmark = pytest.mark.timeout(120)

INT32 = "std_msgs/msg/Int32"
STRING = "std_msgs/msg/String"
TWIST = "geometry_msgs/msg/Twist"
IMAGE = "sensor_msgs/msg/CompressedImage"
HARDWARE = "ra6m5_sensor_node"


def program(folder: Path, name: str, peer: str) -> Path:
    """Copy the echo program, and configure its name and that of its peer."""
    shutil.copytree(ROOT / "tests/firmware/echo", folder / name)
    (folder / name / "config.py").write_text(f"NAME = {name!r}\nPEER = {peer!r}\n")
    return folder / name


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def boards(request, tmp_path, domain):
    """The names of two boards that are configured as peers; each has an agent of its own."""
    names = [f"{request.param}_{side}" for side in ("left", "right")]
    with ExitStack() as stack:
        for name, other_name in (names, names[::-1]):
            board = RunningBoard(
                program(tmp_path, name, other_name), board=HARDWARE, engine=request.param,
                link=tmp_path / f"tty_{name}",
            )  # fmt: skip
            stack.enter_context(board)
            stack.enter_context(running_agent("serial", MIDDLEWARE, domain, device=board.path))
        yield names


def samples(type_name):
    """Ten messages of a type, with values at the edges of its range."""
    cls = load_type(type_name)
    for i in range(10):
        message = cls()
        if type_name == INT32:
            message.data = (0, 1, -1, 2**31 - 1, -(2**31), 5, 6, 7, 8, 9)[i]
        elif type_name == STRING:
            message.data = ("", "a", "grüße ☃ 🙂", "x" * 2000, "\n", "5", "6", "7", "8", "9")[i]
        elif type_name == TWIST:
            message.linear.x, message.angular.z = 0.1 * i, -1e300 * i
        else:
            message.header.stamp.sec, message.header.frame_id = i, "myframe"
            message.format = "jpeg"
            message.data = bytes(range(256)) * 58 + bytes(152 + i)
        yield message


def send(peer, topic, message):
    cdr = [to_cdr(message).hex()]
    assert peer.do("publish", topic=topic, type=message._TYPE, cdr=cdr)["subscribers"]


@pytest.mark.parametrize(
    ("name", "type_name"),
    [
        ("number", INT32),
        pytest.param("text", STRING, marks=pytest.mark.slow),
        pytest.param("twist", TWIST, marks=pytest.mark.slow),
        ("picture", IMAGE),
    ],
)
def test_messages_go_to_a_board_and_come_back(boards, peer, name, type_name):
    topic = f"/{boards[0]}/{name}"
    peer.do("subscribe", topic=topic + "_back", type=type_name)
    first, *others = samples(type_name)
    # The returning topic is discovered later, and volatile samples from before are lost.
    while not peer.messages[topic + "_back"]:
        send(peer, topic, first)
        peer.do("node", namespace="/none", name="none", publishers={}, seconds=0.5)
    peer.message(topic + "_back")
    for message in others:
        send(peer, topic, message)
    back = [from_cdr(load_type(type_name), peer.message(topic + "_back")) for _ in others]
    while back[0] == first:  # sent more than once
        back = [*back[1:], from_cdr(load_type(type_name), peer.message(topic + "_back"))]
    assert back == others
    peer.do("unsubscribe", topic=topic + "_back")


def test_two_boards_serve_each_other(boards, peer):
    """Each board calls the other's service and publishes the answers."""
    for name, other_name in (boards, boards[::-1]):
        topic = f"/{name}/answers"
        peer.do("subscribe", topic=topic, type=STRING)
        heard = [from_cdr(load_type(STRING), peer.message(topic)).data for _ in range(4)]
        first = int(heard[0].rstrip("]").rpartition("[")[2])
        assert heard == [f"{n % 2 == 1} {other_name}[{n}]" for n in range(first, first + 4)]
        peer.do("unsubscribe", topic=topic)
