"""Finding the type of a topic that may not be there yet."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Final

from ..printable import printable
from .common import remedy
from .errors import ToolError

if TYPE_CHECKING:
    from ..host.network import Network

# Publishers of one topic start together: see them all before their QoS is judged.
_TOGETHER: Final = 1.0


def warn(text: str) -> None:
    print(f"WARNING: {printable(text)}", file=sys.stderr, flush=True)


def topic_types(network: Network, topic: str, deadline: float | None = None) -> list[str]:
    """The types of a topic, waited for until ``deadline`` (``time.monotonic``).

    Raises ToolError when it is over.
    """
    graph = network.graph
    types = graph.topics().get(topic)
    if types:
        return types
    warn(
        f"topic [{topic}] does not appear to be published yet"
        f"{remedy(network, topic, graph.topics())}; waiting for it"
    )
    seconds = None if deadline is None else max(0.0, deadline - time.monotonic())
    if not network.spin(lambda: topic in graph.topics(), seconds):
        raise ToolError(f"topic {topic!r} did not appear{remedy(network, topic, graph.topics())}")
    network.settle(_TOGETHER)
    return graph.topics().get(topic) or topic_types(network, topic, deadline)
