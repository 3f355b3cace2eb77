"""Measures a board's encoding and decoding of a message, in calls of ``struct``.

The unit is one call of ``struct.pack_into`` (``unpack_from``) for the whole record, from an
existing tuple and with a constant format, which is a lower bound for a codec in Python. The record
is all numbers of the message, its strings as ``Ns``, and padding. One interpreter times both
alternately in one run, less the time of the loop; the shortest time of each counts, since load only
adds. ::

    with MicroPython() as board:
        install(board)
        measure(board)  # {"imu_encode_ratio": 3.1, ...}

``board`` is the MicroPython of ``tests/mpy/harness.py``. As a program it prints one JSON object.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[1]
ROUNDS: Final = 3
REPEATED: Final = 40
WARM: Final = 300
TURNS: Final = {"empty": 1000, "pack": 500, "unpack": 400, "encode": 80, "decode": 60}
"""Some milliseconds each: longer turns would be interrupted by other processes."""

# Name, module and class, record. The texts are "imu_link", "odom" and "base_link".
MESSAGES: Final = (
    ("imu", "sensor_msgs", "Imu", "<iII9s3x37d"),
    ("odometry", "nav_msgs", "Odometry", "<iII5s3xI10s2x7d36d6d36d"),
    ("twist", "geometry_msgs", "Twist", "<6d"),
)

_PROGRAM: Final = """
from sensor_msgs.msg import Imu
from nav_msgs.msg import Odometry
from geometry_msgs.msg import Twist

def use(message, buf):
    message.header.stamp.sec = message.header.stamp.nanosec = message.cdr_size()
    message.header.frame_id = message.child_frame_id = ""
    message.pack_into(buf, 0, 0)
    message.unpack_into(buf, 0, 0, 0)
    message.unpack_from(buf, 0, 0, 0)
"""

# The loops differ in one statement, so that the time of the loop can be subtracted.
_LOOP: Final = """
def {name}(buf, size, record, message):
    for _ in range({turns}):
        {statement}
"""
_STATEMENTS: Final = {
    "empty": "pass",
    "pack": "pack_into({format!r}, buf, 0, *record)",
    "unpack": "unpack_from({format!r}, buf, 0)",
    "encode": "message.pack_into(buf, 0, 0)",
    "decode": "message.unpack_into(buf, 0, 0, size)",
}
_SETUP: Final = """
import gc
from js import performance  # this build's time.ticks_us() counts milliseconds
from struct import pack_into, unpack_from
from {module}.msg import {cls}

message = {cls}()
if hasattr(message, "header"):
    message.header.stamp.sec = 1700000000
    message.header.stamp.nanosec = 123456789
    message.header.frame_id = "imu_link" if {cls!r} == "Imu" else "odom"
if hasattr(message, "child_frame_id"):
    message.child_frame_id = "base_link"
buf = bytearray(message.cdr_size())
size = len(buf)
message.pack_into(buf, 0, 0)
record = unpack_from({format!r}, buf, 0)
again = bytearray(size)
pack_into({format!r}, again, 0, *record)
assert again == buf, "the record is not the message"

def took(loop):
    start = performance.now()
    loop(buf, size, record, message)
    return performance.now() - start

def garbage(call, *args):
    call(*args)
    gc.disable()
    before = gc.mem_alloc()
    call(*args)
    taken = gc.mem_alloc() - before
    gc.enable()
    return taken
"""


def install(board: Any, form: str = "mpy") -> None:
    """Put the built messages on the board."""
    from uros.boards.builder.file_system import build

    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "program")
        program.mkdir()
        (program / "main.py").write_text(_PROGRAM, encoding="utf-8")
        out = Path(folder, "out")
        build(program, out, form)
        files = [file for file in sorted(out.rglob("*")) if file.is_file()]
        board.install({file.relative_to(out).as_posix(): file.read_bytes() for file in files})


def measure(board: Any) -> dict[str, float]:
    """The ratios of Imu, Odometry and Twist, and the garbage of one call."""
    ratios: dict[str, float] = {}
    best: dict[str, float] = {}
    for turn in range(ROUNDS + 1):
        for name, module, cls, format in MESSAGES:
            board.run(_SETUP.format(module=module, cls=cls, format=format))
            for loop, statement in _STATEMENTS.items():
                text = statement.format(format=format)
                board.run(_LOOP.format(name=loop, turns=TURNS[loop], statement=text))
            # The first ones warm up the engine below MicroPython, which compiles hot code.
            for _ in range(REPEATED if turn else WARM):
                for loop, turns in TURNS.items():
                    # One call for each: the collector runs between them.
                    each = float(board.run(f"print(took({loop}))")) / turns
                    if turn:
                        key = f"{name}_{loop}"
                        best[key] = min(best.get(key, each), each)
            for call in ("pack_into, buf, 0, 0", "unpack_into, buf, 0, 0, size"):
                kind = "encode" if call.startswith("pack") else "decode"
                ratios[f"{name}_{kind}_bytes"] = int(board.run(f"print(garbage(message.{call}))"))
    for name, *_ in MESSAGES:
        empty = best[f"{name}_empty"]
        for ours, unit in (("encode", "pack"), ("decode", "unpack")):
            ratio = (best[f"{name}_{ours}"] - empty) / (best[f"{name}_{unit}"] - empty)
            ratios[f"{name}_{ours}_ratio"] = round(ratio, 2)
    return ratios


def main() -> int:
    sys.path.insert(0, str(ROOT / "tests"))
    from mpy.harness import MicroPython

    for form in sys.argv[1:] or ("mpy", "py"):
        with MicroPython() as board:
            install(board, form)
            print(json.dumps({"form": form, **measure(board)}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
