"""Bags of other implementations: mcap's reader and writer, rosbags, and old tables of rosbag2."""

import sqlite3

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.interfaces import QosTime as Time
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

START = 1_700_000_000_000_000_000
KINDS = {None: CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}


def cdr(number):
    return b"\0\1\0\0" + number.to_bytes(4, "little") * (number % 9)


@pytest.mark.parametrize("compression", KINDS)
def test_mcap_reads_ours(tmp_path, compression):
    with BagWriter(tmp_path / "bag", compression=compression, chunk_size=900) as writer:
        one = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/Header", [QoSProfile(7)]))
        two = writer.add_topic(TopicMetadata("/b", "std_msgs/msg/Header"))
        times = [START + number * 7 % 50 for number in range(200)]
        for number, time in enumerate(times):
            writer.write((one, two)[number % 2], cdr(number), time, START)
    with open(tmp_path / "bag" / "bag_0.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 200
        assert summary.statistics.channel_message_counts == {1: 100, 2: 100}
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
            START, START + 49,
        )  # fmt: skip
        theirs = list(reader.iter_messages())
        assert [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in theirs] == [
            ("/a" if number % 2 == 0 else "/b", times[number], START, cdr(number))
            for number in sorted(range(200), key=times.__getitem__)
        ]
        schema, channel, _ = theirs[0]
        assert (schema.name, schema.encoding) == ("std_msgs/msg/Header", "ros2msg")
        assert b"\n" + b"=" * 80 + b"\nMSG: builtin_interfaces/Time\n" in schema.data
        assert channel.message_encoding == "cdr"
        assert "depth: 7" in channel.metadata["offered_qos_profiles"]
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert [record.name for record in reader.iter_metadata()] == ["rosbag2", "rosbag2"]


@pytest.mark.parametrize("compression", KINDS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"index_types": IndexType.NONE},
        {"enable_crcs": False, "use_summary_offsets": False},
    ],
)
def test_we_read_what_mcap_writes(tmp_path, compression, options):
    file = tmp_path / "theirs.mcap"
    with open(file, "wb") as stream:
        writer = Writer(stream, chunk_size=700, compression=KINDS[compression], **options)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels = [writer.register_channel(name, "cdr", schema, {}) for name in ("/a", "/b")]
        for number in range(300):
            writer.add_message(
                channels[number % 2], START + number * 31 % 100, cdr(number), START + number
            )
        writer.finish()
    reader = BagReader(file)
    assert reader.metadata.message_count == 300 and reader.metadata.duration_ns == 99
    expected = sorted(range(300), key=lambda number: number * 31 % 100)
    assert [(m.topic, m.cdr, m.received_ns, m.sent_ns) for m in reader.messages()] == [
        (("/a", "/b")[number % 2], cdr(number), START + number * 31 % 100, START + number)
        for number in expected
    ]
    some = reader.messages(["/b"], START + 10, START + 20)
    assert [m.received_ns - START for m in some] == sorted(
        number * 31 % 100 for number in range(1, 300, 2) if 10 <= number * 31 % 100 < 20
    )


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("version", [8, 9])
def test_we_read_what_rosbags_writes(tmp_path, plugin, version):
    store = get_typestore(Stores.ROS2_HUMBLE)
    qos = Qos(
        QosHistory.KEEP_LAST, 5, QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL,
        Time(1, 500_000_000), Time(2147483651, 294967295), QosLiveliness.AUTOMATIC,
        Time(9223372036, 854775807), False,
    )  # fmt: skip
    with RosbagsWriter(tmp_path / "bag", version=version, storage_plugin=plugin) as writer:
        link = writer.add_connection(
            "/a", "std_msgs/msg/String", typestore=store, offered_qos_profiles=[qos]
        )
        for number in range(50):
            writer.write(link, START + number, cdr(number))
    reader = BagReader(tmp_path / "bag")
    assert [(m.cdr, m.received_ns) for m in reader.messages()] == [
        (cdr(number), START + number) for number in range(50)
    ]
    (topic,) = reader.topics
    assert topic.offered_qos == [
        QoSProfile(
            5, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL, deadline_ms=1500
        )
    ]
    assert "string data" in topic.definition and topic.type_hash.startswith("RIHS01_df668c74")
    (single,) = BagReader(reader.files[0]).topics
    assert single.offered_qos == topic.offered_qos


@pytest.mark.parametrize("version", [1, 2, 3])
def test_old_tables(tmp_path, version):
    file = tmp_path / "old.db3"
    database = sqlite3.connect(file)
    qos = "- history: 1\n  depth: 3\n  reliability: 2\n" if version > 1 else ""
    columns = ", offered_qos_profiles TEXT NOT NULL" if version > 1 else ""
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        f" serialization_format TEXT NOT NULL{columns})"
    )
    database.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    if version > 2:
        database.execute("CREATE TABLE schema(schema_version INTEGER, ros_distro TEXT)")
        database.execute("INSERT INTO schema VALUES (3, 'humble')")
    topic = [4, "/a", "std_msgs/msg/String", "cdr", *([qos] if version > 1 else [])]
    database.execute(f"INSERT INTO topics VALUES ({','.join('?' * len(topic))})", topic)
    for number in (2, 1, 3):
        database.execute("INSERT INTO messages VALUES (?, 4, ?, ?)", (number, number, cdr(number)))
    database.commit()
    database.close()
    reader = BagReader(file)
    assert [m.cdr for m in reader.messages()] == [cdr(1), cdr(2), cdr(3)]
    assert reader.metadata.ros_distro == ("humble" if version > 2 else "")
    assert [profile.depth for profile in reader.topics[0].offered_qos] == [3] * (version > 1)
