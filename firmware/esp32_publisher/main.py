"""Publishes a count on /micro_ros_counter, once a second. See README.md."""

from machine import UART, Pin
from std_msgs.msg import Int32

from uros.client import Node
from uros.client.status import StatusLed
from uros.drivers.led import Signal
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

led = Pin(22, Pin.OUT)
node: "Any" = None


def build() -> Node:
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("micro_ros_pub_node", StreamTransport(line))
    publisher = node.create_publisher(Int32, "micro_ros_counter", 10)
    count = Int32()

    def tick() -> None:
        if publisher.publish(count):
            count.data += 1

    node.create_timer(1.0, tick)
    StatusLed(node, led)
    return node


def start() -> None:
    global node
    node = attempt(build, Signal(led))


def step() -> None:
    if node is None:
        start()
    else:
        node.spin_once(0.1)


if __name__ == "__main__":
    start()
    while True:
        step()
