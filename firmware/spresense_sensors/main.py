"""ROS 2 node my_node_serial: ten kinds of sensor messages over one serial line. See README.md."""

from machine import UART, Pin
from sensors import Camera, Gnss, I2CSensors

from uros.client import Node
from uros.client.status import StatusLed
from uros.drivers.bus import Bus
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
    satellites = UART(2, 9600, tx=47, rx=48, timeout=0, rxbuf=1024)
    node = Node("my_node_serial", StreamTransport(line))
    # A transfer takes half a millisecond; the limit of 5 ms bounds the delay by a shorted bus.
    I2CSensors(node, Bus(0, 2, frequency=400000, timeout_us=5000, sda=1))
    Gnss(node, satellites)
    Camera(node)
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
