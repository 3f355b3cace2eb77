import pytest

from uros.bag.metadata import TopicMetadata
from uros.bag.writer import BagWriter
from uros.tools import cli


@pytest.fixture
def bag(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with BagWriter("bag", "mcap", chunk_size=1000) as writer:
        topic = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/String"))
        for number in range(100):
            writer.write(topic, bytes(69), number, number)
    return tmp_path / "bag"


@pytest.mark.parametrize("options", [[], ["-s", "mcap"]])
def test_a_whole_bag(bag, capsys, options):
    assert cli.main(["bag", "recover", "bag", *options]) == 0
    assert capsys.readouterr().out == "bag_0.mcap: whole, 100 messages\n"


def test_a_cut_bag_says_what_is_lost(bag, capsys):
    file = bag / "bag_0.mcap"
    (bag / "metadata.yaml").unlink()
    data = file.read_bytes()
    file.write_bytes(data[: data.index(bytes(60), len(data) // 2) + 30])
    assert cli.main(["bag", "recover", "bag"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("bag_0.mcap: finished, ") and first.endswith(" messages kept")
    assert "bytes cannot be read" in second
    assert second.endswith("the original is bag_0.mcap.damaged")
    assert cli.main(["bag", "info", "bag"]) == 0


def test_what_cannot_be_recovered(bag, capsys):
    (bag / "bag_0.mcap").write_bytes(b"")
    assert cli.main(["bag", "recover", "bag"]) == 1
    assert "no message and no topic of it can be read" in capsys.readouterr().err
