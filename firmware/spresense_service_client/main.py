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
    pending: "Any" = None  # the future of the last call

    def call() -> None:
        nonlocal pending
        if node.state != AGENT_CONNECTED:
            return
        if pending is not None and not pending.done():
            client.remove_pending_request(pending)
            print("no answer: does a node serve /srv_trigger_py?")
        pending = client.call_async(Trigger.Request())
        pending.add_done_callback(on_response)

    def on_response(future: "Any") -> None:
        if future.exception() is not None:  # the session ended before the response
            print("no answer:", future.exception())
            return
        led1.value(not led1.value())
        print("answer", future.result().success, future.result().message)

    node.create_timer(2.0, call)
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
