"""A real rclpy node that publishes from its first moment, before it has discovered a subscriber.

Runs in an environment of its own without uros. Arguments: the first number, then topics. The node
publishes numbers on each topic at 20 Hz; on /kept it publishes three texts once, with transient
local durability. For each topic, /kept too, it prints ``topic number`` once: the first number that
was published after the topic had a subscriber. The process ends at the end of its input.
"""

import sys
import threading

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int32, String

RATE = 20.0
KEPT = ("one", "two", "three")


def main():
    rclpy.init()
    node = rclpy.create_node("early", namespace="/real")
    # A history deeper than three seconds of samples: Fast DDS sends heartbeats when it is full.
    publishers = {topic: node.create_publisher(Int32, topic, 100) for topic in sys.argv[2:]}
    latched_qos = QoSProfile(depth=len(KEPT), durability=DurabilityPolicy.TRANSIENT_LOCAL)
    latched = node.create_publisher(String, "/kept", latched_qos)
    for text in KEPT:
        latched.publish(String(data=text))
    unmatched = {**publishers, "/kept": latched}
    number = int(sys.argv[1])

    def publish():
        nonlocal number
        for topic, publisher in list(unmatched.items()):
            if publisher.get_subscription_count():
                print(topic, number, flush=True)
                del unmatched[topic]
        for publisher in publishers.values():
            publisher.publish(Int32(data=number))
        number += 1

    publish()
    node.create_timer(1 / RATE, publish)
    threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True).start()
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass


if __name__ == "__main__":
    main()
