"""Notes when messages arrive at an rclpy node, for bags.py.

    python bench/bag_listener.py COUNT

It prints ``ready``, and after COUNT messages a line of JSON: for each its number and the monotonic
time of its arrival, in ns.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import UInt8MultiArray


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("bag_listener")
    arrivals: list[tuple[int, int]] = []

    def arrived(cdr: bytes) -> None:
        arrivals.append((int.from_bytes(cdr[4:12], "little"), time.monotonic_ns()))

    node.create_subscription(UInt8MultiArray, "/bench", arrived, 1000, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    end = time.monotonic() + 120
    while len(arrivals) < int(sys.argv[1]) and time.monotonic() < end:
        executor.spin_once(1.0)
    print(json.dumps(arrivals), flush=True)


if __name__ == "__main__":
    main()
