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
    """The limits of one client, except ``memory``, which is the limit of all clients together."""

    # Objects. A client could create one for each of the 65536 ids.
    objects: int = 4096
    # Participants, each of which is a node. The network can have some thousand nodes.
    participants: int = 32
    # Domains, so that one client cannot open all that the middleware can have. They stay open until
    # the agent ends.
    domains: int = 4
    # Types that a client uses in its whole life, because the middleware never forgets their names.
    types: int = 512
    # Bytes of all representations, which are stored for GET_INFO. Many objects may each have the
    # longest XML.
    representations: int = 4 * 1024 * 1024
    # Bytes of a message, in either direction, because fragments may never end and a client may
    # never read long samples.
    message: int = MAX_MESSAGE
    # Bytes that all clients together may hold, because many clients may each reach their limits;
    # see memory_budget.py.
    memory: int = 256 * 1024 * 1024


def use(used: set[_One], value: _One, most: int, noun: str) -> None:
    """Add a value to those that a client uses; raises TooMany if ``most`` are used already."""
    if value not in used:
        if len(used) >= most:
            raise TooMany(f"over {most} {noun} of one client")
        used.add(value)
