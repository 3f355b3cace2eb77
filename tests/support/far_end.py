"""One datareader and one datawriter on DDS, in a process of their own.

    python far_end.py DOMAIN READ_TOPIC WRITE_TOPIC TYPE

Prints ``ready``, then each sample that it takes, as hex. Writes each line of its input, given as
hex, as a sample when the datawriter has a matched reader.
"""

import os
import select
import sys

from uros.middleware import open_middleware
from uros.qos import QoSProfile


def main():
    domain, read_topic, write_topic, type_name = int(sys.argv[1]), *sys.argv[2:5]
    middleware = open_middleware("dds")
    node = middleware.create_node(domain, "/", "far_end")

    def take():
        while samples := reader.take(1000):
            for sample in samples:
                print(bytes(sample).hex())
        sys.stdout.flush()

    reader = node.create_reader(read_topic, type_name, QoSProfile(depth=100_000), take)
    writer = node.create_writer(write_topic, type_name, QoSProfile(depth=1000))
    print("ready", flush=True)
    waiting = []
    rest = b""
    while True:
        files, _, _ = select.select([0, middleware.fileno()], [], [], 0.02)
        if middleware.fileno() in files:
            middleware.dispatch()
        if 0 in files:
            read = os.read(0, 65536)
            if not read:
                return
            *lines, rest = (rest + read).split(b"\n")
            waiting += lines
        while waiting and writer.matched() and writer.write(bytes.fromhex(waiting[0].decode())):
            del waiting[0]
        middleware.flush()
        middleware.tick()


if __name__ == "__main__":
    main()
