"""A board's log at a real rclpy node, and a board's transforms over DDS.

The rclpy of these tests has no tf2_msgs: transforms are received as CDR, by readers with the QoS of
tf2_ros, and deserialized by rosbags.
"""

import pytest
from rosbags.typesys import Stores, get_typestore
from support.services_board import board_and_peer
from support.variants import slow_except

from uros.host.network import Network
from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.qos import DurabilityPolicy, QoSProfile

pytestmark = pytest.mark.timeout(180)

LOG = "rcl_interfaces/msg/Log"
TF = "tf2_msgs/msg/TFMessage"
STORE = get_typestore(Stores.ROS2_JAZZY)
STATIC = QoSProfile(100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module", params=slow_except(["cpython", "micropython"], "micropython"))
def board(request, ros_python, domain, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rosout")
    with board_and_peer(ros_python, folder, request.param, domain) as both:
        yield both


def lines_until(peer, done):
    """Receive the board's messages on /rosout up to one for which ``done`` is true."""
    lines = []
    while not lines or not done(lines[-1]):
        cdr, now = peer.timed_message("/rosout", 20)
        line = from_cdr(load(LOG), cdr)
        if "camera" in line.name:
            lines.append(line)
            at = line.stamp.sec * 10**9 + line.stamp.nanosec
            assert -0.5e9 < now - at < 30e9, (line, now)
    return lines


def test_the_log_is_received_with_lines_from_before_the_subscription(board):
    """Lines have the node's name, level and time; a throttled line comes about once a second."""
    name, peer = board
    peer.do("topic", topic="/rosout", count=2)  # the peer's own and the board's
    peer.do("subscribe", topic="/rosout", type=LOG, durability="transient_local", depth=100)
    lines = lines_until(peer, lambda line: "tick" in line.msg)
    assert {line.name for line in lines} == {name[1:].replace("/", ".")}
    ticks = [line for line in lines if "tick" in line.msg]
    assert ticks[0].level == 30
    # One a second of ten ticks, by throttle_duration_sec. Ticks are counted: stamps follow the
    # host's clock, which the board's is set by meanwhile, and a busy machine's ticks are late.
    for _ in range(3):
        ticks += lines_until(peer, lambda line: "tick" in line.msg)[-1:]
    numbers = [int(line.msg.split()[1]) for line in ticks[-3:]]
    assert 4 < numbers[2] - numbers[0] <= 22, numbers
    infos = peer.do("topic", topic="/rosout", count=2)["infos"]
    assert len({tuple(sorted(info.items())) for info in infos}) == 1, infos  # as rclpy's own


def test_an_error_of_the_boards_program_is_logged(board):
    name, peer = board
    trap = [("int", 2, 99)]
    peer.do("parameters", node=name, method="set_parameters", parameters=trap, seconds=40)
    lines = lines_until(peer, lambda line: line.level == 40)
    (error,) = [line for line in lines if line.level == 40]
    assert "a callback raised" in error.msg and "99 is a trap" in error.msg
    broken = [("broken", 1, True)]
    peer.do("parameters", node=name, method="set_parameters", parameters=broken)
    peer.do("lifecycle", node=name, service="change_state", values=[1, ""])
    assert lines_until(peer, lambda line: line.level == 40)[-1].msg == "the camera is broken"


def read(cdr):
    """Deserialize with rosbags: (frame, child frame, x, seconds) of each transform."""
    message = STORE.deserialize_cdr(cdr, TF)
    return [
        (tf.header.frame_id, tf.child_frame_id, tf.transform.translation.x, tf.header.stamp.sec)
        for tf in message.transforms
    ]


def test_transforms_reach_dds(board, domain):
    moving, static = [], []
    with Network(domain) as network:
        network.listen("/tf", TF, QoSProfile(100), lambda sample: moving.append(read(sample.cdr)))
        assert network.spin(lambda: len(moving) >= 3, 20)
        # A late subscription receives all static transforms.
        network.listen(
            "/tf_static", TF, STATIC, lambda sample: static.append(read(sample.cdr))
        )  # fmt: skip
        assert network.spin(lambda: static, 20)
    assert static == [[("base", "camera", 0.5, 0), ("base", "laser", -0.5, 0)]]
    for before, after in zip(moving, moving[1:], strict=False):
        ((frame, child, x, seconds),) = after
        assert (frame, child) == ("base", "wheel") and x == before[0][2] + 1.0
        assert seconds > 1_700_000_000
