"""Replaces rules and admission while boards are connected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Protocol

from ..log import Log
from .admission import Admission
from .rules import Rules


class Transport(Protocol):
    """What is used of a transport."""

    admits: Any

    def host_of(self, peer: Any) -> str | None:
        """Return the peer's numeric IP address; None if the transport does not use IP."""

    def address(self, peer: Any) -> str:
        """Return the peer as text."""


class Agent(Protocol):
    """What is used of the agent."""

    log: Log
    rules: Rules
    admission: Admission

    @property
    def clients(self) -> Mapping[int, Any]:
        """The clients by key."""

    def place(self, key: int) -> tuple[Any, Any]:
        """Return a client's transport, and its address there."""

    def delete_client(self, key: int) -> bool:
        """Delete a client and its objects; return whether it existed."""


class Replacement(NamedTuple):
    """What a replacement did.

    Attributes:
        removed: Keys of the clients that are no longer admitted, which were deleted.
        waiting: Keys of the clients whose new rules apply from their next session on.
    """

    removed: list[int]
    waiting: list[int]


def replace_rules(
    agent: Agent, transports: Iterable[Transport], rules: Rules, admission: Admission
) -> Replacement:
    """Replace the rules and the admission of a running agent.

    A client keeps the names, domain, QoS and limits with which its objects were created: changing
    them would delete the objects. New rules apply when it creates a node again. A client that is no
    longer admitted is deleted; a lower ``max_clients`` deletes none.

    Args:
        agent: The agent; its server's thread calls.
        transports: Its transports.
        rules: The new rules.
        admission: The new admission.
    """
    before, agent.rules, agent.admission = agent.rules, rules, admission
    for transport in transports:
        transport.admits = admission.admits_host if admission.networks else None
    removed, waiting = [], []
    for key in list(agent.clients):
        place, peer = agent.place(key)
        address = place.address(peer)
        if not admission.admits(key, place.host_of(peer)):
            removed.append(key)
            agent.delete_client(key)
        elif before.matching(key, address) != rules.matching(key, address):
            waiting.append(key)
    return Replacement(removed, waiting)
