"""peer.py that also publishes: numbers, stamped poses, and a clock that is faster than time."""

import rclpy
from geometry_msgs.msg import Pose, PoseArray
from peer import Peer
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32, String

RATE = 50.0
AGE = 2.0  # seconds by which the poses are older than now
SPEED = 10  # seconds on /clock in a second


class TopicPeer(Peer):
    def __init__(self):
        super().__init__()
        node = self.node
        self._numbers = node.create_publisher(Int32, "/numbers", 10)
        self._poses = node.create_publisher(PoseArray, "/poses", 10)
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._evil = node.create_publisher(String, "/evil", 10)
        self._count = 0
        self._started = node.get_clock().now()
        node.create_timer(1 / RATE, self._publish)

    def _publish(self):
        now = self.node.get_clock().now()
        self._count += 1
        self._numbers.publish(Int32(data=self._count))
        poses = PoseArray(poses=[Pose(), Pose(), Pose()])
        poses.header.stamp = (now - Duration(seconds=AGE)).to_msg()
        poses.header.frame_id = "map"
        poses.poses[1].position.x = float(self._count % 2)
        self._poses.publish(poses)
        elapsed = (now - self._started).nanoseconds * SPEED
        self._clock.publish(Clock(clock=Duration(seconds=100, nanoseconds=elapsed).to_msg()))
        self._evil.publish(String(data="\x1b[2J\u202e"))


if __name__ == "__main__":
    rclpy.init()
    try:
        TopicPeer().run()
    finally:
        rclpy.shutdown()
