"""The virtual RA6M5 board, through the agent, to a real rclpy node."""

import pytest
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr
from uros.tools.demo import TOPICS

pytestmark = pytest.mark.timeout(120)

NODE = "ra6m5_sensor_node"
DIAGNOSTIC = "/sensors/diagnostic"
TYPES = {topic: type_name for topic, type_name, _ in TOPICS}
FRAMES = {
    "/sensors/room_temp": "sht3x",
    "/sensors/humidity": "sht3x",
    "/sensors/thermocouple_hot": "mcp9600",
    "/sensors/thermocouple_cold": "mcp9600",
}
# Plausible values in a room, in the units of the messages: °C, a fraction, counts.
PLAUSIBLE = {
    "/sensors/room_temp": (5.0, 45.0),
    "/sensors/humidity": (0.05, 0.95),
    "/sensors/thermocouple_hot": (5.0, 400.0),
    "/sensors/thermocouple_cold": (5.0, 60.0),
    "/sensors/proximity": (1, 65535),
    "/sensors/ambient_light": (0, 65535),
}
STAMP_NS = 50_000_000


@pytest.fixture(scope="module")
def peer(peer):
    for topic, type_name in TYPES.items():
        peer.do("subscribe", topic=topic, type=type_name)
    return peer


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def board(request, tmp_path, peer):
    for topic in TYPES:
        forget(peer, topic)
    link = tmp_path / "ttyACM0"
    # Text on CPython, bytecode on MicroPython.
    form = "mpy" if request.param == "micropython" else "py"
    with RunningBoard(NODE, engine=request.param, form=form, link=link) as running:
        yield running


@pytest.fixture
def agent(board, domain):
    with running_agent("serial", MIDDLEWARE, domain, device=board.path) as running:
        yield running


def read(topic, cdr):
    return from_cdr(load_type(TYPES[topic]), cdr)


def forget(peer, topic):
    """Discard the messages of a topic so far."""
    peer.messages[topic].clear()
    peer.times[topic].clear()


def diagnostics(peer, text):
    """Wait for a diagnostic line that contains ``text``; return all lines up to it."""
    lines = []
    while not lines or text not in lines[-1]:
        lines.append(read(DIAGNOSTIC, peer.message(DIAGNOSTIC, 30)).data)
    return lines


def test_all_seven_topics_arrive_with_types_frames_units_and_stamps(agent, board, peer):
    node = peer.do("node", namespace="/", name=NODE, publishers=TYPES)
    assert node["publishers"] == {topic: [name] for topic, name in TYPES.items()}
    assert diagnostics(peer, "initialized") == [f"{NODE} initialized"]
    for topic in PLAUSIBLE:
        delays = []
        for _ in range(3):
            cdr, now = peer.timed_message(topic)
            message = read(topic, cdr)
            low, high = PLAUSIBLE[topic]
            if topic in FRAMES:
                assert message.header.frame_id == FRAMES[topic]
                stamp = message.header.stamp
                delays.append(now - stamp.sec * 10**9 - stamp.nanosec)
                assert message.variance == 0.0
                name = "relative_humidity" if "humidity" in topic else "temperature"
                value = getattr(message, name)
            else:
                value = message.data
            assert low <= value <= high, (topic, value)
        # A busy machine delays some messages, but neither the clock nor the stamps.
        assert topic not in FRAMES or -STAMP_NS < min(delays) < STAMP_NS, (topic, delays)


def test_a_sensor_fails_and_recovers_while_the_others_continue(agent, board, peer):
    diagnostics(peer, "initialized")
    board.happen("sht3x:nack")
    assert "SHT3x read failed" in diagnostics(peer, "SHT3x")[-1]
    forget(peer, "/sensors/room_temp")
    forget(peer, "/sensors/ambient_light")
    for _ in range(2):
        peer.message("/sensors/ambient_light")
    assert not peer.messages["/sensors/room_temp"]
    board.happen("sht3x:off")
    diagnostics(peer, "SHT3x read again")
    peer.message("/sensors/room_temp")


def test_the_usb_cable_is_unplugged_and_plugged_in_again(agent, board, peer):
    diagnostics(peer, "initialized")
    board.happen("usb:unplug")
    board.wait_usb("detached")
    board.happen("usb:plug")
    board.wait_usb("configured")
    for topic in PLAUSIBLE:
        forget(peer, topic)
        peer.message(topic)


def test_a_restarted_agent_gets_all_entities_again(board, peer, domain):
    for _ in range(2):
        with running_agent("serial", MIDDLEWARE, domain, device=board.path):
            diagnostics(peer, "initialized")
            for topic in PLAUSIBLE:
                forget(peer, topic)
                peer.message(topic)
