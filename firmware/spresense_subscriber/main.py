"""ROS 2 node my_node_serial: a number switches an LED. See README.md."""

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
    led1 = Pin(39, Pin.OUT, value=0)

    def switch(number: Int32) -> None:
        led1.value(number.data != 0)

    node.create_subscription(Int32, "my_subscriber_serial", switch)
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
