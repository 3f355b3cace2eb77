"""What one client, and all clients together, may have of an agent.

Limits that never vary stand where they are held: streams and answers of a session
(:mod:`~uros.agent.session.session`), sizes of XML (:mod:`~uros.agent.objects.xml_profiles`),
connections and what
waits in them (:mod:`~uros.agent.transports.tcp`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from ...wire.streams import MAX_MESSAGE

_One = TypeVar("_One", str, int)


class TooMany(Exception):
    """More than one client may have."""


@dataclass(frozen=True)
class Limits:
    """Of one client, but for those that say otherwise."""

    # Attack: a client that creates all 65536 objects its ids can name.
    objects: int = 4096
    # Attack: one client takes the places of all on the network, which holds some thousand
    # nodes at most.
    participants: int = 32
    # Attack: one client starts all domains that the middleware has room for, and none is left
    # again before the agent's end.
    domains: int = 4
    # Attack: one type after the other; the middleware keeps their names for good. Counted over
    # the client's life.
    types: int = 512
    # Attack: as many objects, each with as much XML as it may have, all kept for GET_INFO.
    representations: int = 4 * 1024 * 1024
    # Attack: fragments that never end, and samples of the network that a client never reads.
    message: int = MAX_MESSAGE
    # Attack: each of many clients takes what one may have. Bytes of all together; see budget.py.
    memory: int = 256 * 1024 * 1024


def use(used: set[_One], one: _One, most: int, what: str) -> None:
    """Note one more thing that a client uses; raises TooMany."""
    if one not in used:
        if len(used) >= most:
            raise TooMany(f"over {most} {what} of one client")
        used.add(one)
