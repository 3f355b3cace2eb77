"""Topics between boards on the agent of uros and a real rclpy node, in both directions."""

import signal
import subprocess
import sys

import pytest
from support.client import XrceClient
from support.lines import UdpLine
from support.middleware import WITH_SERVICES
from support.recorded import RecordedBoard, UdpBoard, submessages
from support.replay import load, messages
from support.signals import default_signals

from uros.interfaces import known_hash
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr, to_cdr
from uros.wire import ids
from uros.wire.streams import Fragments

INT32 = "std_msgs/msg/Int32"
STRING = "std_msgs/msg/String"
TWIST = "geometry_msgs/msg/Twist"
IMAGE = "sensor_msgs/msg/CompressedImage"
TEMPERATURE = "sensor_msgs/msg/Temperature"
HUMIDITY = "sensor_msgs/msg/RelativeHumidity"

pytestmark = pytest.mark.timeout(120)


def board(agent, capture):
    """Play the board of a capture, again and again until the end of the block."""
    recorded = RecordedBoard(load(capture), endless=True)
    return UdpBoard(recorded, ("127.0.0.1", agent.transport.port))


def published(capture):
    """Return the samples that the board of a capture publishes, reassembled from fragments."""
    samples, fragments = [], Fragments()
    for _, message in messages(capture, load(capture), True):
        for kind, flags, payload in submessages(message):
            if kind == ids.FRAGMENT:
                whole = fragments.add(payload, bool(flags & ids.FLAG_LAST_FRAGMENT))
                if whole is not None:
                    samples.append(bytes(whole[8:]))
            elif kind == ids.WRITE_DATA:
                samples.append(payload[4:])
    return samples


def dds_name(type_name):
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def read(type_name, cdr):
    return from_cdr(load_type(type_name), cdr)


def assert_follow_each_other(samples, recorded):
    """Assert that samples are the recorded ones in order, from any on, repeated after the last."""
    start = recorded.index(samples[0])
    for i, sample in enumerate(samples):
        assert sample == recorded[(start + i) % len(recorded)], i


# --- from boards to ROS -----------------------------------------------------------


def test_int32_of_a_board_arrives(agent, peer):
    samples = published("rclc_int32_publisher")
    recorded = [read(INT32, b"\0\1\0\0" + sample).data for sample in samples]
    assert recorded == list(range(19))
    with board(agent, "rclc_int32_publisher"):
        peer.do("subscribe", topic="/std_msgs_msg_Int32", type=INT32)
        numbers = [read(INT32, peer.message("/std_msgs_msg_Int32")).data for _ in range(15)]
    assert_follow_each_other(numbers, recorded)
    peer.do("unsubscribe", topic="/std_msgs_msg_Int32")


def test_temperature_and_humidity_of_a_board_arrive(agent, peer):
    samples = published("rclc_temperature_humidity")
    topics = {"/garden/temperature": TEMPERATURE, "/garden/humidity": HUMIDITY}
    with board(agent, "rclc_temperature_humidity"):
        for topic, type_name in topics.items():
            peer.do("subscribe", topic=topic, type=type_name)
        received = {topic: [peer.message(topic) for _ in range(3)] for topic in topics}
    for i, (topic, type_name) in enumerate(topics.items()):
        recorded = [read(type_name, b"\0\1\0\0" + sample) for sample in samples[i::2]]
        assert_follow_each_other([read(type_name, cdr) for cdr in received[topic]], recorded)
        assert recorded[0].header.frame_id == "bme280"
        peer.do("unsubscribe", topic=topic)


def test_a_fragmented_image_of_a_board_arrives_intact(agent, peer):
    recorded = published("rclc_image")
    assert [len(sample) for sample in recorded] == [15036] * 3
    with board(agent, "rclc_image"):
        peer.do("subscribe", topic="/image/compressed", type=IMAGE)
        images = [read(IMAGE, peer.message("/image/compressed")) for _ in range(3)]
    sent = [read(IMAGE, b"\0\1\0\0" + sample) for sample in recorded]
    assert all(len(image.data) == 15000 for image in images)
    start = [bytes(image.data) for image in sent].index(bytes(images[0].data))
    for i, image in enumerate(images):
        expected = sent[(start + i) % 3]
        assert bytes(image.data) == bytes(expected.data)
        assert (image.format, image.header) == (expected.format, expected.header)
    peer.do("unsubscribe", topic="/image/compressed")


