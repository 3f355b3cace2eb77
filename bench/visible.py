"""A node of real rclpy that waits until its graph has all boards.

    .venv-ros/bin/python bench/visible.py DOMAIN BOARDS

Prints ``ready``, and ``seen`` when every board's node and publisher is in its graph.
"""

import os
import sys
import time

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = sys.argv[1]

import rclpy  # noqa: E402  it reads the environment when it is imported


def main() -> None:
    boards = int(sys.argv[2])
    rclpy.init()
    node = rclpy.create_node("visible")
    print("ready", flush=True)
    while True:
        names = [name for name in node.get_node_names() if name.startswith("board_")]
        # The topics alone may be there because of another process's subscriptions.
        if len(set(names)) >= boards and all(
            node.count_publishers(f"/board_{number}") for number in range(boards)
        ):
            break
        time.sleep(0.05)
    print("seen", len(names), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
