"""The reference: a relay without any protocol.

One thread: datagram → DDS write, DDS sample → datagram to the last sender. It has
the DDS calls, the waiting thread and the socket buffers of the agent, so that the
difference is the cost of XRCE.

    python bench/relay.py PORT DOMAIN
"""

from __future__ import annotations

import os
import selectors
import socket
import sys
import threading

from uros.middleware.dds import cyclone
from uros.middleware.wakeup_fd import WakeupFd
from uros.qos import QoSProfile, ReliabilityPolicy

TOPIC, TYPE = "rt/bench", "std_msgs::msg::dds_::String_"


def qos() -> QoSProfile:
    return QoSProfile(depth=64, reliability=ReliabilityPolicy.BEST_EFFORT)


def main() -> None:
    port, domain = int(sys.argv[1]), int(sys.argv[2])
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        sock.setsockopt(socket.SOL_SOCKET, option, 4 * 1024 * 1024)
    sock.bind(("127.0.0.1", port))

    cyclone.open_domain(domain, os.environ["CYCLONEDDS_URI"])
    participant = cyclone.create_participant(domain, b"")
    topic = cyclone.create_topic(participant, TOPIC, TYPE)
    writer = cyclone.create_writer(
        cyclone.create_group("publisher", participant), topic, qos(), b""
    )
    echo = len(sys.argv) > 3
    wake, resume = WakeupFd(), threading.Lock()
    resume.acquire()
    reader = 0
    if echo:
        group = cyclone.create_group("subscriber", participant)
        reader = cyclone.create_reader(group, topic, qos())
        waitset = cyclone.Waitset()
        waitset.attach(reader, 1)

        def wait() -> None:
            while True:
                if waitset.wait():
                    wake.set()
                    resume.acquire()

        threading.Thread(target=wait, daemon=True).start()

    selector = selectors.DefaultSelector()
    selector.register(sock, selectors.EVENT_READ, 0)
    selector.register(wake.fileno(), selectors.EVENT_READ, 1)
    buf = bytearray(65536)
    buf[:4] = b"\0\1\0\0"
    body = memoryview(buf)[4:]
    view = memoryview(buf)
    peer = None
    print("ready", flush=True)
    while True:
        for key, _ in selector.select():
            if key.data == 0:
                for _ in range(64):
                    try:
                        size, peer = sock.recvfrom_into(body)
                    except BlockingIOError:
                        break
                    cyclone.write(writer, view[: size + 4])
                if echo:  # samples of this process are there already
                    for sample, _ in cyclone.take(reader, 64):
                        sock.sendto(sample[4:], peer)
            else:
                wake.clear()
                for sample, _ in cyclone.take(reader, 16):
                    sock.sendto(sample[4:], peer)
                resume.release()


if __name__ == "__main__":
    main()
