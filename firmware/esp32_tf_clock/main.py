"""Publishes a transform and the ROS time of the board. See README.md."""

import math
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from machine import RTC, UART, Pin

from uros.client import AGENT_CONNECTED, Node
from uros.client.status import StatusLed
from uros.client.tf import TransformBroadcaster
from uros.drivers.led import Signal
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

TURN = 0.5  # rad/s, counter-clockwise seen from above
PERIOD = 0.1
TO_1970 = 0 if time.gmtime(0)[0] == 1970 else 946684800  # ports count from 1970 or from 2000

led = Pin(22, Pin.OUT)
node: "Any" = None


def set_clock(seconds: int, nanoseconds: int) -> None:
    """Set the board's real-time clock to a UTC time, which time.time() returns from then on."""
    year, month, day, hour, minute, second, weekday, _ = time.gmtime(seconds - TO_1970)
    RTC().datetime((year, month, day, weekday, hour, minute, second, nanoseconds // 1000))
    print("the clock is set: %d-%02d-%02d %02d:%02d:%02d UTC" % time.gmtime()[:6])


def build() -> Node:
    line = UART(2, 115200, tx=17, rx=16, timeout=0, rxbuf=512)
    node = Node("esp32_tf_clock", StreamTransport(line))
    broadcaster = TransformBroadcaster(node)
    publisher = node.create_publisher(Time, "board_time", 10)
    now = Time()
    sensor = TransformStamped()
    sensor.header.frame_id, sensor.child_frame_id = "base_link", "sensor"
    sensor.transform.translation.z = 0.3
    angle = 0.0

    def publish_transform() -> None:
        nonlocal angle
        angle = (angle + TURN * PERIOD) % (2 * math.pi)
        sensor.transform.rotation.z = math.sin(angle / 2)
        sensor.transform.rotation.w = math.cos(angle / 2)
        node.clock.stamp(sensor.header.stamp)
        broadcaster.sendTransform(sensor)

    def publish_time() -> None:
        node.clock.stamp(now)
        publisher.publish(now)

    def on_state(state: int) -> None:
        if state == AGENT_CONNECTED:  # a connected node has the agent's time
            set_clock(*node.clock.now())

    node.create_timer(PERIOD, publish_transform)
    node.create_timer(1.0, publish_time)
    node.on_state = on_state
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
