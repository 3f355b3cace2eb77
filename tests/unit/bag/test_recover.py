"""A bag that was cut off or damaged: what can be read is kept, and the rest is told."""

import os
import random
import signal
import subprocess
import sys

import pytest

from uros.bag.errors import BagError
from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.recover import recover
from uros.bag.reindex import reindex
from uros.bag.writer import BagWriter

KINDS = [("mcap", None), ("mcap", "zstd"), ("mcap", "lz4"), ("sqlite3", None)]
START = 1_700_000_000_000_000_000
COUNT = 300


def cdr(number):
    return b"\0\1\0\0" + number.to_bytes(4, "little") * 16


def written(folder, storage, compression):
    with BagWriter(folder, storage, compression=compression, chunk_size=2000) as writer:
        topic = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/String"))
        for number in range(COUNT):
            writer.write(topic, cdr(number), START + number, START)
    return folder / writer.metadata.files[0].path


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_a_whole_bag_is_left_as_it_is(tmp_path, storage, compression):
    file = written(tmp_path / "bag", storage, compression)
    before = file.read_bytes()
    (result,) = recover(tmp_path / "bag")
    assert (result.kept, result.rewritten, result.original) == (COUNT, False, None)
    assert file.read_bytes() == before


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_a_file_cut_anywhere_keeps_its_first_messages(tmp_path, storage, compression):
    whole = written(tmp_path / "bag", storage, compression).read_bytes()
    chance = random.Random(1)
    kept = []
    for turn in range(12):
        folder = tmp_path / f"cut{turn}"
        folder.mkdir()
        cut = chance.randrange(len(whole) // 4, len(whole))
        original = whole[:cut]
        (folder / f"bag_0.{'mcap' if storage == 'mcap' else 'db3'}").write_bytes(original)
        (result,) = recover(folder)
        messages = list(BagReader(folder).messages())
        assert len(messages) == result.kept and result.rewritten
        assert [m.cdr for m in messages] == [cdr(m.received_ns - START) for m in messages]
        if storage == "mcap":
            assert [m.received_ns - START for m in messages] == list(range(result.kept))
        if result.original is not None:
            assert result.original.read_bytes() == original
        kept.append((cut, result.kept))
    kept.sort()
    assert [count for _, count in kept] == sorted(count for _, count in kept)
    assert kept[-1][1] > COUNT / 3


def test_behind_a_damaged_chunk_the_others_are_kept_and_its_messages_are_counted(tmp_path):
    file = written(tmp_path / "bag", "mcap", None)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    (result,) = recover(tmp_path / "bag")
    assert result.lost_messages and result.kept + result.lost_messages == COUNT
    assert sum(1 for _ in BagReader(tmp_path / "bag").messages()) == result.kept


def test_a_damaged_length_loses_one_chunk(tmp_path):
    file = written(tmp_path / "bag", "mcap", "zstd")
    data = bytearray(file.read_bytes())
    second = data.index(b"\6", data.index(b"zstd") + 200)
    while data[second + 4 : second + 9] != bytes(5) or data[second + 37 : second + 45] != (
        b"\4\0\0\0zstd"
    ):
        second = data.index(b"\6", second + 1)
    data[second + 3] ^= 0x40  # the chunk now seems to have 4 MiB
    file.write_bytes(data)
    (result,) = recover(tmp_path / "bag")
    assert COUNT - 30 < result.kept < COUNT


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"x" * 5000])
def test_nothing_to_recover_is_an_error_and_changes_nothing(tmp_path, content):
    for name in ("a_0.mcap", "b_0.db3"):
        file = tmp_path / name
        file.write_bytes(content)
        with pytest.raises(BagError, match="can be read|no SQLite"):
            recover(file)
        assert file.read_bytes() == content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a_0.mcap", "b_0.db3"]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_is_recorded_is_left_alone(tmp_path, storage):
    """Else the recorder would go on in a file that nobody sees."""
    folder = tmp_path / "bag"
    with BagWriter(folder, storage) as writer:
        number = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/Int32"))
        writer.write(number, b"\0\1\0\0\1\0\0\0", 1, 1)
        writer.flush()
        for use in (recover, reindex, BagReader):
            with pytest.raises(BagError, match="another program is recording"):
                use(folder)
        with pytest.raises(BagError, match="another program is recording"):
            recover(writer.path)
        writer.write(number, b"\0\1\0\0\2\0\0\0", 2, 2)
    assert [message.received_ns for message in BagReader(folder).messages()] == [1, 2]
    (result,) = recover(folder)
    assert (result.kept, result.rewritten) == (2, False)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_recorder_reports_that_its_file_was_replaced(tmp_path, storage):
    writer = BagWriter(tmp_path / "bag", storage)
    content = writer.path.read_bytes()
    writer.path.rename(tmp_path / "moved")
    writer.path.write_bytes(content)
    with pytest.raises(BagError, match="replaced or removed"):
        writer.close()


def test_a_full_disk_leaves_the_original(tmp_path, monkeypatch):
    file = written(tmp_path / "bag", "mcap", None)
    os.truncate(file, 10_000)
    before = file.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("uros.bag.recover._sync", full)
    with pytest.raises(BagError, match="No space left"):
        recover(file)
    assert file.read_bytes() == before
    assert {path.name for path in file.parent.iterdir()} == {file.name, "metadata.yaml"}


_WRITING = """
import sys
from uros.bag.metadata import TopicMetadata
from uros.bag.writer import BagWriter
writer = BagWriter(sys.argv[1], sys.argv[2], compression=sys.argv[3] or None)
topic = writer.add_topic(TopicMetadata("/a", "std_msgs/msg/String"))
number = 0
while True:
    for _ in range(50):
        writer.write(topic, b"\\0\\1\\0\\0" + number.to_bytes(4, "little") * 16, number, number)
        number += 1
    writer.flush()
    print(number, flush=True)
"""


@pytest.mark.parametrize(("storage", "compression"), [KINDS[0], KINDS[1], KINDS[3]])
def test_a_killed_process_loses_only_what_was_not_flushed(tmp_path, storage, compression):
    chance = random.Random(2)
    arguments = [str(tmp_path / "bag"), storage, compression or ""]
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITING, *arguments], stdout=subprocess.PIPE, text=True
    )
    flushed = 0
    for _ in range(chance.randrange(5, 30)):
        flushed = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    rest = process.communicate()[0].split()
    flushed = int(rest[-1]) if rest else flushed
    with pytest.raises(BagError, match="uros bag recover"):
        BagReader(tmp_path / "bag")
    (result,) = recover(tmp_path / "bag")
    assert result.kept >= flushed
    messages = list(BagReader(tmp_path / "bag").messages())
    assert [m.received_ns for m in messages] == list(range(result.kept))
    assert sorted(
        path.suffix for path in (tmp_path / "bag").iterdir() if "damaged" not in path.name
    )
