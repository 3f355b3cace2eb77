"""Measures the heap, garbage and time on a board; prints one JSON object: ``make bench-board``.

Measured on MicroPython 1.27 (WebAssembly: 32-bit pointers, as on boards), from .mpy, built by `uros
board build`; each figure is the median of three runs, each in an interpreter of its own.

==========================  ====================================================================
``core_kb``                 the client of ``tests/mpy/measures.py``'s CORE: a node with publishers,
                            subscriptions, services and clients, timers and the executor, the
                            states and their callback, reconnection, time synchronisation,
                            reliable and best-effort streams, and fragments both ways
``int32_kb``, ``imu_kb``    in addition, publishing and receiving std_msgs/Int32, sensor_msgs/Imu
``node_kb``, ``peak_kb``    ``firmware/ra6m5_sensor_node`` while it publishes, and its high water
                            at the start and while it publishes
``publish_alloc_bytes``     garbage of stamping and publishing a Temperature, and of spinning
``imu_encode_ratio`` …      as a multiple of one call of ``struct`` for the whole record
``twist_publish_ratio``     publishing a Twist, as a multiple of encoding it
==========================  ====================================================================

A kB is 1000 bytes. tests/mpy/test_memory.py checks the goals.
"""

from __future__ import annotations

import json
import statistics
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import board_codec  # noqa: E402
from mpy import measures  # noqa: E402
from mpy.harness import MicroPython  # noqa: E402

RUNS = 3
RATIOS = ("imu_encode_ratio", "imu_decode_ratio", "odometry_encode_ratio", "odometry_decode_ratio")
NAMES = (
    "core_kb", "int32_kb", "imu_kb", "node_kb", "peak_kb", "publish_alloc_bytes", *RATIOS,
    "twist_publish_ratio",
)  # fmt: skip


def heap(program: str) -> int:
    with MicroPython() as board:
        return measures.heap_of_program(board, program)


def run() -> dict[str, float]:
    core = heap(measures.CORE)
    figures: dict[str, float] = {"core_kb": core / 1000}
    for key, module, name in (("int32", "std_msgs", "Int32"), ("imu", "sensor_msgs", "Imu")):
        typed = measures.TYPED.format(module=module + ".msg", name=name)
        figures[key + "_kb"] = (heap(measures.CORE + typed) - core) / 1000
    used, peak = measures.heap_of_the_sensor_node()
    figures["node_kb"], figures["peak_kb"] = used / 1000, peak / 1000
    with MicroPython() as board:
        measures.running(board)
        figures["publish_alloc_bytes"] = measures.publish_allocates(board)
        figures["twist_publish_ratio"] = measures.twist_ratio(board)
    with MicroPython() as board:
        board_codec.install(board)
        ratios = board_codec.measure(board)
    figures.update({name: ratios[name] for name in RATIOS})
    return figures


def main() -> int:
    runs = [run() for _ in range(RUNS)]
    print(
        json.dumps({n: round(statistics.median(figures[n] for figures in runs), 2) for n in NAMES})
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
