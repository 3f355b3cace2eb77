"""Sets the brightness of an LED from /micro_ros_sub. See README.md."""

from machine import PWM, UART, Pin
from std_msgs.msg import Float32

from uros.client import Node
from uros.client.status import StatusLed
from uros.drivers.led import Dimmer, Signal
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

error_led = Pin(23, Pin.OUT)
node: "Any" = None


def build() -> Node:
    led = Dimmer(PWM(Pin(22), freq=5000, duty_u16=0))
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("micro_ros_sub_node", StreamTransport(line))
    node.create_subscription(Float32, "micro_ros_sub", lambda message: led.set(message.data))
    StatusLed(node, error_led)
    return node


def start() -> None:
    global node
    node = attempt(build, Signal(error_led))


def step() -> None:
    if node is None:
        start()
    else:
        node.spin_once(0.1)


if __name__ == "__main__":
    start()
    while True:
        step()
