"""ROS 2 node my_node_serial: calls a service every two seconds. See README.md."""

from machine import UART, Pin
from std_srvs.srv import Trigger

from uros.client import AGENT_CONNECTED, Node
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
    client = node.create_client(Trigger, "srv_trigger_py")
    led1 = Pin(39, Pin.OUT, value=0)
    asked: "Any" = None  # the answer to come

    def ask() -> None:
        nonlocal asked
        if node.state != AGENT_CONNECTED:
            return
        if asked is not None and not asked.done():
            client.remove_pending_request(asked)
            print("no answer: does a node serve /srv_trigger_py?")
        asked = client.call_async(Trigger.Request())
        asked.add_done_callback(answered)

    def answered(future: "Any") -> None:
        if future.exception() is not None:  # the agent was lost meanwhile
            print("no answer:", future.exception())
            return
        led1.value(not led1.value())
        print("answer", future.result().success, future.result().message)

    node.create_timer(2.0, ask)
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
