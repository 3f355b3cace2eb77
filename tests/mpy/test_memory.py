"""What the portable modules take of a board's heap."""

from mpy.harness import MicroPython, portable_sources

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
