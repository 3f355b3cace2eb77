"""Sends the samples of DDS topics back on others, in a process of its own.

    python bench/echo.py DOMAIN TOPIC...

The samples of ``rt/a`` go back on ``rt/a_back``. Cyclone calls it in the thread that receives, so
no other thread has to wake up, and little of a round trip is spent here. Prints ``ready``; answers
each line on standard input with the number of samples since the last one.
"""

from __future__ import annotations

import ctypes
import os
import sys

from relay import TYPE, qos

from uros.middleware.dds import cyclone

Callback = ctypes.CFUNCTYPE(None, ctypes.c_int32, ctypes.c_void_p)

_create_listener = cyclone.function("dds_create_listener", ctypes.c_void_p, ctypes.c_void_p)
_call_when_available = cyclone.function("dds_lset_data_available", None, ctypes.c_void_p, Callback)
_set_listener = cyclone.function(
    "dds_set_listener", ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p
)


def main() -> None:
    domain = int(sys.argv[1])
    cyclone.open_domain(domain, os.environ["CYCLONEDDS_URI"])
    participant = cyclone.create_participant(domain, b"")
    publisher, subscriber = (
        cyclone.create_group(kind, participant) for kind in ("publisher", "subscriber")
    )
    writers: dict[int, int] = {}  # by reader
    count = 0

    @Callback
    def send_back(reader: int, _: object) -> None:
        nonlocal count
        for sample, _ in cyclone.take(reader, 64):
            cyclone.write(writers[reader], sample)
            count += 1

    listener = _create_listener(None)
    _call_when_available(listener, send_back)
    for name in sys.argv[2:]:
        topic, back = (cyclone.create_topic(participant, n, TYPE) for n in (name, f"{name}_back"))
        reader = cyclone.create_reader(subscriber, topic, qos())
        writers[reader] = cyclone.create_writer(publisher, back, qos(), b"")
        cyclone.check(_set_listener(reader, listener), "listen")
    print("ready", flush=True)
    base = 0
    for _ in sys.stdin:
        now = count
        print(now - base, flush=True)
        base = now


if __name__ == "__main__":
    main()
