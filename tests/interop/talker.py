"""A real rclpy node with one endpoint of each kind that the tools show.

Runs in an environment of its own without uros. Prints READY when all endpoints exist; ends at the
end of its input.
"""

import sys
import threading

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String
from std_srvs.srv import Trigger

RATE = 20.0
IMAGE = bytes(range(250)) * 60  # 15 kB: many fragments


def main():
    rclpy.init()
    node = rclpy.create_node("talker", namespace="/lab")
    chatter = node.create_publisher(String, "/chatter", 7)
    camera = node.create_publisher(
        CompressedImage,
        "/camera/compressed",
        QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT),
    )
    latched = node.create_publisher(
        String, "/latched", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    latched.publish(String(data="kept: yes"))
    node.create_subscription(String, "/heard", lambda message: None, 10)
    node.create_publisher(String, "/_hidden", 1)
    node.create_service(Trigger, "/lab/go", lambda request, response: response)
    node.create_client(Trigger, "/elsewhere")
    image = CompressedImage(format="jpeg", data=IMAGE)
    image.header.frame_id = "cam"

    def publish():
        chatter.publish(String(data="hello"))
        camera.publish(image)

    node.create_timer(1 / RATE, publish)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    print("READY", flush=True)
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass


if __name__ == "__main__":
    main()
