"""Says why a list of the network is empty, as far as the agents of this machine tell."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from ..printable import printable
from .agent.unseen import agents_reasons, why_alone
from .errors import did_you_mean
from .waiting import warn

if TYPE_CHECKING:
    from ..host.network import Network

# The most agents that are named.
_MOST: Final = 3


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
