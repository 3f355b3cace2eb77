"""Publishes numbered messages at a rate, for bags.py, and says how many it has published.

    python bench/bag_talker.py DOMAIN RATE SECONDS reliable|best_effort

It waits for a subscription, prints ``matched``, and ``published N`` after the last message. A line
on standard input ends it. A message has 100 octets: its number and the time of its writing, in ns.
"""

from __future__ import annotations

import sys
import time

from uros.host.network import Network
from uros.qos import QoSProfile, ReliabilityPolicy

TOPIC = "rt/bench"
TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"
PADDING = bytes(80)
MATCH_SECONDS = 60.0


def main() -> None:
    domain, rate, seconds = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
    reliability = ReliabilityPolicy.RELIABLE
    if sys.argv[4] == "best_effort":
        reliability = ReliabilityPolicy.BEST_EFFORT
    with Network(domain) as network:
        writer = network.node.create_writer(TOPIC, TYPE, QoSProfile(1000, reliability))
        if not network.spin(lambda: writer.matched() > 0, MATCH_SECONDS):
            raise SystemExit("there is no subscription")
        network.spin(lambda: False, 1.0)
        print("matched", flush=True)
        begin = time.monotonic()
        for number in range(round(rate * seconds)):
            left = begin + number / rate - time.monotonic()
            if left > 0:
                network.spin(lambda: False, left)
            sample = number.to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + PADDING
            while not writer.write(b"\0\1\0\0" + sample):
                network.spin(lambda: False, 0.001)
        print(f"published {number + 1}", flush=True)
        network.spin(lambda: False, 2.0)


if __name__ == "__main__":
    main()
