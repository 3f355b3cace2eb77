"""What the portable modules take of a board's heap."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest
from mpy.harness import MicroPython, portable_sources, tree

from uros.boards.build import build

# Compiled from source on the board. About what it takes today and a tenth more: who adds to it
# is to notice. Below a heap of 100 kB every kilobyte counts.
LIMIT = 39_000


def test_heap_of_wire(micropython: MicroPython) -> None:
    sources = portable_sources(["wire"])
    micropython.install(sources)
    micropython.run("import gc, struct, sys, array")
    before = last = micropython.heap()
    print()
    for path in sources:
        if path == "uros/__init__.py":
            continue
        name = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert micropython.run(f"import {name}") == ""
        now = micropython.heap()
        print(f"{name:20}{now - last:7}")
        last = now
    print(f"{'all':20}{last - before:7} bytes")
    assert last - before < LIMIT


def heap_of(
    board: MicroPython, files: Mapping[str, str | bytes], statements: Iterable[str]
) -> dict[str, int]:
    """Bytes that each statement leaves on the heap of a board with these files, in their order.

    Names are kept in tables that double, so one more name may cost a kilobyte or two, and many
    nothing: compare sums, not single lines.
    """
    board.install(files)
    board.run("import array, errno, gc, os, select, struct, sys, time")
    board.heap()
    last = board.heap()
    costs = {}
    for statement in statements:
        board.run(statement)
        now = board.heap()
        costs[statement] = now - last
        last = now
    return costs


# What a node does not need, the build drops.
NODE = """
from sensor_msgs.msg import RelativeHumidity, Temperature
from std_msgs.msg import String, UInt16
from uros.client import Node
from uros.transport.stream import StreamTransport

def run(port):
    node = Node("node", StreamTransport(port))
    publisher = node.create_publisher(Temperature, "topic", 10)
    node.create_subscription(String, "other", print, 10)
    node.create_timer(1.0, lambda: publisher.publish(Temperature()))
    node.spin()
"""
IMPORTS = (
    "from uros.client import Node",
    "from uros.transport.stream import StreamTransport",
    "from sensor_msgs.msg import RelativeHumidity, Temperature",
    "from std_msgs.msg import String, UInt16",
)


# As LIMIT above.
NODE_LIMIT = {"py": 57_000, "mpy": 48_000}


@pytest.mark.parametrize("form", ["py", "mpy"])
def test_heap_of_a_built_node(micropython: MicroPython, tmp_path: Path, form: str) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(NODE, encoding="utf-8")
    build(program, tmp_path / "out", form)
    costs = heap_of(micropython, tree(tmp_path / "out"), IMPORTS)
    print()
    for statement, cost in costs.items():
        print(f"{form:4}{statement:60}{cost:7}")
    print(f"{form:4}{'all':60}{sum(costs.values()):7} bytes")
    assert sum(costs.values()) < NODE_LIMIT[form]


WITHOUT_ALLOCATION = """
import micropython
from uros.wire import header, session, streams
from uros.wire.cdr import Writer
from uros.wire.framing import crc16, frame

payload = bytes(range(256))
view = memoryview(payload)
framed = bytearray(600)
buf = bytearray(400)
w = Writer(buf)

def run():
    frame(payload, 1, 0, framed)
    frame(view, 1, 0, framed)
    at = header.push_header(buf, 0x81, 0x80, 65535)
    w.start = w.offset = header.push_subheader(buf, at, 10, 1, 5)
    session.push_acknack(w, 65535, 0x8001, 0x80)
    w.offset = w.start
    session.push_heartbeat(w, 65530, 65535, 0x80)
    w.u32(1 << 29)
    w.octets(view)
    streams.ticks_diff(streams.ticks_add(5, 10), 3)

run()
micropython.heap_lock()
try:
    run()
finally:
    micropython.heap_unlock()
"""


def test_sending_does_not_allocate(micropython: MicroPython) -> None:
    """What runs for each message on a board that is publishing, with the heap locked."""
    micropython.install(portable_sources(["wire"]))
    micropython.run(WITHOUT_ALLOCATION)
