"""A real rclpy node that speaks from its first moment, before anybody can hear it.

Runs in an environment of its own that knows nothing of uros. Arguments: the first number, then
topics. On each it publishes numbers at 20 Hz; on /kept it has published three texts, latched. A
line ``topic number`` says which number was the first that went out when the topic had a
subscriber, one for /kept that it has one. It ends when its input does.
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
    # A deeper history than what goes out in three seconds: when it is full, heartbeats come.
    publishers = {topic: node.create_publisher(Int32, topic, 100) for topic in sys.argv[2:]}
    latch = QoSProfile(depth=len(KEPT), durability=DurabilityPolicy.TRANSIENT_LOCAL)
    kept = node.create_publisher(String, "/kept", latch)
    for text in KEPT:
        kept.publish(String(data=text))
    unheard = {**publishers, "/kept": kept}
    number = int(sys.argv[1])

    def publish():
        nonlocal number
        for topic, publisher in list(unheard.items()):
            if publisher.get_subscription_count():
                print(topic, number, flush=True)
                del unheard[topic]
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
