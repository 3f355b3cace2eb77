"""SprTurtleBot, a rover with a camera, on ROS 2 over Wi-Fi. The main core. See README.md."""

import config
import machine
from camera import Camera, FrameSize, GrabMode, PixelFormat
from cores import start_sub_core
from geometry_msgs.msg import Twist
from machine import SPI, Pin
from mail import COMMAND, NOTE, ODOMETRY, POWER
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Bool, Empty

from uros.client import AGENT_CONNECTED, Node
from uros.client.status import StatusLed
from uros.client.streaming import publish_stream, streaming
from uros.drivers import SensorError, reason
from uros.drivers.led import Signal
from uros.drivers.starting import attempt
from uros.transport.gs2200 import Gs2200Transport

try:
    from typing import Any
except ImportError:
    pass

NAME = "my_node_serial"
JPEG_END = b"\xff\xd9"

led0 = Pin(config.LED0, Pin.OUT)


class MainCore:
    """The node, its topics and the camera."""

    def __init__(self) -> None:
        self.led2 = Pin(config.LED2, Pin.OUT, value=0)
        spi = SPI(
            1, 4000000, polarity=0, phase=1,
            sck=Pin(config.SCK), mosi=Pin(config.MOSI), miso=Pin(config.MISO),
        )  # fmt: skip
        modem = Gs2200Transport(
            spi, Pin(config.DATA_READY, Pin.IN), config.SSID, config.PASSWORD, config.AGENT,
            config.PORT, cs=Pin(config.CS, Pin.OUT, value=1),
        )  # fmt: skip
        self.camera: "Any" = None
        self.shooting = False
        self.powered = False
        # While the camera's driver starts, it blocks all of MicroPython, threads of a second core
        # included: the camera starts before the motors can be switched on.
        self.camera_fault = self.start_camera()
        self.to_sub, self.from_sub = start_sub_core()

        self.image = CompressedImage(format="jpeg")
        self.image.header.frame_id = "myframe"
        self.odometry = Odometry(child_frame_id="base_footprint")
        self.odometry.header.frame_id = "odom"

        self.node = node = Node(NAME, modem)
        self.log = node.get_logger()
        self.images = node.create_publisher(CompressedImage, "image/compressed", 10)
        self.odometries = node.create_publisher(Odometry, "odom", 10)
        node.create_subscription(Bool, "motor_power", self.on_motor_power)
        node.create_subscription(Empty, "reset", self.on_reset)
        node.create_subscription(Twist, "cmd_vel", self.on_cmd_vel, 1)
        node.create_subscription(Empty, "take_picture", self.on_take_picture)
        node.create_timer(1.0, self.ask_odometry)
        StatusLed(node, led0)

    # Messages to the sub core (power, commands, odometry requests), and its answers.

    def on_motor_power(self, message: "Any") -> None:
        self.powered = message.data
        self.to_sub.send(COMMAND, None)  # replaces a command that is still in the mailbox
        self.to_sub.send(POWER, message.data)
        self.log.info("motors on" if message.data else "motors off")

    def on_cmd_vel(self, message: "Any") -> None:
        self.to_sub.send(COMMAND, (message.linear.x, message.angular.z))

    def ask_odometry(self) -> None:
        if self.node.state == AGENT_CONNECTED:
            self.to_sub.send(ODOMETRY)

    def read_mail(self) -> None:
        number = self.from_sub.receive()
        while number:
            if number == ODOMETRY:
                self.publish_odometry(self.from_sub.value)
            elif number == NOTE:
                self.log.warning(self.from_sub.value, throttle_duration_sec=5)
            number = self.from_sub.receive()

    def publish_odometry(self, answer: "Any") -> None:
        message = self.odometry
        self.node.clock.stamp(message.header.stamp)
        x, y, qz, qw, v, w, message.pose.covariance, message.twist.covariance = answer
        message.pose.pose.position.x = x
        message.pose.pose.position.y = y
        message.pose.pose.orientation.z = qz
        message.pose.pose.orientation.w = qw
        message.twist.twist.linear.x = v
        message.twist.twist.angular.z = w
        self.odometries.publish(message)

    # Topics that the main core handles.

    def on_reset(self, message: "Any") -> None:
        machine.reset()

    def on_take_picture(self, message: "Any") -> None:
        if self.shooting:
            self.log.warning("take_picture is ignored: the last picture is still being sent")
            return
        self.shooting = True
        self.led2.value(1)
        self.node.clock.stamp(self.image.header.stamp)
        try:
            picture = self.capture()
        except (OSError, SensorError) as error:
            self.log.error("no picture: " + reason(error))
        else:
            publish_stream(self.images, self.image, len(picture), iter((picture,)))
        self.end_picture()

    def start_camera(self) -> str:
        """Start the camera, with the motors off; return the reason of a failure, or ''."""
        try:
            self.camera = Camera(
                pixel_format=PixelFormat.JPEG, frame_size=FrameSize.QVGA, jpeg_quality=80,
                fb_count=2, grab_mode=GrabMode.LATEST, **config.CAMERA,
            )  # fmt: skip
        except OSError as error:
            return reason(error)
        return ""

    def capture(self) -> "Any":
        """Return a JPEG picture in the camera's buffer; raise OSError or SensorError."""
        if self.camera is None and not self.powered:
            self.camera_fault = self.start_camera()
        if self.camera is None:
            hint = "; with the motors off it is tried again" if self.powered else ""
            raise SensorError("the camera does not start: " + self.camera_fault + hint)
        picture = self.camera.capture()
        if not picture or bytes(picture[-2:]) != JPEG_END:
            raise SensorError("the camera gave %s" % ("half of one" if picture else "none"))
        return picture

    def end_picture(self) -> None:
        """Free the picture's buffer once it is sent."""
        if self.shooting and not streaming(self.images):
            self.shooting = False
            self.led2.value(0)
            if self.camera is not None:
                self.camera.free_buffer()

    def step(self) -> None:
        self.node.spin_once(0.1)
        self.read_mail()
        self.end_picture()


core: "MainCore | None" = None


def start() -> None:
    global core
    core = attempt(MainCore, Signal(led0))


def step() -> None:
    if core is None:
        start()
    else:
        core.step()


if __name__ == "__main__":
    start()
    while True:
        step()
