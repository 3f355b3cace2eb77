"""rclpy clients that have just started, each of which calls a service once.

    .venv-ros/bin/python bench/first_client.py DOMAIN SERVICE COUNT

Prints ``ready``, and for each client the milliseconds from ``service_is_ready()`` to the answer.
"""

from __future__ import annotations

import os
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from test_msgs.srv import BasicTypes

SECONDS = 15.0


def first_call(number: int) -> float:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(sys.argv[1]))
    node = rclpy.create_node(f"first_{number}", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(BasicTypes, sys.argv[2])
    end = time.monotonic() + SECONDS
    while not client.service_is_ready():
        executor.spin_once(timeout_sec=0.0005)
        if time.monotonic() > end:
            raise TimeoutError("the service is not ready")
    ready = time.monotonic()
    future = client.call_async(BasicTypes.Request())
    while not future.done():
        executor.spin_once(timeout_sec=0.01)
        if time.monotonic() > end:
            raise TimeoutError("the service does not answer")
    took = time.monotonic() - ready
    node.destroy_node()
    rclpy.shutdown(context=context)
    return took


def main() -> None:
    print("ready", flush=True)
    for number in range(int(sys.argv[3])):
        print(f"{1000 * first_call(number):.1f}", flush=True)
    os._exit(0)  # an end of rclpy in several contexts may take long


if __name__ == "__main__":
    main()
