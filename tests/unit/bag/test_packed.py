"""Bags that rosbag2 has compressed itself: whole files, and each message."""

import errno
import shutil
import sys

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from support.bag_network import Network

from uros.bag import compression, packed
from uros.bag.errors import BagError
from uros.bag.metadata import read_metadata, write_metadata
from uros.bag.reader import BagReader
from uros.bag.reindex import reindex
from uros.tools import cli
from uros.tools.bag import play

START = 1_700_000_000_000_000_000
COUNT = 20
# Python's own module, or its twin for earlier versions, which rosbags needs.
OWN_MODULE = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
MODES = {"file": CompressionMode.FILE, "message": CompressionMode.MESSAGE}
EVERY = pytest.mark.parametrize("bag", [(s, m) for s in STORAGES for m in MODES], indirect=True)
FILES = pytest.mark.parametrize("bag", [("sqlite3", "file")], indirect=True)
MESSAGES = pytest.mark.parametrize(
    "bag", [("mcap", "message"), ("sqlite3", "message")], indirect=True
)


def cdr(number):
    return b"\0\1\0\0" + number.to_bytes(4, "little") * (number * 600)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Makes a bag by rosbags, once for each storage and mode."""
    folders = {}

    def make(storage, mode):
        if (storage, mode) not in folders:
            folder = folders[storage, mode] = tmp_path_factory.mktemp("made") / "bag"
            writer = RosbagsWriter(folder, version=9, storage_plugin=STORAGES[storage])
            writer.set_compression(MODES[mode], CompressionFormat.ZSTD)
            with writer:
                link = writer.add_connection(
                    "/a", "std_msgs/msg/String", typestore=get_typestore(Stores.ROS2_HUMBLE)
                )
                for number in range(COUNT):
                    writer.write(link, START + number, cdr(number))
        return folders[storage, mode]

    return make


@pytest.fixture
def bag(made, request, tmp_path, monkeypatch):
    """A bag of a storage and a mode, and no temporary files elsewhere."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    yield shutil.copytree(made(*request.param), tmp_path / "bag")
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.fixture
def without_zstd(monkeypatch):
    for module in ("compression.zstd", "zstandard"):
        monkeypatch.setitem(sys.modules, module, None)


@pytest.fixture
def network(monkeypatch):
    """What a bag is played to."""
    network = Network()
    monkeypatch.setattr(play, "join", lambda args, node_name: network)
    return network


def only_file(bag):
    (file,) = BagReader(bag).files
    return file


def content(uri):
    return [(message.cdr, message.received_ns) for message in BagReader(uri).messages()]


EXPECTED = [(cdr(number), START + number) for number in range(COUNT)]


@EVERY
@pytest.mark.parametrize("module", ["zstandard", OWN_MODULE])
def test_a_bag_and_its_file_are_read(bag, monkeypatch, module):
    monkeypatch.setitem(compression._MODULES, "zstd", (module,))
    assert content(bag) == EXPECTED
    (topic,) = BagReader(bag).topics
    assert "string data" in topic.definition
    some = BagReader(bag).messages(["/a"], START + 3, START + 5)
    assert [message.received_ns - START for message in some] == [3, 4]
    file = BagReader(only_file(bag))
    assert file.metadata.message_count == COUNT
    assert [each.path for each in file.metadata.files] == [only_file(bag).name]
    assert content(only_file(bag)) == EXPECTED


@EVERY
def test_info_needs_no_package(bag, without_zstd, capsys):
    assert cli.main(["bag", "info", str(bag)]) == 0
    assert f"Messages:          {COUNT}\n" in capsys.readouterr().out


@EVERY
def test_the_error_names_the_extra(bag, without_zstd, network, capsys):
    """And nothing is left of a conversion that began."""
    for command in (["info", "-v", bag], ["convert", bag, bag.parent / "out"], ["play", bag]):
        assert cli.main(["bag", *map(str, command)]) == 1
        err = capsys.readouterr().err
        assert f"{only_file(bag)} is compressed: zstd needs the package zstandard" in err
        assert "pip install 'uros[compression]'" in err and err.count("\n") == 1
    assert not (bag.parent / "out").exists()


