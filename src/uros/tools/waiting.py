"""Waits for a topic and finds its type; finds a node."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Final

from ..printable import printable
from .common import remedy
from .errors import ToolError

if TYPE_CHECKING:
    from ..host.network import Network

# Publishers of a topic often start together: discover all before their QoS is compared.
_TOGETHER: Final = 1.0
_NODE_SECONDS: Final = 1.0


def warn(text: str) -> None:
    """Print a warning on standard error."""
    print(f"WARNING: {printable(text)}", file=sys.stderr, flush=True)


def topic_types(network: Network, topic: str, deadline: float | None = None) -> list[str]:
    """Return the types of a topic, and wait for it if necessary.

    Args:
        network: The domain.
        topic: The topic.
        deadline: When to give up (``time.monotonic``); None for never.

    Raises:
        ToolError: The topic did not appear before the deadline.
    """
    graph = network.graph
    types = graph.topics().get(topic)
    if types:
        return types
    warn(
        f"topic [{topic}] does not appear to be published yet; waiting for it"
        f"{remedy(network, topic, graph.topics())}"
    )
    seconds = None if deadline is None else max(0.0, deadline - time.monotonic())
    if not network.spin(lambda: topic in graph.topics(), seconds):
        raise ToolError(f"topic {topic!r} did not appear{remedy(network, topic, graph.topics())}")
    network.settle(_TOGETHER)
    return graph.topics().get(topic) or topic_types(network, topic, deadline)


def find_node(network: Network, name: str, seconds: float | None) -> str:
    """Return the full name of a node of the domain, which is discovered.

    Args:
        network: The domain.
        name: The name; the first slash may be missing.
        seconds: How long to wait for a node that is not there; None for a second, as in ros2.

    Raises:
        ToolError: There is no such node.
    """
    from .. import names

    full_name = names.absolute(name)
    graph = network.graph
    wait = _NODE_SECONDS if seconds is None else seconds
    if not network.spin(lambda: full_name in graph.nodes(), wait):
        raise ToolError(
            f"there is no node {full_name!r}{remedy(network, full_name, graph.nodes())}"
        )
    return full_name
