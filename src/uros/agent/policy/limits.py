"""Limits of one client, and of all clients together, that the agent's owner can change.

Fixed limits are defined where they are checked: streams and answers of a session
(:mod:`~uros.agent.session.session`), sizes of XML (:mod:`~uros.agent.objects.xml_profiles`),
connections and their queues (:mod:`~uros.agent.transports.tcp`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from ...wire.streams import MAX_MESSAGE

_One = TypeVar("_One", str, int)


class TooMany(Exception):
    """A client has reached a limit."""


@dataclass(frozen=True)
class Limits:
    """Limits of one client, except ``memory``, which is that of all together."""

    # Attack: a client that creates all 65536 objects that have ids.
    objects: int = 4096
    # Attack: one client uses up the nodes of the network, which can have some thousand.
    participants: int = 32
    # Attack: one client opens all domains that the middleware can have; they stay open until the
    # agent ends.
    domains: int = 4
    # Attack: one type after the other; the middleware never forgets their names. Counted over the
    # client's life.
    types: int = 512
    # Attack: many objects, each with the longest XML; all are stored for GET_INFO. Bytes.
    representations: int = 4 * 1024 * 1024
    # Attack: fragments that never end, and samples of the network that a client never reads. Bytes.
    message: int = MAX_MESSAGE
    # Attack: many clients, each at its limits. Bytes of all together; see memory_budget.py.
    memory: int = 256 * 1024 * 1024


def use(used: set[_One], value: _One, most: int, noun: str) -> None:
    """Add a value to those that a client uses; raises TooMany where ``most`` are used already."""
    if value not in used:
        if len(used) >= most:
            raise TooMany(f"over {most} {noun} of one client")
        used.add(value)
