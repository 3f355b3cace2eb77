"""What BagWriter has written, BagReader and the readers of others give back."""

import pytest
from rosbags.rosbag2 import Reader

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.qos import QoSProfile

KINDS = [("mcap", None), ("mcap", "zstd"), ("mcap", "lz4"), ("sqlite3", None)]
START = 1_700_000_000_000_000_000


def written(folder, storage, compression=None, count=100, **options):
    """Write messages on two topics, and return them."""
    messages = []
    with BagWriter(folder, storage, compression=compression, **options) as writer:
        numbers = {
            name: writer.add_topic(TopicMetadata(name, type_name, [QoSProfile(5)]))
            for name, type_name in (("/a", "std_msgs/msg/String"), ("/b", "sensor_msgs/msg/Imu"))
        }
        for at in range(count):
            name = "/a" if at % 3 else "/b"
            cdr = b"\0\1\0\0" + bytes([at % 256]) * (at % 40)
            received = START + at * 1_000_000
            writer.write(numbers[name], cdr, received, received - 7)
            sent = received if storage == "sqlite3" else received - 7
            messages.append((name, cdr, received, sent))
    return messages


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_what_is_written_is_read(tmp_path, storage, compression):
    messages = written(tmp_path / "bag", storage, compression)
    reader = BagReader(tmp_path / "bag")
    assert list(reader.messages()) == messages
    assert [(topic.name, topic.offered_qos) for topic in reader.topics] == [
        ("/a", [QoSProfile(5)]),
        ("/b", [QoSProfile(5)]),
    ]
    assert reader.topics[1].definition.count("MSG: ") == 4
    assert reader.metadata.message_count == 100
    assert reader.metadata.duration_ns == 99_000_000


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_rosbags_reads_ours(tmp_path, storage, compression):
    messages = written(tmp_path / "bag", storage, compression, max_size=100_000, count=4000)
    with Reader(tmp_path / "bag") as reader:
        theirs = [(link.topic, data, time) for link, time, data in reader.messages()]
        assert reader.message_count == 4000
        assert {link.topic: link.msgcount for link in reader.connections} == {
            "/a": 2666,
            "/b": 1334,
        }
    assert theirs == [message[:3] for message in messages]
