"""ROS 2 node my_node_serial: publishes a picture a second. See README.md."""

from camera import Camera, FrameSize, GrabMode, PixelFormat
from machine import UART, Pin
from sensor_msgs.msg import CompressedImage

from uros.client import AGENT_CONNECTED, Node
from uros.client.status import StatusLed
from uros.client.streaming import publish_stream, streaming
from uros.drivers.led import Signal
from uros.drivers.starting import attempt
from uros.transport.serial import StreamTransport

try:
    from typing import Any
except ImportError:
    pass

LARGEST = 20000  # octets
JPEG_END = b"\xff\xd9"

led0 = Pin(38, Pin.OUT)
node: "Any" = None


class Pictures:
    """Publishes a picture a second. LED2: no picture could be taken; LED3: it was too large."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.publisher = node.create_publisher(CompressedImage, "image/compressed", 10)
        self.image = CompressedImage(format="jpeg")
        self.image.header.frame_id = "myframe"
        self.led2 = Pin(40, Pin.OUT, value=0)
        self.led3 = Pin(41, Pin.OUT, value=0)
        self.camera: "Any" = None
        node.create_timer(1.0, self.tick)

    def take(self) -> "Any":
        """Return a picture; b"" if there is none, or an incomplete one."""
        try:
            if self.camera is None:
                self.camera = Camera(
                    data_pins=[11, 9, 8, 10, 12, 18, 17, 16], vsync_pin=6, href_pin=7, pclk_pin=13,
                    xclk_pin=15, sda_pin=4, scl_pin=5, pixel_format=PixelFormat.JPEG,
                    frame_size=FrameSize.QVGA, jpeg_quality=80,
                    fb_count=2, grab_mode=GrabMode.LATEST,
                )  # fmt: skip
            picture = self.camera.capture()
        except OSError as error:
            print("no camera:", error)
            return b""
        return picture if picture and bytes(picture[-2:]) == JPEG_END else b""

    def tick(self) -> None:
        if self.node.state != AGENT_CONNECTED or streaming(self.publisher):
            return  # no agent, or the previous picture is still being sent
        picture = self.take()
        self.node.clock.stamp(self.image.header.stamp)
        size = len(picture)
        self.led2.value(size == 0)
        self.led3.value(size > LARGEST)
        if 0 < size <= LARGEST:
            publish_stream(self.publisher, self.image, size, iter((picture,)))


def build() -> Node:
    line = UART(1, 921600, tx=43, rx=44, timeout=0, rxbuf=2048, txbuf=2048)
    node = Node("my_node_serial", StreamTransport(line))
    Pictures(node)
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
