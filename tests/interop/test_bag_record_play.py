"""``uros bag record`` and ``uros bag play`` with a real rclpy node on the other side."""

import pytest
from rosbags.rosbag2 import Reader
from support.terminal import Terminal

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(120)

STRING = "std_msgs/msg/String"
INT = "std_msgs/msg/Int32"
CLOCK = "rosgraph_msgs/msg/Clock"
MS = 1_000_000
BEGIN = 1_700_000_000_000_000_000
BEST_EFFORT = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def numbers(first, last):
    kind = load(INT)
    return [to_cdr(kind(data=number)) for number in range(first, last)]


def text(data):
    return to_cdr(load(STRING)(data=data))


def hexadecimal(samples):
    return [sample.hex() for sample in samples]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_rclpy_publishes_is_recorded(peer, domain, tmp_path, storage):
    """Two kinds of QoS, a latched message from before, and a pause, in a bag that rosbags reads."""
    at = f"/{storage}"
    # Latched messages need somebody who has asked for them, and come before the recorder.
    peer.do("subscribe", topic=f"{at}/latched", type=STRING, durability="transient_local")
    peer.do(
        "publish", topic=f"{at}/latched", type=STRING, cdr=hexadecimal([text("before")]),
        durability="transient_local",
    )  # fmt: skip
    bag = tmp_path / "bag"
    with Terminal(
        "bag", "record", "-e", at, "-x", "ignored", "-o", bag, "-s", storage, "--domain", domain
    ) as recorder:
        recorder.wait_for("Press SPACE")
        recorder.wait_for(f"Subscribed to topic '{at}/latched'")
        recorder.wait_for(r"  1 messages")
        reliable, lossy = numbers(0, 40), numbers(100, 110)
        peer.do("publish", topic=f"{at}/reliable", type=INT, cdr=hexadecimal(reliable))
        recorder.wait_for(r"  41 messages")
        peer.do(
            "publish", topic=f"{at}/lossy", type=INT, cdr=hexadecimal(lossy),
            reliability="best_effort",
        )  # fmt: skip
        recorder.wait_for(r"  51 messages")
        recorder.press(" ")
        recorder.wait_for("Paused")
        peer.do("publish", topic=f"{at}/ignored", type=INT, cdr=[], seconds=0.1)
        peer.do("publish", topic=f"{at}/reliable", type=INT, cdr=hexadecimal(numbers(40, 41)))
        for _ in range(3):  # three status lines later, the message has arrived and was dropped
            recorder.wait_for(r"  51 messages")
        recorder.press(" ")
        recorder.wait_for("Resumed")
        peer.do("publish", topic=f"{at}/reliable", type=INT, cdr=hexadecimal(numbers(41, 42)))
        recorder.wait_for(r"  52 messages")
        assert recorder.end() == 0
        recorder.wait_for(r"Recorded 52 messages \(.*\) into .*bag, 0 dropped")
    reader = BagReader(bag)
    profiles = {topic.name: topic.offered_qos[0] for topic in reader.topics}
    assert set(profiles) == {f"{at}/latched", f"{at}/reliable", f"{at}/lossy"}
    assert profiles[f"{at}/latched"].transient_local
    assert profiles[f"{at}/reliable"].reliable and not profiles[f"{at}/lossy"].reliable
    found = {name: [] for name in profiles}
    for message in reader.messages():
        found[message.topic].append(message.cdr)
    (before,) = found.pop(f"{at}/latched")  # which Fast DDS has padded
    assert from_cdr(load(STRING), before).data == "before"
    assert found == {f"{at}/reliable": reliable + numbers(41, 42), f"{at}/lossy": lossy}
    with Reader(bag) as theirs:
        assert [
            (connection.topic, connection.msgtype, connection.msgcount)
            for connection in sorted(theirs.connections, key=lambda one: one.topic)
        ] == [
            (f"{at}/latched", STRING, 1),
            (f"{at}/lossy", INT, 10),
            (f"{at}/reliable", INT, 41),
        ]
        assert len(list(theirs.messages())) == 52


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Numbers every 5 ms on two topics, the last of them on a third one too, and a latched text."""
    folder = tmp_path_factory.mktemp("bags") / "bag"
    with BagWriter(folder) as writer:
        reliable = writer.add_topic(TopicMetadata("/played/reliable", INT, [QoSProfile(10)]))
        lossy = writer.add_topic(TopicMetadata("/played/lossy", INT, [BEST_EFFORT]))
        latched = writer.add_topic(TopicMetadata("/played/latched", STRING, [LATCHED]))
        writer.write(latched, text("latched"), BEGIN, BEGIN)
        for number, cdr in enumerate(numbers(0, 60)):
            at = BEGIN + number * 5 * MS
            writer.write(reliable, cdr, at, at)
            writer.write(lossy, cdr, at, at)
    return folder


def test_rclpy_hears_what_is_played(peer, domain, bag):
    """All in order, under another name, with the time of the bag on /clock."""
    peer.do("subscribe", topic="/renamed", type=INT, depth=100)
    peer.do("subscribe", topic="/played/lossy", type=INT, reliability="best_effort", depth=100)
    peer.do("subscribe", topic="/clock", type=CLOCK, reliability="best_effort")
    with Terminal(
        "bag", "play", bag, "--clock", "100", "-m", "/played/reliable:=/renamed", "-p",
        "--domain", domain,
    ) as player:  # fmt: skip
        player.wait_for("Press SPACE")
        for topic in ("/renamed", "/played/lossy"):
            assert peer.do("topic", topic=topic)["infos"]
        player.press(" ")
        assert player.end(keys="") == 0
        player.wait_for("Played 121 messages")
    assert [peer.message("/renamed") for _ in range(60)] == numbers(0, 60)
    assert [peer.message("/played/lossy") for _ in range(60)] == numbers(0, 60)
    clock = load(CLOCK)
    times = [from_cdr(clock, cdr).clock for cdr in peer.messages["/clock"]]
    stamps = [time.sec * 10**9 + time.nanosec for time in times]
    assert stamps == sorted(stamps) and BEGIN <= stamps[0] and stamps[-1] <= BEGIN + 400 * MS
    assert len(set(stamps)) > 2
    for topic in ("/renamed", "/played/lossy", "/clock"):
        peer.do("unsubscribe", topic=topic)


def test_qos_is_that_of_the_recording_and_keys_control_it(peer, domain, bag):
    with Terminal(
        "bag", "play", bag, "--start-paused", "--topics", "/played/lossy", "/played/latched",
        "--domain", domain,
    ) as player:  # fmt: skip
        player.wait_for("paused  0.0 of 0.3 s")
        (lossy,) = peer.do("topic", topic="/played/lossy")["infos"]
        assert (lossy["type"], lossy["reliability"], lossy["durability"]) == (
            INT, "BEST_EFFORT", "VOLATILE",
        )  # fmt: skip
        (latched,) = peer.do("topic", topic="/played/latched")["infos"]
        assert (latched["reliability"], latched["durability"]) == ("RELIABLE", "TRANSIENT_LOCAL")
        player.press("\x1b[C")  # the latched message
        player.wait_for("  1 messages")
        peer.do("subscribe", topic="/played/latched", type=STRING, durability="transient_local")
        assert peer.message("/played/latched") == text("latched")
        player.press("\x1b[A")
        player.wait_for("Rate 1.1")
        player.press("\x1b[B\x1b[B")
        player.wait_for("Rate 0.9")
        player.press(" ")
        player.wait_for("Resumed")
        assert player.end(keys="") == 0
        player.wait_for("Played 61 messages")
    peer.do("unsubscribe", topic="/played/latched")


def test_a_loop_ends_by_ctrl_c(domain, bag):
    with Terminal("bag", "play", bag, "-l", "-r", "10", "--domain", domain) as player:
        player.wait_for(r" (1[3-9]\d|[2-9]\d\d) messages")  # more than a pass
        assert player.end() == 0
        player.wait_for("Played")
