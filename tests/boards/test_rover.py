"""SprTurtleBot's programs on virtual boards.

The rover is driven through the agent by a real rclpy node, with the checks of its tutorial in their
order. The wheels' controllers are tuned by a visualiser over TCP.
"""

import io
import math
import re
import socket
import time

import pytest
from PIL import Image
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr, to_cdr

pytestmark = pytest.mark.timeout(120)

NODE = "my_node_serial"
SUBSCRIBED = {
    "/motor_power": "std_msgs/msg/Bool",
    "/reset": "std_msgs/msg/Empty",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/take_picture": "std_msgs/msg/Empty",
}
PUBLISHED = {
    "/odom": "nav_msgs/msg/Odometry",
    "/image/compressed": "sensor_msgs/msg/CompressedImage",
}
ROSOUT = "/rosout"
STAMP_NS = 100_000_000
ENGINES = slow_except(["cpython", "micropython"], "micropython")
# Text on CPython, bytecode on MicroPython.
FORM = {"cpython": "py", "micropython": "mpy"}


@pytest.fixture(scope="module")
def peer(peer):
    for topic, type_name in PUBLISHED.items():
        peer.do("subscribe", topic=topic, type=type_name)
    peer.do("subscribe", topic=ROSOUT, type="rcl_interfaces/msg/Log")
    return peer


class Rover:
    """The virtual rover, and the rclpy node that drives it."""

    def __init__(self, board, peer):
        self.board = board
        self.peer = peer
        self.begin = (0.0, 0.0, 0.0)  # the pose at the last command

    def publish(self, topic, *messages):
        cdr = [to_cdr(message).hex() for message in messages]
        done = self.peer.do("publish", topic=topic, type=SUBSCRIBED[topic], cdr=cdr)
        assert done["subscribers"]

    def empty(self, topic):
        self.publish(topic, load_type("std_msgs/msg/Empty")())

    def power(self, on):
        self.publish("/motor_power", load_type("std_msgs/msg/Bool")(data=on))
        self.board.wait("motors on" if on else "motors off")

    def drive(self, v=0.0, w=0.0):
        self.begin = self.pose()
        twist = load_type("geometry_msgs/msg/Twist")()
        twist.linear.x, twist.angular.z = v, w
        self.publish("/cmd_vel", twist)

    def odometry(self):
        """Wait for a message that arrives after this call; return it and its arrival time in ns."""
        self.forget("/odom")
        cdr, now = self.peer.timed_message("/odom")
        return from_cdr(load_type(PUBLISHED["/odom"]), cdr), now

    def standing(self):
        """Wait until the rover has moved since the last command and stands again.

        Two messages in a row must report it, since the board shows the pose five times a second
        only. Returns all odometry messages until then.
        """
        end = time.monotonic() + 15
        messages = []
        stood = False
        while time.monotonic() < end:
            messages.append(self.odometry()[0])
            speeds = messages[-1].twist.twist
            stands = not (speeds.linear.x or speeds.angular.z) and self.pose() != self.begin
            if stands and stood:
                return messages
            stood = stands
        raise AssertionError("the rover does not move, or does not stop")

    def pose(self):
        """Return the true pose as the board shows it: in 0.01 m and whole degrees."""
        x, y, turn = re.match(r"(.*) m, (.*) m, (.*)°", self.board.shows("rover")).groups()
        return float(x), float(y), float(turn)

    def forget(self, topic):
        """Discard the messages of a topic so far."""
        self.peer.messages[topic].clear()
        self.peer.times[topic].clear()

    def log(self, text, seconds=15.0):
        """Wait for the next line on /rosout that contains ``text``, and return it."""
        while True:
            cdr = self.peer.message(ROSOUT, seconds)
            line = from_cdr(load_type("rcl_interfaces/msg/Log"), cdr)
            if text in line.msg:
                assert line.name == NODE
                return line.msg

    def drive_until_it_says(self, text):
        """Send commands until the log contains ``text``: a new reader may miss the first ones."""
        for _ in range(8):
            self.drive(0.2)
            try:
                return self.log(text, 2)
            except AssertionError:
                continue
        raise AssertionError(f"the log never contains {text}")


