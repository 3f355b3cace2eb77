"""Sets the brightness of an LED, and prints the four states of the connection. See README.md."""

from machine import PWM, UART, Pin
from std_msgs.msg import Float32

from uros.client import Node
from uros.drivers.led import Dimmer
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

STATES = ("WAITING_AGENT", "AGENT_AVAILABLE", "AGENT_CONNECTED", "AGENT_DISCONNECTED")
node: "Any" = None


def build() -> Node:
    led = Dimmer(PWM(Pin(22), freq=5000, duty_u16=0))
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("micro_ros_sub_node", StreamTransport(line), wait_ms=500, ping_ms=200)
    node.on_state = lambda state: print(STATES[state])
    node.create_subscription(Float32, "micro_ros_sub", lambda message: led.set(message.data))
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
