"""A node that lists its endpoints in the discovery info."""

from __future__ import annotations

from typing import Protocol

from ..base import Node
from .node_entry import NodeEntry


class ListedEndpoint(Protocol):
    """A writer or reader of a node.

    Attributes:
        guid: Its GUID.
    """

    guid: bytes

    def close(self) -> None:
        """Leave the topic, and the node's list; idempotent."""


class ListedNode(Node):
    """A node whose endpoints are in its entry until they are closed.

    Attributes:
        entry: What is announced of it, by its participant or by another one.
    """

    def __init__(self, entry: NodeEntry) -> None:
        self.entry = entry
        self._endpoints: dict[ListedEndpoint, None] = {}

    def register(self, endpoint: ListedEndpoint) -> None:
        """List an endpoint."""
        self._endpoints[endpoint] = None
        self.entry.add(endpoint.guid)

    def unregister(self, endpoint: ListedEndpoint) -> None:
        """List an endpoint no more."""
        del self._endpoints[endpoint]
        self.entry.remove(endpoint.guid)

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        for endpoint in list(self._endpoints):
            endpoint.close()
        self.entry.close()
