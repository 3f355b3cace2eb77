"""ROS 2 node my_node_serial: publishes a count, ten times a second. See README.md."""

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

led0 = Pin(38, Pin.OUT)
node: "Any" = None


def build() -> Node:
    line = UART(1, 115200, tx=43, rx=44, timeout=0, rxbuf=1024)
    node = Node("my_node_serial", StreamTransport(line))
    publisher = node.create_publisher(Int32, "my_publisher_serial", 10)
    number = Int32()

    def tick() -> None:
        if publisher.publish(number):
            number.data += 1

    node.create_timer(0.1, tick)
    StatusLed(node, led0)
    return node


def start() -> None:
    global node
    node = attempt(build, Signal(led0))


def step() -> None:
    if node is None:
        start()
    else:
        node.spin_once(0.1)


if __name__ == "__main__":
    start()
    while True:
        step()
