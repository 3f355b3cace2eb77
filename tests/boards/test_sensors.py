"""firmware/spresense_sensors on its virtual board, through the agent, to a real rclpy node."""

import math

import pytest
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.boards.virtual.world.outdoors import Outdoors
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr

pytestmark = pytest.mark.timeout(180)

NODE = "my_node_serial"
TYPES = {
    "/fix": "sensor_msgs/msg/NavSatFix",
    "/imu/data_raw": "sensor_msgs/msg/Imu",
    "/battery": "sensor_msgs/msg/BatteryState",
    "/illuminance": "sensor_msgs/msg/Illuminance",
    "/imu/mag": "sensor_msgs/msg/MagneticField",
    "/temperature": "sensor_msgs/msg/Temperature",
    "/humidity": "sensor_msgs/msg/RelativeHumidity",
    "/range": "sensor_msgs/msg/Range",
    "/time_reference": "sensor_msgs/msg/TimeReference",
    "/camera_info": "sensor_msgs/msg/CameraInfo",
    "/rosout": "rcl_interfaces/msg/Log",
}
FRAMES = {
    "/fix": "gnss", "/imu/data_raw": "imu", "/battery": "battery", "/illuminance": "light",
    "/imu/mag": "imu", "/temperature": "air", "/humidity": "air", "/range": "range",
    "/time_reference": "", "/camera_info": "myframe",
}  # fmt: skip


@pytest.fixture(scope="module")
def peer(peer):
    for topic, type_name in TYPES.items():
        peer.do("subscribe", topic=topic, type=type_name)
    return peer


@pytest.fixture(params=slow_except(["cpython", "micropython"], "cpython"))
def board(request, tmp_path, peer):
    for topic in TYPES:
        forget(peer, topic)
    # Text on CPython, bytecode on MicroPython.
    form = "mpy" if request.param == "micropython" else "py"
    with RunningBoard(
        "spresense_sensors", engine=request.param, form=form, link=tmp_path / "ttyUSB0"
    ) as running:
        yield running


@pytest.fixture
def agent(board, domain):
    with running_agent("serial", MIDDLEWARE, domain, device=board.path) as running:
        yield running


def forget(peer, topic):
    """Discard the messages of a topic so far."""
    peer.messages[topic].clear()
    peer.times[topic].clear()


def read(peer, topic):
    cdr, now = peer.timed_message(topic)
    return from_cdr(load_type(TYPES[topic]), cdr), now


def log_line(peer, text):
    """Wait for a line on /rosout that contains ``text``, and return it."""
    while True:
        line = from_cdr(load_type(TYPES["/rosout"]), peer.message("/rosout", 30))
        if text in line.msg:
            return line


def fresh(peer, topic):
    """Return a message that arrives after this call."""
    forget(peer, topic)
    return read(peer, topic)[0]


def test_all_ten_message_types(agent, board, peer):
    wanted = {topic: kind for topic, kind in TYPES.items() if topic != "/rosout"}
    node = peer.do("node", namespace="/", name=NODE, publishers=wanted)
    for topic, kind in wanted.items():
        assert node["publishers"][topic] == [kind]
    for topic, frame in FRAMES.items():
        message, now = read(peer, topic)
        assert message.header.frame_id == frame
        age = now / 1e9 - message.header.stamp.sec - message.header.stamp.nanosec / 1e9
        assert -0.05 < age < 0.5, (topic, age)

    imu = fresh(peer, "/imu/data_raw")
    assert imu.linear_acceleration.z == pytest.approx(9.8, abs=1.5)
    assert abs(imu.angular_velocity.z) < 0.2
    assert imu.orientation_covariance[0] == -1
    assert imu.angular_velocity_covariance[8] > 0 < imu.linear_acceleration_covariance[4]
    field = fresh(peer, "/imu/mag").magnetic_field
    assert 20e-6 < math.hypot(field.x, field.y, field.z) < 70e-6
    assert 20_000 < fresh(peer, "/illuminance").illuminance < 110_000
    assert 10 < fresh(peer, "/temperature").temperature < 30
    assert 0.3 < fresh(peer, "/humidity").relative_humidity < 0.9
    battery = fresh(peer, "/battery")
    assert 3.2 < battery.voltage < 4.2 and 0.8 < battery.percentage < 0.91
    assert (
        battery.present and battery.power_supply_status == battery.POWER_SUPPLY_STATUS_DISCHARGING
    )
    assert math.isnan(battery.current) and list(battery.cell_voltage) == [battery.voltage]
    distance = fresh(peer, "/range")
    assert 0.2 <= distance.range <= 8.0 or distance.range == math.inf
    assert (distance.min_range, distance.max_range) == (pytest.approx(0.2), 8.0)
    info = fresh(peer, "/camera_info")
    assert (info.width, info.height, info.k[0], info.roi.do_rectify) == (320, 240, 0.0, False)

    # The receiver has a fix after some 27 s; until then it reports none.
    fix = fresh(peer, "/fix")
    while fix.status.status < 0:
        assert math.isnan(fix.latitude) and fix.position_covariance_type == 0
        fix = read(peer, "/fix")[0]
    world = Outdoors(0)
    assert fix.latitude == pytest.approx(world.latitude, abs=0.001)
    assert fix.longitude == pytest.approx(world.longitude, abs=0.002)
    assert fix.status.service == fix.status.SERVICE_GPS
    assert fix.position_covariance[0] == fix.position_covariance[4] > 1
    assert fix.position_covariance_type == fix.COVARIANCE_TYPE_APPROXIMATED
    reference = fresh(peer, "/time_reference")
    board_time = reference.header.stamp.sec + reference.header.stamp.nanosec / 1e9
    assert reference.source == "GNSS"
    # The latency of the receiver's line, and up to one poll.
    assert -0.05 < board_time - reference.time_ref.sec < 0.3


def test_a_failed_sensor_is_reported_once_and_the_others_continue(agent, board, peer):
    read(peer, "/temperature")
    for spec, text in (
        ("mpu6050:absent", "MPU-6050: no answer"),
        ("tfluna:sun", "TF-Luna: it is blinded"),
        ("max17048:open", "MAX17048: 0.04 V is no cell's"),
        ("gnss:silent", "GNSS: it says nothing that can be read"),
        ("sht3x:crc", "SHT3x: wrong CRC of the temperature"),
    ):
        board.happen(spec)
        line = log_line(peer, text)
        assert line.level == 40 and line.name == NODE
    for topic in ("/illuminance", "/imu/mag", "/camera_info"):
        fresh(peer, topic)
    for topic in ("/imu/data_raw", "/battery", "/temperature", "/humidity"):
        forget(peer, topic)
    for _ in range(3):
        fresh(peer, "/illuminance")
    for topic in ("/imu/data_raw", "/battery", "/temperature", "/humidity"):
        assert not peer.messages[topic]
    assert not peer.messages["/rosout"]  # each fault was reported once
    board.happen("all:off")
    recovered = {log_line(peer, "it is back").msg.split(":")[0] for _ in range(5)}
    assert recovered == {"MPU-6050", "TF-Luna", "MAX17048", "GNSS", "SHT3x"}
    for topic in ("/imu/data_raw", "/battery", "/temperature", "/fix"):
        fresh(peer, topic)
