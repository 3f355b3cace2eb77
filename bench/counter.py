"""Counts what arrives on a DDS topic, in a process of its own.

    python bench/counter.py DOMAIN

Prints ``ready`` when its reader has found a writer; a line on standard input
is answered with the number of samples since the last.
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
    topic = cyclone.create_topic(participant, TOPIC, TYPE)
    qos = QoSProfile(depth=100_000, reliability=ReliabilityPolicy.BEST_EFFORT)
    reader = cyclone.create_reader(cyclone.create_group("subscriber", participant), topic, qos)
    waitset = cyclone.Waitset()
    waitset.attach(reader, 1)
    count = 0

    def wait() -> None:
        nonlocal count
        while True:
            if waitset.wait():
                got = -1
                while got:
                    got = len(cyclone.take(reader, 256))
                    count += got

    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)
    base = 0
    for _ in sys.stdin:
        now = count
        print(now - base, flush=True)
        base = now


if __name__ == "__main__":
    main()
