"""Switches an LED by a button, and sets its brightness from ROS. See README.md."""

from machine import PWM, UART, Pin
from std_msgs.msg import Float32, String

from uros.client import Node
from uros.drivers.button import Button
from uros.drivers.led import Dimmer
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

node: "Any" = None


def build() -> Node:
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("esp32_button_led_node", StreamTransport(line))
    led = Dimmer(PWM(Pin(22), freq=5000, duty_u16=0), on=False)
    button = Button(Pin(23, Pin.IN, Pin.PULL_UP), node.clock.ms)
    publisher = node.create_publisher(String, "button_state", 10)
    state = String()

    def poll_button() -> None:
        if button.clicked():
            led.switch(not led.on)

    def publish_state() -> None:
        state.data = "active" if led.on else "inactive"
        publisher.publish(state)

    node.create_subscription(Float32, "led_brightness", lambda message: led.set(message.data))
    node.create_timer(0.01, poll_button)
    node.create_timer(0.1, publish_state)
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
