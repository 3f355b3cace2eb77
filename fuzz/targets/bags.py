"""Files of bags: any bytes are read, or refused by BagError, and recovered likewise.

The first byte chooses the file: MCAP, SQLite, or ``metadata.yaml``. What recovery keeps is a whole
bag afterwards, with as many messages as it says.
"""

import atexit
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from pathlib import Path
from random import Random

from uros.bag.errors import BagError
from uros.bag.metadata import TopicMetadata, read_metadata
from uros.bag.reader import BagReader
from uros.bag.recover import recover
from uros.bag.writer import BagWriter
from uros.qos import QoSProfile

from .records import MutateBytes
from .world import must

MCAP, SQLITE, METADATA = range(3)
_NAMES = ("bag_0.mcap", "bag_0.db3", "metadata.yaml")
_MOST = 10_000  # messages of a file; more are read in vain


def one_input(data: bytes) -> None:
    if not data:
        return
    kind = data[0] % len(_NAMES)
    folder = _scratch() / "bag"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    path = folder / _NAMES[kind]
    path.write_bytes(data[1:])
    if kind == METADATA:
        _refused_or(lambda: read_metadata(folder))
        return
    _refused_or(lambda: _read(path))
    try:
        (result,) = recover(folder)
    except BagError:
        must(path.read_bytes() == data[1:], "an original is changed though nothing was recovered")
        must([path] == list(folder.iterdir()), "an unfinished file is left")
        return
    must(sum(1 for _ in BagReader(folder).messages()) == result.kept, "messages of the new bag")


def _read(path: Path) -> None:
    reader = BagReader(path)
    last = 0
    for count, message in enumerate(reader.messages()):
        must(last <= message.received_ns, "the order of time")
        last = message.received_ns
        if count > _MOST:
            return
    must(len(reader.topics) < 70_000, "topics")


def _refused_or(read) -> None:  # type: ignore[no-untyped-def]
    try:
        read()
    except BagError as error:
        must(len(str(error)) < 2000, "a text for people")


@cache
def _scratch() -> Path:
    memory = Path("/dev/shm")  # where writing does not wait for a disk
    folder = Path(tempfile.mkdtemp("", "uros-fuzz-", memory if memory.is_dir() else None))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def seeds() -> Iterator[tuple[str, bytes]]:
    folder = _scratch() / "seeds"
    for name, options in (
        ("plain", {}),
        ("zstd", {"compression": "zstd"}),
        ("lz4", {"compression": "lz4"}),
        ("sqlite", {"storage": "sqlite3"}),
        ("empty", {}),
    ):
        shutil.rmtree(folder, ignore_errors=True)
        with BagWriter(folder, chunk_size=300, ros_distro="kilted", **options) as writer:  # type: ignore[arg-type]
            topics = [
                TopicMetadata(topic, "x/msg/Y", [QoSProfile(3)], "RIHS01_", "int8 data")
                for topic in ("/a", "/b")
            ]
            ids = [writer.add_topic(topic) for topic in topics]
            for number in range(0 if name == "empty" else 12):
                writer.write(ids[number % 2], bytes(20), number * 7 % 12, number)
        file = folder / writer.metadata.files[0].path
        if name == "sqlite":
            with closing(sqlite3.connect(file)) as database:  # 28 kB with pages of 4096 bytes
                database.execute("PRAGMA page_size=512")
                database.execute("VACUUM")
        yield name, bytes([SQLITE if name == "sqlite" else MCAP]) + file.read_bytes()
        if name == "plain":
            yield "metadata", bytes([METADATA]) + (folder / "metadata.yaml").read_bytes()


def mutate(data: bytes, random: Random, mutate_bytes: MutateBytes) -> bytes:
    if len(data) < 2:
        return mutate_bytes(data)
    place = random.randrange(1, len(data))
    kind = random.randrange(4)
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + bytes([data[place] ^ 1 << random.randrange(8)]) + data[place + 1 :]
    if kind == 2:  # a length or a time
        number = random.choice((0, 1, 0xFF, 0xFFFF, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1))
        return data[:place] + number.to_bytes(8, "little") + data[place + 8 :]
    return data[:1] + mutate_bytes(data[1:])
