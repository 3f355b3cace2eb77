"""The programs for the ESP32 on their virtual boards, through the agent, with a real rclpy node.

The checks are those of the tutorial, and faults. There is no tf2_msgs for that rclpy, so transforms
are received as bytes, by a reader with the QoS of tf2_ros, and decoded by rosbags.
"""

import calendar
import math
import re
import shutil
import time
from contextlib import contextmanager
from functools import partial

import pytest
from rosbags.typesys import Stores, get_typestore
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard, firmware_folder
from uros.boards.virtual.models.catalog import find
from uros.host.network import Network
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.qos import QoSProfile

pytestmark = pytest.mark.timeout(120)

INT32 = "std_msgs/msg/Int32"
FLOAT32 = "std_msgs/msg/Float32"
STRING = "std_msgs/msg/String"
TIME = "builtin_interfaces/msg/Time"
TF = "tf2_msgs/msg/TFMessage"
STORE = get_typestore(Stores.ROS2_JAZZY)
STAMP_NS = 200_000_000
NAN = float("nan")


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def engine(request):
    return request.param


@contextmanager
def talking(board, peer, domain, node, publishers):
    """Run an agent on the board's line; the node is in the ROS graph meanwhile, and not after."""
    with running_agent("serial", MIDDLEWARE, domain, device=board.path) as agent:
        see_node(peer, node, publishers)
        yield agent
    assert peer.do("gone", namespace="/", name=node)["gone"]


def see_node(peer, node, publishers):
    """Wait until the node is in the ROS graph, with these publishers and no others."""
    seen_publishers = peer.do("node", namespace="/", name=node, publishers=publishers)["publishers"]
    assert seen_publishers == {topic: [name] for topic, name in publishers.items()}


def echo(peer, topic, type_name, count, **qos):
    """Return the next ``count`` messages, and their arrival times in ns."""
    forget(peer, topic)
    peer.do("subscribe", topic=topic, type=type_name, **qos)
    samples = [peer.timed_message(topic) for _ in range(count)]
    return [from_cdr(load(type_name), cdr) for cdr, _ in samples], [now for _, now in samples]


def forget(peer, topic):
    """Discard the messages of a topic so far."""
    peer.messages[topic].clear()
    peer.times[topic].clear()


@pytest.fixture(autouse=True)
def unsubscribe(peer):
    """Remove the subscriptions of a test at its end."""
    yield
    for topic in list(peer.messages):
        peer.do("unsubscribe", topic=topic)
        del peer.messages[topic], peer.times[topic]


def pub(peer, topic, *values):
    """Publish Float32 values, once a subscription is matched."""
    cdr = [to_cdr(load(FLOAT32)(data=value)).hex() for value in values]
    assert peer.do("publish", topic=topic, type=FLOAT32, cdr=cdr)["subscribers"]


def pub_until(peer, topic, value, wait):
    """Publish a value until ``wait`` returns: a reader that has not matched yet misses it."""
    for _ in range(40):
        pub(peer, topic, value)
        try:
            return wait(timeout=0.5)
        except TimeoutError:
            pass
    raise AssertionError(f"{value} on {topic} never came")


def subscription(peer, topic):
    """Return type and reliability of the subscriptions of a topic.

    For a moment, these are two readers of the agent: see uros.middleware.dds.
    """
    infos = peer.do("topic", topic=topic, of="subscriptions")["infos"]
    ((type_name, reliability),) = {(info["type"], info["reliability"]) for info in infos}
    return type_name, reliability


def is_count(numbers):
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def wait_blinks(board, led):
    """Wait until an LED has gone on, off and on."""
    board.wait_shows(led, "on")
    board.wait_shows(led, "off")
    board.wait_shows(led, "on")


def test_activity_1_a_publisher(engine, peer, domain):
    with RunningBoard("esp32_publisher", engine=engine) as board:
        board.wait("looking for the agent")
        wait_blinks(board, "led")
        with talking(
            board, peer, domain, "micro_ros_pub_node", {"/micro_ros_counter": INT32}
        ) as agent:
            board.wait("connected to the agent")
            board.wait_shows("led", "on")
            counts, times = echo(peer, "/micro_ros_counter", INT32, 2)
            assert is_count([count.data for count in counts])
            assert 0.7e9 < times[1] - times[0] < 1.4e9
            (info,) = peer.do("topic", topic="/micro_ros_counter")["infos"]
            assert (info["type"], info["reliability"]) == (INT32, "RELIABLE")
            log = agent.said.getvalue()
            for kind in ("participant", "topic", "publisher", "datawriter"):
                assert log.count(f"{kind} created") == 1, log
        if engine == "micropython":
            return
        # A new agent gets all entities again, without a reset of the board.
        with talking(board, peer, domain, "micro_ros_pub_node", {"/micro_ros_counter": INT32}):
            (again,), _ = echo(peer, "/micro_ros_counter", INT32, 1)
            assert again.data > counts[-1].data


