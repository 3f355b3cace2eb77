"""Counts the samples of DDS topics, in a process of its own.

    python bench/counter.py DOMAIN [TOPICS] [reliable]

Counts on one topic, or on the topics of TOPICS boards. Prints ``ready``; answers each
line on standard input with the number of samples since the last one.
"""

from __future__ import annotations

import os
import sys
import threading

from relay import TOPIC, TYPE

from uros.middleware.dds import cyclone
from uros.qos import QoSProfile, ReliabilityPolicy


def main() -> None:
    domain = int(sys.argv[1])
    cyclone.open_domain(domain, os.environ["CYCLONEDDS_URI"])
    participant = cyclone.create_participant(domain, b"")
    boards = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    qos = QoSProfile(depth=100_000, reliability=ReliabilityPolicy.BEST_EFFORT)
    if "reliable" in sys.argv:
        qos = QoSProfile(depth=10)
    group = cyclone.create_group("subscriber", participant)
    waitset = cyclone.Waitset()
    readers = []
    for key, name in enumerate([f"rt/board_{i}" for i in range(boards)] or [TOPIC], 1):
        topic = cyclone.create_topic(participant, name, TYPE)
        readers.append(cyclone.create_reader(group, topic, qos))
        waitset.attach(readers[-1], key)
    count = 0

    def wait() -> None:
        nonlocal count
        while True:
            for key in waitset.wait():
                taken = -1
                while taken:
                    taken = len(cyclone.take(readers[key - 1], 256))
                    count += taken

    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)
    base = 0
    for _ in sys.stdin:
        now = count
        print(now - base, flush=True)
        base = now


if __name__ == "__main__":
    main()