def ns_of(message):
    """Return the stamp of a message in ns."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.fixture(scope="module", params=ENGINES)
def rover(request, peer, domain):
    engine = request.param
    for topic in (*PUBLISHED, ROSOUT):
        peer.messages[topic].clear()
        peer.times[topic].clear()
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        address = ("127.0.0.1", agent.transport.port)
        options = {"engine": engine, "form": FORM[engine], "agent": address}
        with RunningBoard("sprturtlebot", **options) as board:
            yield Rover(board, peer)
    peer.do("gone", namespace="/", name=NODE)


def test_the_node_has_the_topics_of_the_tutorial(rover):
    rover.board.wait("connected to the agent")
    rover.board.wait_shows("led0", "on")
    node = rover.peer.do("node", namespace="/", name=NODE, publishers=PUBLISHED)
    expected = {topic: [type_name] for topic, type_name in PUBLISHED.items()}
    assert expected.items() <= node["publishers"].items()
    for topic, type_name in SUBSCRIBED.items():
        infos = rover.peer.do("topic", topic=topic, of="subscriptions")["infos"]
        assert {info["type"] for info in infos} == {type_name}
        rover.publish(topic)  # no message: this only waits until the endpoints have matched


def test_commands_do_nothing_while_the_motors_are_off(rover):
    assert "the motors are off" in rover.drive_until_it_says("cmd_vel is ignored")
    assert rover.pose() == (0.0, 0.0, 0.0)


def test_the_rover_drives_stops_after_a_second_and_publishes_odometry_once_a_second(rover):
    rover.power(True)
    rover.odometry()
    rover.drive(0.2)
    *_, first, second = messages = [rover.odometry()[0], *rover.standing()]
    x = second.pose.pose.position.x
    # One second at 0.2 m/s, with acceleration and stopping distance.
    assert 0.14 < x < 0.26
    assert rover.pose()[0] == pytest.approx(x, abs=0.02)
    assert max(message.twist.twist.linear.x for message in messages) == pytest.approx(0.2, abs=0.05)

    errors = []  # of the period and of the clock, in ns
    stamp = ns_of(first)
    while not errors or max(errors[-1]) >= STAMP_NS:  # a busy machine delays some messages
        message, now = rover.odometry()
        stamp, before = ns_of(message), stamp
        errors.append((abs(stamp - before - 10**9), abs(now - stamp)))
        assert len(errors) < 20, errors
    assert (first.header.frame_id, first.child_frame_id) == ("odom", "base_footprint")
    turn = first.pose.pose.orientation
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert math.isclose(turn.z**2 + turn.w**2, 1.0)
    assert 0 < first.pose.covariance[0] < 0.01 and 0 < first.pose.covariance[35] < 0.01
    assert first.twist.covariance[0] > 0 and first.twist.covariance[35] > 0


def test_angular_z_turns_the_rover_counter_clockwise(rover):
    before = rover.pose()[2]
    rover.drive(w=1.0)
    orientation = rover.standing()[-1].pose.pose.orientation
    heading = math.degrees(2 * math.atan2(orientation.z, orientation.w))
    assert 35 < heading - before < 85
    assert rover.pose()[2] == pytest.approx(heading, abs=4)


def test_a_command_that_is_not_a_number_is_ignored(rover):
    before = rover.pose()
    rover.drive(math.nan)
    rover.log("it is no number")
    assert rover.pose() == before


def test_take_picture(rover):
    before = time.time_ns()
    rover.empty("/take_picture")
    cdr, now = rover.peer.timed_message("/image/compressed")
    message = from_cdr(load_type(PUBLISHED["/image/compressed"]), cdr)
    assert (message.header.frame_id, message.format) == ("myframe", "jpeg")
    stamp = message.header.stamp
    assert before - STAMP_NS < stamp.sec * 10**9 + stamp.nanosec < now
    picture = Image.open(io.BytesIO(bytes(message.data)))
    picture.load()
    assert (picture.format, picture.size) == ("JPEG", (320, 240))
    rover.board.wait_shows("led2", "off")
    assert rover.board.shown("led2")[-2:] == ["on", "off"]


def test_a_failed_picture_is_reported_and_a_large_one_arrives(rover):
    rover.board.happen("camera:failed")
    rover.empty("/take_picture")
    rover.log("no picture")
    rover.board.happen("camera:off")
    rover.board.happen("camera:large")
    rover.empty("/take_picture")
    message = from_cdr(
        load_type(PUBLISHED["/image/compressed"]), rover.peer.message("/image/compressed")
    )
    assert len(message.data) > 20_000
    rover.board.happen("camera:off")


def test_a_stuck_wheel_is_reported(rover):
    rover.board.happen("rover:left_stuck")
    rover.drive(0.3)
    rover.log("the left wheel does not turn")
    rover.board.happen("rover:off")


def test_the_rover_stops_when_the_link_is_lost_and_accepts_commands_again(rover):
    time_left = 1.3  # seconds: the time limit of a command, and the time to stop
    rover.board.happen("rover:place=0,0,0")
    end = time.monotonic() + 20
    while rover.pose()[0] < 0.03:  # after the stuck wheel, commands are ignored for a second
        assert time.monotonic() < end
        rover.drive(0.2)
    rover.board.happen("gs2200:reset")
    begin = rover.pose()[0]
    rover.board.wait("connected to the agent")
    while rover.odometry()[0].twist.twist.linear.x:
        assert time.monotonic() < end
    last = rover.pose()[0]
    assert last - begin < 0.2 * time_left
    # The rover accepts commands again.
    while rover.pose()[0] < last + 0.03:
        assert time.monotonic() < end
        rover.drive(0.2)


def test_the_topic_reset_resets_the_board(rover):
    before = rover.board.resets
    last, _ = rover.odometry()
    rover.empty("/reset")
    rover.board.wait("connected to the agent")
    assert rover.board.resets == before + 1
    message, _ = rover.odometry()
    # Odometry starts at 0; the rover may have rolled a little since.
    assert abs(message.pose.pose.position.x) < 0.05 < abs(last.pose.pose.position.x)
    rover.drive_until_it_says("the motors are off")


# --- the wheels' tuning ---------------------------------------------------------------------------


class Visualiser:
    """The visualiser of the tutorial: the server that the rover connects to."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(20)
        self.address = self.listener.getsockname()
        self.rover = None
        self.unread = b""

    def accept(self):
        if self.rover is not None:
            self.rover.close()
        self.rover, _ = self.listener.accept()
        self.rover.settimeout(10)
        self.unread = b""

    def send(self, *parts):
        for part in parts:
            self.rover.sendall(part)

    def line(self):
        while b"\n" not in self.unread:
            octets = self.rover.recv(4096)
            assert octets, "the rover has closed the connection"
            self.unread += octets
        line, _, self.unread = self.unread.partition(b"\n")
        return line.decode()

    def sample(self, good):
        """Wait for a sample for which ``good`` is true, and return it; remarks are skipped."""
        end = time.monotonic() + 10
        while time.monotonic() < end:
            line = self.line()
            if not line.startswith("#"):
                values = [int(value) for value in line.split(",")]
                assert len(values) == 6
                if good(*values):
                    return values
        raise AssertionError("no such sample")

    def remark(self, text):
        while text not in (line := self.line()):
            pass
        assert line.startswith("# ")
        return line

    def close(self):
        self.listener.close()
        if self.rover is not None:
            self.rover.close()


