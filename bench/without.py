"""The agent without one of its design choices, to measure the choice.

    python bench/without.py CHOICE udp4 -p 8888 ...

``batching``: every sample is a packet of its own. ``sharing``: every board has a
participant of its own. ``local``: samples between boards of one agent pass through
the waiting thread. ``turns``: a socket is read until it is empty. ``patience``: the
agent waits for a writer without room, 100 ms at most.
"""

from __future__ import annotations

import sys
from typing import Any

from uros.agent import server
from uros.agent.transports import udp
from uros.middleware.dds import cyclone, dispatcher, domain
from uros.tools import cli

_MS = 1_000_000


def batching() -> None:
    class Unbatched(server.Server):
        def __init__(self, agent: Any, transports: Any) -> None:
            super().__init__(agent, transports)
            agent.middleware.batching = False

    server.Server = Unbatched  # type: ignore[misc]


def sharing() -> None:
    domain.MAX_NODES = 1


def local() -> None:
    dispatcher.Dispatcher.watch_local = lambda self, reader: None  # type: ignore[method-assign]


def turns() -> None:
    udp.MAX_BURST = udp.MAX_BURST_BYTES = 1 << 40


def patience() -> None:
    wanted = cyclone._qset_reliability
    cyclone._qset_reliability = lambda qos, kind, _: wanted(qos, kind, 100 * _MS)


CHOICES = {choice.__name__: choice for choice in (batching, sharing, local, turns, patience)}

if __name__ == "__main__":
    if sys.argv[1] in CHOICES:
        CHOICES[sys.argv[1]]()
    sys.exit(cli.main(["agent", *sys.argv[2:]]))
