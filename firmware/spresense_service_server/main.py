"""ROS 2 node my_node_serial: a service that switches an LED. See README.md."""

from machine import UART, Pin
from std_srvs.srv import Trigger

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
    count = 0

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        nonlocal count
        response.success = count % 2 == 0
        response.message = "Response[%d]" % count
        count += 1
        led1.value(response.success)
        print("answered", response.success, response.message)
        return response

    node.create_service(Trigger, "srv_trigger_serial", answer)
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