@pytest.fixture
def visualiser():
    running = Visualiser()
    yield running
    running.close()


def targets(right, left):
    return lambda *values: values[4:] == (right, left)


def stands(*values):
    return values == (0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_conversation_with_the_visualiser(engine, visualiser):
    options = {"engine": engine, "form": FORM[engine], "agent": visualiser.address}
    with RunningBoard("sprturtlebot_pid", **options) as board:
        visualiser.accept()
        assert visualiser.sample(stands)
        # The tutorial's program sends commands without a line end.
        visualiser.send(b"200,30,5,200,30,5,0.2,0")
        values = visualiser.sample(lambda r, left, vr, vl, *_: vr > 150 and vl > 150)
        assert values[4:] == [200, 200] and min(values[:2]) > 20
        # Two commands in one segment: the last one applies. Backward.
        visualiser.send(b"200,30,5,200,30,5,1.0,0200,30,5,200,30,5,-0.2,0\n")
        values = visualiser.sample(lambda r, left, vr, vl, *_: vr < -150 and vl < -150)
        assert values[4:] == [-200, -200]
        # A command in two segments: turn counter-clockwise on the spot.
        visualiser.send(b"200,30,5,20", b"0,30,5,0.2,1\r\n")
        visualiser.sample(targets(200, -200))
        # An invalid line stops the wheels and is reported.
        visualiser.send(b"200,30,5,nan,30,5,0.3,0\n")
        assert "L_Kp is nan" in visualiser.remark("left out")
        visualiser.sample(stands)
        assert abs(float(re.match(r"(.*?) m", board.shows("rover"))[1])) < 0.6

        # The network is lost while the rover drives, and returns.
        visualiser.send(b"200,30,5,200,30,5,0.2,0\n")
        visualiser.sample(lambda r, left, vr, vl, *_: vr > 100)
        board.happen("wlan:lost")
        board.wait("no visualiser")
        board.happen("wlan:off")
        visualiser.accept()
        visualiser.sample(stands)
        # The visualiser ends and starts again.
        visualiser.rover.close()
        board.wait("has closed the connection")
        visualiser.accept()
        visualiser.sample(stands)


def test_a_wrong_password_is_reported(visualiser):
    plugs = ["wlan:ssid=robots,password=different"]
    with RunningBoard("sprturtlebot_pid", agent=visualiser.address, plugs=plugs) as board:
        board.wait("the password is wrong")