def test_activity_1_2_four_states_and_a_count_that_continues(engine, peer, domain):
    node, topic = "micro_ros_pub_node", "/micro_ros_counter"
    with RunningBoard("esp32_publisher_reconnect", engine=engine) as board:
        assert board.console.get(timeout=20) == "WAITING_AGENT"
        numbers = []
        for count in (2, 1):
            with talking(board, peer, domain, node, {topic: INT32}):
                assert board.console.get(timeout=20) == "AGENT_AVAILABLE"
                assert board.console.get(timeout=20) == "AGENT_CONNECTED"
                numbers += [message.data for message in echo(peer, topic, INT32, count)[0]]
            if count == 1:
                break
            assert board.console.get(timeout=20) == "AGENT_DISCONNECTED"
            assert board.console.get(timeout=20) == "WAITING_AGENT"
        # Messages in flight at the agent's end are lost, but the count does not restart.
        assert is_count(numbers[:2])
        assert 1 <= numbers[2] - numbers[1] <= 6, numbers


def test_activity_2_a_brightness(engine, peer, domain):
    topic = "/micro_ros_sub"
    with RunningBoard("esp32_subscriber", engine=engine) as board:
        wait_blinks(board, "error_led")
        with talking(board, peer, domain, "micro_ros_sub_node", {}):
            board.wait_shows("error_led", "on")
            assert subscription(peer, topic) == (FLOAT32, "RELIABLE")
            pub_until(peer, topic, 0.3, partial(board.wait_shows, "led", "30 %"))
            pub(peer, topic, 1.5)
            board.wait_shows("led", "on")
            pub(peer, topic, -3.0)
            board.wait_shows("led", "off")
            pub(peer, topic, 0.5, NAN, 0.25)
            board.wait("ValueError: a brightness is a number from 0 to 1, not nan")
            board.wait_shows("led", "25 %")
            assert board.shown("led") == ["off", "30 %", "on", "off", "50 %", "25 %"]
            pub(peer, topic, math.inf)
            board.wait_shows("led", "on")


def test_activity_2_2_four_states_and_a_brightness(engine, peer, domain):
    topic = "/micro_ros_sub"
    with RunningBoard("esp32_subscriber_reconnect", engine=engine) as board:
        assert board.console.get(timeout=20) == "WAITING_AGENT"
        for brightness in (0.3, 0.6):
            with talking(board, peer, domain, "micro_ros_sub_node", {}):
                assert board.console.get(timeout=20) == "AGENT_AVAILABLE"
                assert board.console.get(timeout=20) == "AGENT_CONNECTED"
                shows = f"{round(100 * brightness)} %"
                pub_until(peer, topic, brightness, partial(board.wait_shows, "led", shows))
            if brightness == 0.6:
                break
            assert board.console.get(timeout=20) == "AGENT_DISCONNECTED"
            assert board.console.get(timeout=20) == "WAITING_AGENT"
            assert board.shows("led") == shows, "the LED keeps its brightness"


def wait_state(peer, data):
    """Wait until the button's state is ``data``; return the number of other states before."""
    before = 0
    while True:
        (state,), _ = echo(peer, "/button_state", STRING, 1)
        if state.data == data:
            return before
        before += 1
        assert before < 100, f"the state stays {state.data}"


def test_activity_3_a_button_and_a_brightness(engine, peer, domain):
    topic = "/led_brightness"
    with (
        RunningBoard("esp32_button_led", engine=engine, happen=["button:bounce=25"]) as board,
        talking(board, peer, domain, "esp32_button_led_node", {"/button_state": STRING}),
    ):
        states, times = echo(peer, "/button_state", STRING, 6)
        assert {state.data for state in states} == {"inactive"}
        assert 0.35e9 < times[-1] - times[0] < 0.8e9
        assert subscription(peer, topic) == (FLOAT32, "RELIABLE")
        pub_until(peer, topic, NAN, partial(board.wait, "not nan"))
        pub(peer, topic, 0.25)  # without effect: the LED is off
        board.happen("button:press")
        board.wait_shows("button", "pressed")
        states, _ = echo(peer, "/button_state", STRING, 4)
        assert states[-1].data == "inactive", "the button is still held down"
        assert board.shown("led") == ["off"]
        board.happen("button:release")
        wait_state(peer, "active")
        board.wait_shows("led", "25 %")
        pub(peer, topic, 0.5)
        board.wait_shows("led", "50 %")
        pub(peer, topic, NAN, 7.0)
        board.wait_shows("led", "on")
        board.happen("button:tap=0.1")
        wait_state(peer, "inactive")
        board.wait_shows("led", "off")
        pub(peer, topic, 0.75)
        board.happen("button:stuck")
        board.happen("button:tap=0.1")
        states, _ = echo(peer, "/button_state", STRING, 3)
        assert {state.data for state in states} == {"inactive"}, "a push without an end"
        board.happen("button:off")
        wait_state(peer, "active")
        board.happen("button:tap=0.1")
        wait_state(peer, "inactive")
        board.happen("button:broken")
        board.happen("button:tap=0.1")
        states, _ = echo(peer, "/button_state", STRING, 3)
        assert {state.data for state in states} == {"inactive"}, "a push without a beginning"
        board.happen("button:off")
        board.happen("button:tap=0.1")
        wait_state(peer, "active")
        board.wait_shows("led", "75 %")
        assert " ".join(board.shown("led")) == "off 25 % 50 % on off 75 % off 75 %"