def test_a_boards_node_is_in_the_graph_with_its_publishers_until_it_leaves(agent, peer):
    topics = {
        "/garden/temperature": "sensor_msgs/msg/Temperature",
        "/garden/humidity": "sensor_msgs/msg/RelativeHumidity",
    }
    before = peer.do("gone", namespace="/garden", name="weather")
    assert before["gone"]
    with board(agent, "rclc_temperature_humidity"):
        node = peer.do("node", namespace="/garden", name="weather", publishers=topics)
        assert node["publishers"] is not None, node
        assert {k: v for k, v in node["publishers"].items() if "garden" in k} == {
            topic: [type_name] for topic, type_name in topics.items()
        }
        assert "weather" in node["names"] and "/garden/weather" in node["full_names"]
    after = peer.do("gone", namespace="/garden", name="weather")
    assert after["gone"], after
    assert "/garden/weather" not in after["full_names"]


def test_each_boards_node_has_only_its_own_publishers(agent, peer):
    expected = {
        "rclc_int32_publisher": ("int32_pub_node", "/std_msgs_msg_Int32", INT32),
        "rclc_image": ("image_pub_node", "/image/compressed", IMAGE),
    }
    with board(agent, "rclc_int32_publisher"), board(agent, "rclc_image"):
        for name, topic, type_name in expected.values():
            node = peer.do("node", namespace="/", name=name, publishers={topic: type_name})
            own = set(node["publishers"]) & {published for _, published, _ in expected.values()}
            assert own == {topic}, node
    for name, _, _ in expected.values():
        assert peer.do("gone", namespace="/", name=name)["gone"]


# Seconds for nodes and endpoints to leave the graph. A participant that does not announce its end,
# or not in a form that peers understand, stays for its lease of ten seconds or for good.
SOON = 5


def probe(line, key):
    """Return a client with a writer and a reader."""
    client = XrceClient(line, key=key)
    client.open()
    client.writer("probe", "rt/probe/out", dds_name(INT32))
    client.reader("probe", "rt/probe/in", dds_name(INT32))
    return client


def assert_there(peer):
    topics = {"/probe/out": INT32}
    assert peer.do("node", namespace="/", name="probe", publishers=topics)["publishers"]
    assert peer.do("topic", topic="/probe/in", of="subscriptions")["infos"]


def assert_gone(peer):
    assert peer.do("gone", namespace="/", name="probe", seconds=SOON)["gone"]
    for topic in ("/probe/out", "/probe/in"):
        assert peer.do("unused", topic=topic, seconds=SOON)["unused"], topic


def test_a_board_that_closes_its_session_leaves_the_graph(agent, peer):
    client = probe(agent.line(), 0x51000011)
    assert_there(peer)
    client.close()
    assert_gone(peer)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_agent_ended_by_a_signal_leaves_the_graph(domain, peer, number):
    with default_signals():
        agent = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", "udp4", "-p", "0", "-m", WITH_SERVICES,
             "--domain", str(domain)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
    try:
        port = next(int(line.split()[-1]) for line in agent.stdout if "port: " in line)
        line = UdpLine(port)
        probe(line, 0x51000012)
        assert_there(peer)
        agent.send_signal(number)
        agent.communicate(timeout=SOON)
        assert agent.returncode == 0
        assert_gone(peer)
        line.close()
    finally:
        agent.kill()
        agent.communicate()