@EVERY
def test_a_conversion_unpacks(bag):
    assert cli.main(["bag", "convert", str(bag), str(bag.parent / "out")]) == 0
    assert content(bag.parent / "out") == EXPECTED
    metadata = BagReader(bag.parent / "out").metadata
    assert (metadata.compression_mode, metadata.compression_format) == ("", "")


@EVERY
def test_a_bag_is_played(bag, network):
    assert cli.main(["bag", "play", str(bag)]) == 0
    assert network.written == [("rt/a", cdr) for cdr, _ in EXPECTED]


@MESSAGES
def test_metadata_written_anew_say_that_messages_are_compressed(bag):
    (bag / "metadata.yaml").unlink()
    reindex(bag)
    metadata = read_metadata(bag)
    assert (metadata.compression_mode, metadata.compression_format) == ("message", "zstd")
    assert content(bag) == EXPECTED


@FILES
def test_recovery_refuses_compressed_files(bag, capsys):
    for command in ("reindex", "recover"):
        assert cli.main(["bag", command, str(bag)]) == 1
        assert "'zstd -d bag.db3.zstd -o bag.db3'" in capsys.readouterr().err


@FILES
@pytest.mark.parametrize(
    "damage, said",
    [(lambda data: data[:-9], "it is cut off"), (lambda data: b"x" + data, "bag.db3.zstd: ")],
)
def test_a_damaged_file_is_refused(bag, damage, said):
    file = only_file(bag)
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(BagError, match=f"{said}.*a whole copy of the file is needed"):
        content(bag)


@FILES
def test_a_full_disk_names_the_folder_of_temporary_files(bag, monkeypatch):
    def steps(file):
        yield file.read(10)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(packed, "_steps", steps)
    with pytest.raises(BagError, match=r"No space left on device; have TMPDIR name a folder"):
        content(bag)


@MESSAGES
def test_a_damaged_message_is_named(bag, monkeypatch):
    reader = BagReader(bag)
    real = packed.PackedMessages._unpacked

    def unpacked(self, message, unpack):
        cut = message.cdr[:-3] if message.received_ns == START + 7 else message.cdr
        return real(self, message._replace(cdr=cut), unpack)

    monkeypatch.setattr(packed.PackedMessages, "_unpacked", unpacked)
    messages = reader.messages()
    assert [next(messages).cdr for _ in range(7)] == [each for each, _ in EXPECTED[:7]]
    with pytest.raises(BagError, match=rf"a message of /a at {START + 7} ns .* is cut off"):
        next(messages)


@MESSAGES
def test_a_message_that_unpacks_to_too_much_is_refused(bag, monkeypatch):
    monkeypatch.setattr(packed, "_MOST", 10_000)
    with pytest.raises(BagError, match="it unpacks to over"):
        content(bag)


@MESSAGES
@pytest.mark.parametrize("mode, form", [("message", "lz5"), ("topic", "zstd"), ("file", "")])
def test_a_compression_that_is_unknown_is_refused(bag, mode, form):
    metadata = read_metadata(bag)
    metadata.compression_mode, metadata.compression_format = mode, form
    write_metadata(bag, metadata)
    with pytest.raises(
        BagError, match=f"_mode '{mode}' and .*'{form}'; uros reads zstd .*'ros2 bag conv"
    ):
        BagReader(bag)


@pytest.mark.parametrize("bag", [("mcap", "message")], indirect=True)
def test_no_compression_may_have_a_name(bag):
    metadata = read_metadata(bag)
    metadata.compression_mode = "NONE"
    write_metadata(bag, metadata)
    assert BagReader(bag).metadata.compression_mode == ""
