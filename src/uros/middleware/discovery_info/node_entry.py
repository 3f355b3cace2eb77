"""A node of ours in the discovery info of a participant."""

from __future__ import annotations

from collections.abc import Callable

from ..base import MiddlewareError
from ..guid import is_writer
from .codec import TOPIC, NodeEntities


class NodeEntry:
    """A node in a participant's list, with the endpoints that belong to it.

    The endpoints may be those of another participant of this process: whoever reads the graph finds
    them by GUID.

    Args:
        nodes: The participant's nodes.
        changed: Called after each change, to have the list announced.
        namespace: The node's namespace.
        name: The node's name.
    """

    def __init__(
        self, nodes: list[NodeEntities], changed: Callable[[], None], namespace: str, name: str
    ) -> None:
        self._entities = NodeEntities(namespace, name)
        self._nodes = nodes
        self._changed = changed
        nodes.append(self._entities)
        changed()

    def add(self, guid: bytes) -> None:
        """List an endpoint by its GUID."""
        self._guids_like(guid).append(guid)
        self._changed()

    def remove(self, guid: bytes) -> None:
        """List an endpoint no more."""
        self._guids_like(guid).remove(guid)
        self._changed()

    def _guids_like(self, guid: bytes) -> list[bytes]:
        return self._entities.writers if is_writer(guid) else self._entities.readers

    def close(self) -> None:
        """Remove the node from the list; idempotent."""
        if self._entities in self._nodes:
            self._nodes.remove(self._entities)
            self._changed()


def check_writable(topic: str) -> None:
    """Check that nodes may write to a topic (DDS name).

    Attack: a board that writes what only middlewares write, such as nodes that do not exist.

    Raises:
        MiddlewareError: They may not.
    """
    if topic == TOPIC:
        raise MiddlewareError(f"nodes do not write on {topic}: it belongs to the middleware")
    if topic.startswith("DCPS"):
        raise MiddlewareError(f"nodes do not write on {topic}: it is a builtin topic of DDS")
