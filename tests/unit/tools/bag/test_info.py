import json
import os
import re
import struct

import pytest

from uros.bag.metadata import TopicMetadata
from uros.bag.writer import BagWriter
from uros.tools import cli
from uros.tools.bag.info import format_seconds, format_size

EVENTS = "/add/_service_event"


@pytest.fixture
def bag(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with BagWriter("bag", "mcap", ros_distro="kilted") as writer:
        a = writer.add_topic(TopicMetadata("/zebra", "std_msgs/msg/String"))
        b = writer.add_topic(TopicMetadata("/ant", "std_msgs/msg/UInt8"))
        events = TopicMetadata(EVENTS, "example_interfaces/srv/AddTwoInts_Event")
        e = writer.add_topic(events)
        start = 1_700_000_000_123_456_789
        for at in range(3):
            writer.write(a, bytes(1000), start + at * 500_000_000, start)
        writer.write(b, bytes(8), start, start)
        for kind, sequence in ((0, 1), (1, 1), (2, 1), (3, 1), (0, 2)):
            info = struct.pack("<4sB3xiI16s4xq", b"\0\1\0\0", kind, 1, 2, bytes(16), sequence)
            writer.write(e, info + bytes(8), start, start)
    return "bag"


def test_the_output_is_that_of_ros2(bag, capsys):
    assert cli.main(["bag", "info", bag]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "" and lines[1] == "Files:             bag_0.mcap"
    assert re.fullmatch(r"Bag size:          \d+\.\d KiB", lines[2])
    assert lines[3:6] == [
        "Storage id:        mcap",
        "ROS Distro:        kilted",
        "Duration:          1.000000000s",
    ]
    start = r"Start:             Nov 1[45] 2023 \d\d:\d\d:20\.123456789 \(1700000000\.123456789\)"
    assert re.fullmatch(start, lines[6])
    assert lines[7].endswith("21.123456789 (1700000001.123456789)")
    assert lines[8:] == [
        "Messages:          4",
        "Topic information: Topic: /ant | Type: std_msgs/msg/UInt8 | Count: 1 |"
        " Serialization Format: cdr",
        "                   Topic: /zebra | Type: std_msgs/msg/String | Count: 3 |"
        " Serialization Format: cdr",
        "Service:           1",
        "Service information: Service: /add | Type: example_interfaces/srv/AddTwoInts |"
        " Event Count: 5 | Serialization Format: cdr",
    ]


def test_verbose_has_sizes_and_calls(bag, capsys):
    assert cli.main(["bag", "info", "-v", bag]) == 0
    out = capsys.readouterr().out
    assert (
        "Topic: /zebra | Type: std_msgs/msg/String | Count: 3 | Size Contribution: 2.9 KiB" in out
    )
    assert "Request Count: 2 | Response Count: 1 | Size Contribution: 260 B" in out


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ([], ["/ant", "/zebra"]),
        (["--sort", "count"], ["/ant", "/zebra"]),
        (["--sort", "type"], ["/zebra", "/ant"]),
    ],
)
def test_only_the_names(bag, capsys, options, names):
    assert cli.main(["bag", "info", "-t", bag, *options]) == 0
    assert capsys.readouterr().out.split() == names


def test_json(bag, capsys):
    """One document with what the text has: times in ns, sizes in bytes."""

    def printed(*options):
        assert cli.main(["bag", "info", bag, "--json", *options]) == 0
        out = capsys.readouterr().out
        assert out.count("\n") == 1
        return json.loads(out)

    ant = {"name": "/ant", "type": "std_msgs/msg/UInt8", "count": 1, "serialization_format": "cdr"}
    zebra = {**ant, "name": "/zebra", "type": "std_msgs/msg/String", "count": 3}
    add = {"name": "/add", "type": "example_interfaces/srv/AddTwoInts", "events": 5,
           "serialization_format": "cdr"}  # fmt: skip
    info = printed()
    assert info.pop("size") > 1000
    assert info == {
        "files": ["bag_0.mcap"], "storage": "mcap", "ros_distro": "kilted",
        "duration": 1_000_000_000, "start": 1_700_000_000_123_456_789,
        "end": 1_700_000_001_123_456_789, "messages": 4, "topics": [ant, zebra], "services": [add],
    }  # fmt: skip
    info = printed("-v", "--sort", "type")
    assert info["topics"] == [{**zebra, "size": 3000}, {**ant, "size": 8}]
    assert info["services"] == [{**add, "size": 260, "requests": 2, "responses": 1}]
    assert printed("-t") == [{"name": "/ant"}, {"name": "/zebra"}]
    with BagWriter("empty", "mcap"):
        pass
    assert cli.main(["bag", "info", "empty", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["start"], info["end"], info["duration"], info["topics"]) == (None, None, 0, [])


@pytest.mark.parametrize("storage, status", [("mcap", 0), ("sqlite3", 1)])
def test_the_storage_may_be_given(bag, capsys, storage, status):
    """In place of what the metadata say: a file of another one cannot be read."""
    assert cli.main(["bag", "info", "-v", bag, "-s", storage]) == status
    captured = capsys.readouterr()
    if status:
        assert captured.out == "" and "bag_0.mcap" in captured.err
    else:
        assert "Storage id:        mcap" in captured.out


def test_a_single_file(bag, capsys):
    assert cli.main(["bag", "info", "bag/bag_0.mcap"]) == 0
    assert "Messages:          4" in capsys.readouterr().out


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_is_cut_off_is_told(tmp_path, capsys, storage):
    """The metadata tell nothing of it."""
    with BagWriter(tmp_path / "bag", storage) as writer:
        topic = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/String"))
        for number in range(100):
            writer.write(topic, bytes(1000), number, number)
    assert cli.main(["bag", "info", str(tmp_path / "bag")]) == 0
    assert capsys.readouterr().err == ""
    os.truncate(writer.path, 60_000)
    assert cli.main(["bag", "info", str(tmp_path / "bag")]) == 0
    captured = capsys.readouterr()
    assert "Messages:          100" in captured.out
    assert f"uros bag recover {writer.path}" in captured.err


def test_what_is_no_bag(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["bag", "info", "nothing"]) == 2
    assert "'nothing': no such folder or file" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert cli.main(["bag", "info", "empty"]) == 1
    assert "uros bag recover empty" in capsys.readouterr().err
    (tmp_path / "a.txt").write_text("")
    assert cli.main(["bag", "info", "a.txt"]) == 1
    assert "expected .mcap or .db3" in capsys.readouterr().err


def test_sizes_and_times():
    assert [format_size(size) for size in (0, 1023, 1536, 5 << 30)] == [
        "0 B", "1023 B", "1.5 KiB", "5.0 GiB",
    ]  # fmt: skip
    assert format_seconds(1_000_000_001) == "1.000000001"
