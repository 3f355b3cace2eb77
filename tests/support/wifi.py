"""A slow link between two hosts of :mod:`support.networks` that loses and delays packets.

    python -m support.wifi FD FD SEED LOSS DELAY RATE

The hosts have a TUN device each, and this program carries the packets: one at a time, as on the
air, at RATE octets a second in all. It loses a share of them and delays each for DELAY seconds.
What has to wait stays in the queue of its device, as with a real one.
"""

import fcntl
import heapq
import itertools
import os
import random
import select
import struct
import subprocess
import sys
import time

_TUNSETIFF = 0x400454CA
_IFF_TUN_NO_PI = 0x1001
# Packets that a device queues, as fq_codel of a Wi-Fi allows many.
_QUEUE = 5000


def join(one, other, name, addresses, seed, loss, delay, rate):
    """Join two hosts by a device ``name`` with one of the addresses each; the carrier's process."""
    descriptors = []
    for host, address in zip((one, other), addresses, strict=True):
        with host:
            fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN_NO_PI))
            host.ip(f"link set {name} txqueuelen {_QUEUE}")
            # A queue that counts towards the buffer of the socket, as that of a real device does;
            # where the kernel has none, packets wait in the TUN device, which counts for nobody.
            subprocess.run(
                ["tc", "qdisc", "replace", "dev", name, "root", "tbf", "rate", f"{int(rate)}bps",
                 "burst", "5k", "limit", "8mb"], stderr=subprocess.DEVNULL,
            )  # fmt: skip
            host.ip(f"addr add {address} dev {name}")
            host.ip(f"link set {name} up")
        descriptors.append(fd)
    command = [sys.executable, "-m", __name__, *map(str, (*descriptors, seed, loss, delay, rate))]
    try:
        return subprocess.Popen(command, pass_fds=descriptors)
    finally:
        for fd in descriptors:
            os.close(fd)


def carry(left, right, seed, loss, delay, rate):
    """Carry packets until this process is ended."""
    chance = random.Random(seed)
    other = {left: right, right: left}
    order = itertools.count()
    under_way = []  # (when, serial, descriptor, packet)
    free_at = 0.0  # when the air is
    turn = [left, right]
    while True:
        now = time.monotonic()
        while under_way and under_way[0][0] <= now:
            _, _, fd, packet = heapq.heappop(under_way)
            try:
                os.write(fd, packet)
            except OSError:
                pass  # the device is down
        waits_for = turn if now >= free_at else []
        at = min([free_at] * (now < free_at) + [item[0] for item in under_way[:1]], default=None)
        timeout = None if at is None else max(0.0, at - now)
        ready = select.select(waits_for, [], [], timeout)[0]
        for fd in turn:
            if fd not in ready:
                continue
            try:
                packet = os.read(fd, 65536)
            except OSError:
                continue
            turn = [other[fd], fd]
            free_at = max(time.monotonic() - 0.01, free_at) + len(packet) / rate
            if chance.random() >= loss:
                heapq.heappush(under_way, (free_at + delay, next(order), other[fd], packet))
            break


if __name__ == "__main__":
    carry(*map(int, sys.argv[1:4]), *map(float, sys.argv[4:7]))
