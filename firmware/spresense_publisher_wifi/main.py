"""ROS 2 node my_node_serial: publishes a count over Wi-Fi, ten times a second. See README.md."""

import config
from machine import SPI, UART, Pin
from std_msgs.msg import Int32

from uros.client import Node
from uros.client.status import StatusLed
from uros.drivers.led import Signal
from uros.drivers.starting import attempt

try:
    from typing import Any
except ImportError:
    pass

led0 = Pin(38, Pin.OUT)
node: "Any" = None


def modem() -> "Any":
    """Return the transport for the modem that config.py names."""
    network = (config.SSID, config.PASSWORD, config.AGENT, config.PORT)
    if config.MODEM == "gs2200":
        from uros.transport.gs2200 import Gs2200Transport

        spi = SPI(1, 4000000, polarity=0, phase=1, sck=Pin(36), mosi=Pin(35), miso=Pin(37))
        return Gs2200Transport(spi, Pin(14, Pin.IN), *network, cs=Pin(21, Pin.OUT, value=1))
    if config.MODEM == "esp8266":
        from uros.transport.esp8266 import Esp8266Transport

        uart = UART(2, 115200, tx=47, rx=48, timeout=0, rxbuf=2048)
        return Esp8266Transport(uart, *network)
    raise ValueError("MODEM in config.py is %r: make it gs2200 or esp8266" % config.MODEM)


def build() -> Node:
    node = Node("my_node_serial", modem())
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
