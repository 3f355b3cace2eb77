"""Nodes with a life cycle, and their services."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from ...names import service_type_from_dds
from ...printable import printable
from ..common import ANSWER_SECONDS, discover
from ..errors import ToolError, did_you_mean
from ..node.list import visible_nodes
from ..service.client import Call, ServiceClient, call_all
from ..waiting import find_node

if TYPE_CHECKING:
    from ...host.network import Network

_GET_STATE: Final = "lifecycle_msgs/srv/GetState"


def lifecycle_nodes(network: Network, include_hidden: bool) -> list[str]:
    """Return the discovered nodes that have a life cycle, sorted."""
    return [
        name for name in visible_nodes(network, include_hidden) if _has_life_cycle(network, name)
    ]


def _has_life_cycle(network: Network, node: str) -> bool:
    servers = network.graph.servers(f"{node}/get_state")
    return any(service_type_from_dds(server.type_name) == _GET_STATE for server in servers)


def find_lifecycle_node(network: Network, args: argparse.Namespace) -> str:
    """Discover the domain and return the full name of the command's node.

    Raises:
        ToolError: There is no such node, or it has no life cycle.
    """
    discover(network, args)
    name = find_node(network, args.node, args.timeout)
    if not _has_life_cycle(network, name):
        others = lifecycle_nodes(network, True)
        close = did_you_mean(name, others)
        listed = f"; nodes that have one: {', '.join(others) or 'none'}"
        raise ToolError(f"the node {name} has no life cycle{close or listed}")
    return name


def states(network: Network, nodes: Sequence[str], seconds: float | None) -> dict[str, Any]:
    """Return the ``lifecycle_msgs/msg/State`` of each node, or a ToolError in place of it."""
    from ...interfaces import load

    kind = load(_GET_STATE)
    calls = [Call(f"{node}/get_state", kind, kind.Request()) for node in nodes]
    answers = call_all(network, calls, seconds or ANSWER_SECONDS)
    return {
        node: answer if isinstance(answer, ToolError) else answer.current_state
        for node, answer in zip(nodes, answers, strict=True)
    }


def call(network: Network, node: str, service: str, seconds: float | None, **request: Any) -> Any:
    """Call a lifecycle service of a node; return the response.

    Raises:
        ToolError: The node does not answer in time.
    """
    from ...interfaces import load

    seconds = seconds or ANSWER_SECONDS
    name = "GetAvailableTransitions" if "transition" in service else "ChangeState"
    kind = load(f"lifecycle_msgs/srv/{name}")
    client = ServiceClient(network, f"{node}/{service}", kind)
    try:
        client.match(seconds)
        return client.answer(client.request(kind.Request(**request)), seconds)
    finally:
        client.close()


def described(state: Any) -> str:
    """Return label and number of a state or a transition, as ``active [3]``."""
    return f"{printable(state.label)} [{state.id}]"
