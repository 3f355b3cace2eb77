"""Publishes a count, and prints the four states of the connection. See README.md."""

from machine import UART
from std_msgs.msg import Int32

from uros.client import Node
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

STATES = ("WAITING_AGENT", "AGENT_AVAILABLE", "AGENT_CONNECTED", "AGENT_DISCONNECTED")
node: "Any" = None


def build() -> Node:
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("micro_ros_pub_node", StreamTransport(line), wait_ms=500, ping_ms=200)
    node.on_state = lambda state: print(STATES[state])
    publisher = node.create_publisher(Int32, "micro_ros_counter", 10)
    count = Int32()

    def tick() -> None:
        if publisher.publish(count):
            count.data += 1

    node.create_timer(1.0, tick)
    print(STATES[node.state])
    return node


def start() -> None:
    global node
    node = attempt(build)


def step() -> None:
    if node is None:
        start()
    else:
        node.spin_once(0.1)


if __name__ == "__main__":
    start()
    while True:
        step()
