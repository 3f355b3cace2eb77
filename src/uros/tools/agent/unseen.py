"""Says why a board or a node is not seen, as far as the agents of this machine tell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ..errors import ToolError

if TYPE_CHECKING:
    from ...host.network import Network

# The middlewares whose boards are not on the network.
_ISOLATED: Final = ("memory", "ced")


def why_alone(network: Network) -> str:
    """Return what to check if no other participant was found."""
    return (
        f"no other participant was found in domain {network.domain}; check --domain, ROS_DOMAIN_ID"
        " and ROS_AUTOMATIC_DISCOVERY_RANGE"
    )


def agents_reasons(domain: int) -> list[str]:
    """Return why boards of this machine's agents are not seen in a domain.

    Args:
        domain: The domain that was looked at.

    Returns:
        A reason for each agent; none at all if one of them has a board in the domain, since the
        boards of the others are then not what is missing.
    """
    from .running_agents import ask, find_agents

    reasons = []
    for agent in find_agents():
        try:
            snapshot = ask(agent, "status")
        except ToolError:
            continue
        if snapshot["middleware"] not in _ISOLATED and domain in _domains(snapshot):
            return []
        reason = _reason(snapshot, domain)
        if reason:
            reasons.append(f"the agent {agent.pid} {reason}")
    return reasons


def _reason(snapshot: Mapping[str, Any], domain: int) -> str:
    clients = snapshot["clients"]
    if snapshot["middleware"] in _ISOLATED:
        return (
            f"runs with -m {snapshot['middleware']}: its boards reach each other, and no ROS 2"
            " node; start it without -m"
        )
    if not clients:
        return "has no board: 'uros agent status' shows what it serves"
    domains = _domains(snapshot)
    if domains:
        first = min(domains)
        return f"has its boards in domain {', '.join(map(str, sorted(domains)))}: --domain {first}"
    return ""


def _domains(snapshot: Mapping[str, Any]) -> set[int]:
    return {node["domain"] for client in snapshot["clients"] for node in client["nodes"]}