def test_endpoints_announce_type_hash_and_qos(agent, peer):
    """Endpoints of a board have type, type hash and QoS; the node's name is not compared.

    Cyclone leaves the participant's GUID out of its endpoint announcements, so rmw_fastrtps calls
    the node of any Cyclone endpoint _CREATED_BY_BARE_DDS_APP_.
    """
    client = XrceClient(agent.line(), key=0x51000001)
    client.open()
    client.writer("probe", "rt/hash/reliable", dds_name(TEMPERATURE))
    client.writer("probe", "rt/hash/best_effort", dds_name(TEMPERATURE), ids.QOS_KEEP_LAST)
    client.reader("probe", "rt/hash/read", dds_name(TWIST))
    for topic, reliability in (("reliable", "RELIABLE"), ("best_effort", "BEST_EFFORT")):
        infos = peer.do("topic", topic=f"/hash/{topic}")["infos"]
        assert infos == [
            {
                "type": TEMPERATURE,
                "hash": known_hash(TEMPERATURE),
                "reliability": reliability,
                "durability": "VOLATILE",
            }
        ]
    infos = peer.do("topic", topic="/hash/read", of="subscriptions")["infos"]
    assert [(info["type"], info["hash"]) for info in infos] == [(TWIST, known_hash(TWIST))]
    client.close()
    assert peer.do("gone", namespace="/", name="probe")["gone"]


def test_a_late_subscriber_gets_a_boards_transient_local_samples(agent, peer):
    client = XrceClient(agent.line(), key=0x51000002)
    client.open()
    flags = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    writer = client.writer("keeper", "rt/kept", dds_name(INT32), flags, depth=3)
    for number in range(5):
        client.write(writer, number.to_bytes(4, "little"))
    peer.do("subscribe", topic="/kept", type=INT32, durability="transient_local")
    assert [read(INT32, peer.message("/kept")).data for _ in range(3)] == [2, 3, 4]
    peer.do("unsubscribe", topic="/kept")
    client.close()


# --- from ROS to boards -----------------------------------------------------------


def twist():
    message = load_type(TWIST)()
    message.linear.x, message.linear.z, message.angular.y = 0.5, -1.25, 1e300
    return message


def image():
    message = load_type(IMAGE)()
    message.header.frame_id, message.format = "camera", "jpeg"
    message.header.stamp.sec, message.header.stamp.nanosec = 1234567890, 999999999
    message.data = bytes(i * 7 & 0xFF for i in range(15000))
    return message


def warm_up(type_name):
    if type_name == INT32:
        return simple(INT32, 77)
    return simple(STRING, "first") if type_name == STRING else load_type(type_name)()


def simple(type_name, value):
    message = load_type(type_name)()
    message.data = value
    return message


@pytest.mark.parametrize("reader_qos", ["reliable", "best_effort"])
@pytest.mark.parametrize(
    ("type_name", "make_messages"),
    [
        (INT32, lambda: [simple(INT32, n) for n in (0, -1, 2**31 - 1)]),
        (STRING, lambda: [simple(STRING, s) for s in ("", "hello", "grüße 🤖")]),
        (TWIST, lambda: [twist()]),
        (IMAGE, lambda: [image()]),
    ],
    ids=["Int32", "String", "Twist", "CompressedImage"],
)
def test_ros_messages_reach_a_clients_reader(agent, peer, type_name, make_messages, reader_qos):
    client = XrceClient(agent.line(), key=0x51000003 + len(agent.lines))
    client.open()
    flags = ids.QOS_KEEP_LAST | (ids.QOS_RELIABLE if reader_qos == "reliable" else 0)
    topic = f"to_board/{type_name.rpartition('/')[2].lower()}_{reader_qos}"
    reader = client.reader("board", f"rt/{topic}", dds_name(type_name), flags)
    client.read(reader)
    sent = make_messages()
    first = warm_up(type_name)

    def publish(*messages):
        cdr = [to_cdr(message).hex() for message in messages]
        answer = peer.do("publish", topic=f"/{topic}", type=type_name, cdr=cdr)
        # The agent may have a probe reader too; see middleware/dds/late_writer_heartbeat.py.
        assert answer["subscribers"] >= 1

    # rclpy discovers the reader before the reader discovers rclpy: samples in between are lost.
    for _ in range(50):
        publish(first)
        if client.wait_sample(reader, 0.1):
            break
    publish(*sent)
    received = []
    while len(received) < len(sent):
        message = read(type_name, b"\0\1\0\0" + client.sample(reader))
        if message != first:
            received.append(message)
    assert received == sent
    assert client.close() == ids.STATUS_OK
