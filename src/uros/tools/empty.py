"""Says why a list of the network is empty, as far as the agents of this machine tell."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ..printable import printable
from .common import why_alone
from .errors import ToolError, did_you_mean
from .waiting import warn

if TYPE_CHECKING:
    from ..host.network import Network

# The most agents that are named.
_MOST: Final = 3
# The middlewares whose boards are not on the network.
_ISOLATED: Final = ("memory", "ced")


def explain_empty_list(network: Network) -> None:
    """Print on standard error why nothing was found; no line if no reason is known."""
    if network.alone:
        _say(f"{why_alone(network)}, or run 'uros doctor'")
    reasons = agents_reasons(network.domain)
    for reason in reasons[:_MOST]:
        _say(reason)
    if len(reasons) > _MOST:
        _say(f"and {len(reasons) - _MOST} more agents: 'uros agent status' lists them")


def explain_unknown_type(wanted: str, listed: Iterable[Iterable[str]]) -> None:
    """Warn if a type has no known definition, and suggest similar ones.

    Args:
        wanted: The type, which nothing on the network has.
        listed: The types of each entity on the network.
    """
    from ..interfaces import registry

    if not registry.exists(wanted):
        present = {name for types in listed for name in types}
        close = did_you_mean(wanted, [*present, *registry.list_types()])
        warn(f"no definition of the type {wanted} is known{close}")


def _say(text: str) -> None:
    print(printable(f"uros: {text}"), file=sys.stderr)


def agents_reasons(domain: int) -> list[str]:
    """Return why boards of this machine's agents are not seen in a domain.

    Args:
        domain: The domain that was looked at.

    Returns:
        A reason for each agent; none at all if one of them has a board in the domain, since the
        boards of the others are then not what is missing.
    """
    from .agent.running_agents import ask, find_agents

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
