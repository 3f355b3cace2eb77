"""Publishes a count on /std_msgs_msg_Int32 over the board's own access point. See README.md."""

import config
from machine import Pin
from std_msgs.msg import Int32

from uros.client import Node
from uros.client.status import StatusLed
from uros.drivers.led import Signal
from uros.drivers.starting import attempt
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.transport.udp import UdpTransport
from uros.transport.wlan import AccessPoint, Over

try:
    from typing import Any
except ImportError:
    pass

BEST_EFFORT = QoSProfile(1, reliability=ReliabilityPolicy.BEST_EFFORT)
led = Pin(22, Pin.OUT)
node: "Any" = None


def build() -> Node:
    network = AccessPoint(config.SSID, config.PASSWORD, address=config.ADDRESS)
    transport = Over(network, UdpTransport(config.AGENT, config.AGENT_PORT))
    node = Node("int32_publisher_rclc", transport, wait_ms=1000, ping_ms=1000, silence_ms=2500)
    publisher = node.create_publisher(Int32, "std_msgs_msg_Int32", BEST_EFFORT)
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
