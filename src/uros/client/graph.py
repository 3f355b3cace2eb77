"""ROS graph on a board, as the agent sends it.

::

    graph = Graph(node, lambda: print(graph.get_node_names()))
    ...
    if graph.count_subscribers("chatter"): ...

The agent of uros sends the graph to boards that subscribe to it, at most once a second; an agent of
eProsima does if its participant for the graph runs. No other part of the protocol says who listens,
so without the graph a board does not know whether its publishers are matched. The agent shortens
long graphs: it leaves out first what every node has, then services, topics and nodes.
"""

from ..wire import ids
from ..wire.cdr import Reader
from ..wire.entities import push_binary_topic
from ..wire.errors import WireError
from .entities import Subscription

try:
    from typing import Any, Callable, Final, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

TOPIC: Final = "ros_to_microros_graph"
TYPE: Final = "micro_ros_msgs::msg::dds_::Graph_"
# Kind of an entity in the graph; _NODE marks the node itself.
_NODE: Final = -1
_PUBLISHER: Final = 0
_SUBSCRIBER: Final = 1
_SERVICE: Final = 2
_CLIENT: Final = 3


class Graph(Subscription):
    """The last graph received; ``callback()`` is called for each new one.

    Method names are rclpy's. ``known`` says whether a graph was received in this session; before
    that all lists are empty and all counts 0. The graph is kept as received and decoded by each
    query: about two kilobytes with a board's usual MTU.
    """

    def __init__(self, node: "Any", callback: "Callable[[], object] | None" = None) -> None:
        if not node.connection.has_agent:
            raise TypeError("a host's node has no agent to ask; see uros.host.graph_queries")
        self.known = False
        self._buf = b"\0\0\0\0"
        self._little = True
        super().__init__(node, TOPIC, None, 1, callback or _nothing)  # type: ignore[arg-type]
        self.flags |= ids.QOS_TRANSIENT_LOCAL
        node._add(self)

    def _create(self, connection: "Any", step: int, this: int) -> None:
        if step:
            super()._create(connection, step, this)
        else:  # the topic name has no ROS prefix
            connection.create(self, this, self.node.object_id, push_binary_topic, TOPIC, TYPE)

    def on_lost(self) -> None:
        """Drop the graph: the session has ended."""
        self.known = False
        self._buf = b"\0\0\0\0"
        super().on_lost()

    def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
        """Keep a new graph if it is well-formed."""
        graph = bytes(buf[start:stop])
        try:
            for _ in _lines(graph, little):
                pass
        except (WireError, ValueError):
            self.malformed += 1
            return
        self._buf = graph
        self._little = little
        self.known = True
        self._queue = [None]

    def execute(self, new: bool) -> None:
        """Call the callback after a new graph."""
        self._queue = []
        self.callback()  # type: ignore[call-arg]

    # --- methods of rclpy's Node --------------------------------------------------------------

    def get_node_names_and_namespaces(self) -> "list[tuple[str, str]]":
        """Return (name, namespace) of each node."""
        return [
            (name, space) for space, name, kind, _, _ in _lines(self._buf, self._little)
            if kind == _NODE
        ]  # fmt: skip

    def get_node_names(self) -> "list[str]":
        """Return the name of each node."""
        return [name for name, _ in self.get_node_names_and_namespaces()]

    def get_topic_names_and_types(self) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each topic, sorted."""
        return self._sorted_names((_PUBLISHER, _SUBSCRIBER))

    def get_service_names_and_types(self) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each service, sorted."""
        return self._sorted_names((_SERVICE,))

    def get_publisher_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each topic that the node publishes, sorted."""
        return self._sorted_names((_PUBLISHER,), node_name, node_namespace)

    def get_subscriber_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each topic that the node subscribes to, sorted."""
        return self._sorted_names((_SUBSCRIBER,), node_name, node_namespace)

    def get_service_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each service that the node serves, sorted."""
        return self._sorted_names((_SERVICE,), node_name, node_namespace)

    def get_client_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of each service of which the node is a client, sorted."""
        return self._sorted_names((_CLIENT,), node_name, node_namespace)

    def count_publishers(self, topic: str) -> int:
        """Return the number of nodes that publish a topic, our own included."""
        return self._count(_PUBLISHER, self.node.resolve_topic_name(topic))

    def count_subscribers(self, topic: str) -> int:
        """Return the number of nodes that subscribe to a topic, our own included."""
        return self._count(_SUBSCRIBER, self.node.resolve_topic_name(topic))

    def count_services(self, service: str) -> int:
        """Return the number of nodes that serve a service, our own included."""
        return self._count(_SERVICE, self.node.resolve_service_name(service))

    def count_clients(self, service: str) -> int:
        """Return the number of nodes with a client of a service, our own included."""
        return self._count(_CLIENT, self.node.resolve_service_name(service))

    def _count(self, kind: int, name: str) -> int:
        count = 0
        for _, _, entity_kind, entity, _ in _lines(self._buf, self._little):
            count += entity_kind == kind and entity == name
        return count

    def _sorted_names(
        self, kinds: "tuple[int, ...]", node: "str | None" = None, space: str = ""
    ) -> "list[tuple[str, list[str]]]":
        """Return (name, types) of the entities of these kinds, sorted by name."""
        out: "dict[str, list[str]]" = {}
        for node_space, node_name, kind, name, types in _lines(self._buf, self._little):
            if kind in kinds and (node is None or (node_name == node and node_space == space)):
                known = out.setdefault(name, [])
                for type_name in types:
                    if type_name not in known:
                        known.append(type_name)
        return [(name, sorted(out[name])) for name in sorted(out)]


def _nothing() -> None:
    pass


def _lines(graph: bytes, little: bool) -> "Iterator[tuple[str, str, int, str, list[str]]]":
    """Yield (namespace, node, kind, name, types) of each node and of each entity.

    micro_ros_msgs/msg/Graph: nodes of namespace, name and entities of kind, name and types.
    """
    r = Reader(graph, 0, len(graph), little)
    for _ in range(r.u32()):
        space = r.string()
        node = r.string()
        yield space, node, _NODE, "", []
        for _ in range(r.u32()):
            kind = r.u8()
            name = r.string()
            types = []
            for _ in range(r.u32()):
                types.append(r.string())
            yield space, node, kind, name, types
