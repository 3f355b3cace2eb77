import pytest

from uros.bag.metadata import TopicMetadata, read_metadata
from uros.bag.writer import BagWriter
from uros.tools import cli


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_metadata_are_those_of_the_writer(tmp_path, storage, capsys):
    folder = tmp_path / "bag"
    options = {"max_duration_ns": 9, "custom_data": {"robot": "r2"}, "ros_distro": "jazzy"}
    with BagWriter(folder, storage, **options) as writer:
        topic = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/String"))
        for number in range(120):
            writer.write(topic, bytes(69), number, number)
    before = read_metadata(folder)
    assert len(before.files) == 12  # so that number 10 is not before number 2
    (folder / "metadata.yaml").unlink()
    assert cli.main(["bag", "reindex", str(folder), "-s", storage]) == 0
    assert "metadata.yaml is written: 120 messages in 12 files" in capsys.readouterr().out
    assert read_metadata(folder) == before


def test_a_damaged_file_is_named(tmp_path, capsys):
    folder = tmp_path / "bag"
    BagWriter(folder, "mcap").close()
    file = folder / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-1])
    (folder / "metadata.yaml").unlink()
    assert cli.main(["bag", "reindex", str(folder)]) == 1
    assert "uros bag recover" in capsys.readouterr().err
    assert not (folder / "metadata.yaml").exists()


def test_a_folder_without_files_of_a_bag(tmp_path, capsys):
    assert cli.main(["bag", "reindex", str(tmp_path)]) == 1
    assert "no file with the suffix .mcap or .db3" in capsys.readouterr().err
