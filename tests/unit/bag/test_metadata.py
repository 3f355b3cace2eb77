"""metadata.yaml of every version, and what is wrong in it."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from uros.bag import metadata as module
from uros.bag.errors import BagError
from uros.bag.metadata import BagMetadata, TopicMetadata, from_mapping, to_mapping
from uros.bag.writer import BagWriter
from uros.qos import QoSProfile

ROOT = "rosbag2_bagfile_information"
# 2^31 - 1 seconds and more are infinite, as in the bags of Foxy.
FINITE = st.none() | st.integers(1, (2**31 - 1) * 1000 - 1)


def given_metadata():
    profiles = st.builds(
        QoSProfile,
        depth=st.integers(0, 2**31),
        reliability=st.integers(0, 4),
        durability=st.integers(0, 4),
        history=st.integers(0, 3),
        deadline_ms=FINITE,
        lifespan_ms=FINITE,
        liveliness=st.integers(0, 5),
        liveliness_lease_ms=FINITE,
    )
    name = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1)
    topics = st.builds(
        TopicMetadata, name, name, st.lists(profiles, max_size=3), name, serialization_format=name
    )
    return st.builds(
        BagMetadata,
        version=st.integers(7, 9),
        starting_time_ns=st.integers(0, 2**63 - 1),
        duration_ns=st.integers(0, 2**62),
        message_count=st.integers(0, 2**63 - 1),
        topics=st.lists(st.tuples(topics, st.integers(0, 2**40)), max_size=3),
        custom_data=st.dictionaries(name, name),
    )


@given(given_metadata())
def test_what_is_written_is_read(metadata):
    text = yaml.safe_dump(to_mapping(metadata), allow_unicode=True)
    assert from_mapping(yaml.safe_load(text), "x") == metadata


@pytest.mark.parametrize("version", range(1, 10))
def test_every_version(version):
    whole = BagMetadata(storage="sqlite3", starting_time_ns=5, duration_ns=6, message_count=7)
    whole.topics = [(TopicMetadata("/a", "b", [QoSProfile(3)], "RIHS01_"), 7)]
    whole.custom_data, whole.ros_distro = {"k": "v"}, "jazzy"
    whole.files = [module.FileInformation("a_0.db3", 5, 6, 7)]
    whole.version = max(version, 4)
    node = to_mapping(whole)
    node["version"] = version
    for since, keys in (
        (3, ("compression_format", "compression_mode")),
        (5, ("files",)),
        (6, ("custom_data",)),
        (8, ("ros_distro",)),
    ):
        for key in keys if version < since else ():
            del node[key]
    entry = node["topics_with_message_count"][0]["topic_metadata"]
    if version < 7:
        del entry["type_description_hash"]
    if version < 4:
        del entry["offered_qos_profiles"]
    read = from_mapping(node, "x")
    assert read.message_count == 7 and read.files[0].path == "a_0.db3"
    assert read.files[0].message_count == (7 if version >= 5 else 0)
    assert read.topics[0][0].offered_qos == ([QoSProfile(3)] if version >= 4 else [])
    assert read.ros_distro == ("jazzy" if version >= 8 else "")


def test_rosbags_reads_an_empty_bag(tmp_path):
    BagWriter(tmp_path / "bag", custom_data={"robot": "r2"}, ros_distro="kilted").close()
    with Reader(tmp_path / "bag") as reader:
        assert (reader.message_count, reader.ros_distro) == (0, "kilted")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 10}, "version 10; uros knows 1 to 9"),
        ({"message_count": -1}, "message_count is -1; expected a number from 0 on"),
        ({"duration": 5}, "duration: a mapping was expected, not 5"),
        ({"relative_file_paths": "x"}, "relative_file_paths is no list"),
        ({"topics_with_message_count": [{}]}, "topic_metadata is missing"),
        ({"custom_data": [1]}, "custom_data is no mapping"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, change, said):
    text = yaml.safe_dump({ROOT: {**to_mapping(BagMetadata()), **change}})
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=said) as raised:
        module.read_metadata(tmp_path)
    assert str(raised.value).startswith(str(tmp_path / "metadata.yaml"))


@given(st.text() | st.binary())
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    folder = tmp_path_factory.mktemp("any")
    data = text if isinstance(text, bytes) else text.encode("utf-8", "replace")
    (folder / "metadata.yaml").write_bytes(data)
    with pytest.raises(BagError):
        module.read_metadata(folder)