def test_activity_4_over_an_access_point_of_the_boards_own(engine, peer, domain):
    node, topic = "int32_publisher_rclc", "/std_msgs_msg_Int32"
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        with RunningBoard(
            "esp32_wifi_publisher",
            engine=engine,
            agent=("127.0.0.1", agent.transport.port),
            happen=["wlan:alone"],
        ) as board:
            board.wait("nobody has joined the access point ESP32-Access-Point yet")
            wait_blinks(board, "led")
            board.happen("wlan:off")
            board.wait("connected to the agent")
            board.wait_shows("wlan", "ESP32-Access-Point, one computer")
            see_node(peer, node, {topic: INT32})
            (count,), _ = echo(peer, topic, INT32, 1, reliability="best_effort")
            (info,) = peer.do("topic", topic=topic)["infos"]
            assert (info["type"], info["reliability"]) == (INT32, "BEST_EFFORT")
            if engine == "micropython":
                return
            board.happen("wlan:lost")
            board.wait("no agent:")
            board.happen("wlan:off")
            board.wait("connected to the agent")
            (again,), _ = echo(peer, topic, INT32, 1)
            assert again.data > count.data


def test_a_configuration_error_is_reported_and_retried_while_the_led_blinks(tmp_path):
    folder = tmp_path / "short"
    shutil.copytree(firmware_folder(find("esp32_wifi_publisher")), folder)
    config = folder / "config.py"
    config.write_text(config.read_text().replace("123456789", "1234567"))
    with RunningBoard(folder, "esp32_wifi_publisher") as board:
        for _ in range(2):
            board.wait("an access point's password has 8 to 63 characters")
            wait_blinks(board, "led")


def test_transforms_and_the_time_on_the_board(engine, peer, domain):
    with (
        RunningBoard("esp32_tf_clock", engine=engine) as board,
        talking(board, peer, domain, "esp32_tf_clock", {"/board_time": TIME, "/tf": TF}),
        Network(domain) as network,
    ):
        line = board.wait("the clock is set: ")
        set_to = calendar.timegm(tuple(map(int, re.findall(r"\d+", line))))
        assert abs(set_to - time.time()) < 5, line
        delays = []
        while not delays or abs(delays[-1]) >= STAMP_NS:  # a busy machine delays some messages
            (message,), (now,) = echo(peer, "/board_time", TIME, 1)
            delays.append(now - message.sec * 10**9 - message.nanosec)
            assert len(delays) < 20, delays
        samples = []

        def received(sample):
            (transform,) = STORE.deserialize_cdr(sample.cdr, TF).transforms
            samples.append((transform, time.time_ns()))

        network.listen("/tf", TF, QoSProfile(100), received)
        assert network.spin(lambda: len(samples) >= 6, 20)
        for stamped, _ in samples:
            assert (stamped.header.frame_id, stamped.child_frame_id) == ("base_link", "sensor")
            turn = stamped.transform.rotation
            assert (turn.x, turn.y) == (0, 0)
            assert abs(turn.z**2 + turn.w**2 - 1) < 1e-6
            assert abs(stamped.transform.translation.z - 0.3) < 1e-6
        stamps = [sample.header.stamp for sample, _ in samples]
        arrivals = [now for _, now in samples]
        delays = [
            now - stamp.sec * 10**9 - stamp.nanosec
            for stamp, now in zip(stamps, arrivals, strict=True)
        ]
        assert min(map(abs, delays)) < STAMP_NS, delays  # this process may have been busy
        # 0.5 rad/s, counter-clockwise, ten a second.
        turns = [sample.transform.rotation for sample, _ in samples]
        headings = [2 * math.atan2(turn.z, turn.w) for turn in turns]
        for before, after in zip(headings, headings[1:], strict=False):
            assert abs((after - before) % (2 * math.pi) - 0.05) < 1e-3
        seconds = [stamp.sec + stamp.nanosec / 1e9 for stamp in stamps]
        gaps = [after - before for before, after in zip(seconds, seconds[1:], strict=False)]
        assert min(abs(gap - 0.1) for gap in gaps) < 0.03, gaps
