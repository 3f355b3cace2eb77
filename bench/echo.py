"""Sends the samples of a DDS topic back on another one, in a process of its own.

    python bench/echo.py DOMAIN

The other end of each middleware's round trips. Cyclone calls it in the thread that receives, so no
other thread has to wake up, and little of a round trip is spent here. Prints ``ready``; answers
each line on standard input with the number of samples since the last one.
"""

from __future__ import annotations

import ctypes
import os
import sys

from relay import TOPIC, TYPE, qos

from uros.middleware.dds import cyclone

BACK = f"{TOPIC}_back"
DATA_AVAILABLE = ctypes.CFUNCTYPE(None, ctypes.c_int32, ctypes.c_void_p)


def main() -> None:
    domain = int(sys.argv[1])
    cyclone.open_domain(domain, os.environ["CYCLONEDDS_URI"])
    participant = cyclone.create_participant(domain, b"")
    topic, back = (cyclone.create_topic(participant, name, TYPE) for name in (TOPIC, BACK))
    writer = cyclone.create_writer(cyclone.create_group("publisher", participant), back, qos(), b"")
    reader = cyclone.create_reader(cyclone.create_group("subscriber", participant), topic, qos())
    count = 0

    @DATA_AVAILABLE
    def send_back(_reader: int, _argument: object) -> None:
        nonlocal count
        for sample, _ in cyclone.take(reader, 64):
            cyclone.write(writer, sample)
            count += 1

    create_listener = cyclone.function("dds_create_listener", ctypes.c_void_p, ctypes.c_void_p)
    call_when_available = cyclone.function(
        "dds_lset_data_available", None, ctypes.c_void_p, DATA_AVAILABLE
    )
    set_listener = cyclone.function(
        "dds_set_listener", ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p
    )
    listener = create_listener(None)
    call_when_available(listener, send_back)
    cyclone.check(set_listener(reader, listener), "listen")
    print("ready", flush=True)
    base = 0
    for _ in sys.stdin:
        now = count
        print(now - base, flush=True)
        base = now


if __name__ == "__main__":
    main()
