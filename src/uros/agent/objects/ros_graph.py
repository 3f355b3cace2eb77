"""``ros_to_microros_graph``: the ROS graph for boards that ask for it.

A board of micro-ROS with ``RMW_UXRCE_GRAPH`` reads this topic (it has no ``rt/``) and answers
``rcl_get_node_names``, ``rcl_count_publishers`` and the like from the last sample, a
``micro_ros_msgs/msg/Graph``. The C++ agent always publishes it on DDS. Here it is sent to the
boards that read it only, and a domain is watched as long as it has such boards.

A client does not announce how long a message it can reassemble, and the stream of a C client whose
buffer is too small for one stalls for good. So a graph is at most as long as micro-ROS's default
allows, four messages of the client's MTU, and the least important is left out: first what every
node has, then services, topics, and nodes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from ... import names
from ...middleware.base import Middleware
from ...middleware.graph import LiveSource, Source, living_nodes
from ..log import Log
from .kinds import key_label

TOPIC: Final = "ros_to_microros_graph"
TYPE: Final = "micro_ros_msgs::msg::dds_::Graph_"

# entity_type of micro_ros_msgs/msg/Entity
PUBLISHER: Final = 0
SUBSCRIBER: Final = 1
SERVICE_SERVER: Final = 2
SERVICE_CLIENT: Final = 3

# The default of micro-ROS's RMW_UXRCE_STREAM_HISTORY.
MESSAGES: Final = 4
# In each message: header with client key, and FRAGMENT's subheader; once: DATA's, and its ids.
_PER_MESSAGE: Final = 8 + 4
_ONCE: Final = 4 + 4
# Characters of a name or type: C clients read them into 256 octets, with a zero at the end, and
# refuse the whole graph if one is longer.
MAX_TEXT: Final = 255
# The most MTUs for which an encoded graph is cached, because a client may create its session again
# and again with another MTU.
_MAX_CACHED: Final = 16

# What every node of rclcpp and rclpy has: left out first.
_EVERYWHERE: Final = ("rcl_interfaces/", "type_description_interfaces/")
_EVERYWHERE_TOPICS: Final = ("/rosout", "/parameter_events")


class Entity(NamedTuple):
    """A topic or service of a node, in one role: publisher, subscriber, server or client."""

    kind: int
    name: str
    types: tuple[str, ...]

    @property
    def everywhere(self) -> bool:
        """Whether every node of rclcpp and rclpy has it."""
        if self.kind in (PUBLISHER, SUBSCRIBER):
            return self.name in _EVERYWHERE_TOPICS
        return all(name.startswith(_EVERYWHERE) for name in self.types)


class GraphNode(NamedTuple):
    """A ROS node and its entities."""

    namespace: str
    name: str
    entities: tuple[Entity, ...]


def ros_nodes(source: Source) -> list[GraphNode]:
    """Return the nodes by their ROS names, sorted, with their ROS topics and services only."""
    endpoints = source.endpoints
    nodes = []
    for node in living_nodes(source):
        if not (_fits(node.namespace) and _fits(node.name)):
            continue
        entities: dict[tuple[int, str], set[str]] = {}
        for ends, writes in ((node.writers, True), (node.readers, False)):
            for gid in ends:
                end = endpoints.get(gid)
                entity = None if end is None else _entity(writes, end.topic, end.type_name)
                if entity is not None:
                    entities.setdefault(entity[:2], set()).add(entity[2])
        nodes.append(
            GraphNode(
                node.namespace,
                node.name,
                tuple(Entity(*key, tuple(sorted(entities[key]))) for key in sorted(entities)),
            )
        )
    return sorted(nodes, key=lambda ros_node: (ros_node.namespace, ros_node.name))


@lru_cache(8192)  # nearly all are the same as a second ago
def _entity(writes: bool, topic: str, type_name: str) -> tuple[int, str, str] | None:
    """Return an endpoint's kind, name and type; None if boards are not told of it."""
    kind, name = PUBLISHER if writes else SUBSCRIBER, names.topic_from_dds(topic)
    ros_type = names.type_from_dds(type_name)
    if name is None:
        ros_type = names.service_type_from_dds(type_name)
        kind = SERVICE_CLIENT if writes else SERVICE_SERVER
        name = names.service_from_request(topic)
    if name is None:
        kind = SERVICE_SERVER if writes else SERVICE_CLIENT
        name = names.service_from_reply(topic)
    return (kind, name, ros_type) if name is not None and _fits(name) and _fits(ros_type) else None


def _fits(text: str) -> bool:
    return len(text.encode()) <= MAX_TEXT


# --- the message --------------------------------------------------------------------


def encode(nodes: Sequence[GraphNode]) -> bytes:
    """Return a ``micro_ros_msgs/msg/Graph``: little-endian CDR without encapsulation header."""
    message = _encode(nodes, lambda entity: True, None)
    assert message is not None
    return message


def _encode(
    nodes: Sequence[GraphNode], stays: Callable[[Entity], bool], room: int | None
) -> bytes | None:
    """Return the message with the entities that stay; None as soon as it exceeds ``room``."""
    out = bytearray()

    def count(value: int) -> None:
        out.extend(bytes(-len(out) % 4))
        out.extend(struct.pack("<I", value))

    def string(text: str) -> None:
        raw = text.encode() + b"\0"
        count(len(raw))
        out.extend(raw)

    count(len(nodes))
    for node in nodes:
        if room is not None and len(out) > room:
            return None
        string(node.namespace)
        string(node.name)
        entities = [entity for entity in node.entities if stays(entity)]
        count(len(entities))
        for entity in entities:
            out.append(entity.kind)
            string(entity.name)
            count(len(entity.types))
            for type_name in entity.types:
                string(type_name)
    return bytes(out) if room is None or len(out) <= room else None


def room_for(mtu: int) -> int:
    """Return the bytes of a graph that a client with this MTU can reassemble."""
    return MESSAGES * (mtu - _PER_MESSAGE & ~3) - _ONCE  # fragments end on four bytes


# What is left out to save room, from nothing on: its name in the log, and what stays.
_CUTS: Final[tuple[tuple[str, Callable[[Entity], bool]], ...]] = (
    ("", lambda entity: True),
    (
        "the services of parameters and type descriptions",
        lambda entity: entity.kind in (PUBLISHER, SUBSCRIBER) or not entity.everywhere,
    ),
    (
        "these services, /rosout and /parameter_events",
        lambda entity: not entity.everywhere,
    ),
    (
        "all services, /rosout and /parameter_events",
        lambda entity: entity.kind in (PUBLISHER, SUBSCRIBER) and not entity.everywhere,
    ),
    ("all topics and services", lambda entity: False),
)


def cut(nodes: list[GraphNode], room: int) -> tuple[bytes, str]:
    """Return a message of at most ``room`` bytes, and what was left out of it, as text."""
    for left_out, stays in _CUTS:
        message = _encode(nodes, stays, room)
        if message is not None:
            return message, left_out
    few, too_many, best = 0, len(nodes), encode([])
    while too_many - few > 1:
        some = (few + too_many) // 2
        message = _encode(nodes[:some], stays, room)
        if message is None:
            too_many = some
        else:
            few, best = some, message
    return best, f"all topics and services and {len(nodes) - few} of {len(nodes)} nodes"


# --- its readers --------------------------------------------------------------------


class GraphEndpoint:
    """A board's datareader of the topic: it gives the present graph, and each graph once."""

    unread = 0  # octets that wait: the message is encoded when it is taken

    def __init__(
        self, domain: _Domain, mtu: Callable[[], int], on_ready: Callable[[], None], key: int
    ) -> None:
        self._domain = domain
        self._mtu = mtu
        self.on_ready = on_ready
        self._key = key
        self._told: bytes | None = None
        self._left_out = ""
        self.taken = 0  # graphs, for the agent's owner

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Return the graph if it differs from the one before."""
        message, left_out = self._domain.message(room_for(self._mtu()))
        if limit < 1 or message == self._told or (self._told is None and not any(message)):
            return []  # an empty one is not sent first: nothing is discovered yet
        self._told = message
        self.taken += 1
        if left_out != self._left_out:
            self._left_out = left_out
            self._domain.cut(self._key, left_out)
        return [(1, message)]

    def anew(self) -> None:
        """Send the graph again even if it has not changed: the client may have been reset."""
        self._told = None

    def close(self) -> None:
        """Stop watching the domain if this was its last reader."""
        self._domain.leave(self)


class _Domain:
    """One domain while boards read its graph."""

    def __init__(self, number: int, log: Log, over: Callable[[int], object]) -> None:
        self.readers: list[GraphEndpoint] = []
        self.source: LiveSource | None = None
        self._number = number
        self._log = log
        self._over = over
        # By their room: endpoints ask each time that a board acknowledges something.
        self._messages: dict[int, tuple[bytes, str]] = {}

    def changed(self) -> None:
        """Notify all readers; the middleware calls this."""
        self._messages.clear()
        for reader in self.readers.copy():
            reader.on_ready()

    def message(self, room: int) -> tuple[bytes, str]:
        """Return the graph in so many bytes, and what was left out of it."""
        encoded = self._messages.get(room)
        if encoded is None:
            if len(self._messages) >= _MAX_CACHED:
                self._messages.clear()
            nodes = [] if self.source is None else ros_nodes(self.source)
            encoded = self._messages[room] = cut(nodes, room)
        return encoded

    def cut(self, key: int, left_out: str) -> None:
        self._log.warning(
            "Graph", "publish", "graph is cut" if left_out else "graph is whole",
            f"client_key: {key_label(key)}"
            + (f", left out, as it has no room for more: {left_out}" if left_out else ""),
        )  # fmt: skip

    def leave(self, reader: GraphEndpoint) -> None:
        if reader in self.readers:
            self.readers.remove(reader)
            if not self.readers:
                if self.source is not None:
                    self.source.close()
                self._over(self._number)
                self._log.info("Graph", "stop", "graph stopped", f"domain_id: {self._number}")


class Graphs:
    """The domains whose graph boards read."""

    def __init__(self, middleware: Middleware, log: Log) -> None:
        self._middleware = middleware
        self._log = log
        self._domains: dict[int, _Domain] = {}

    def reader(
        self, domain: int, mtu: Callable[[], int], on_ready: Callable[[], None], key: int
    ) -> GraphEndpoint | None:
        """Create a datareader of the graph.

        Args:
            domain: The DDS domain.
            mtu: Returns the client's MTU.
            on_ready: Called when there is a new graph.
            key: The client's key.

        Returns:
            The reader, or None if the middleware does not know the graph.

        Raises:
            MiddlewareError: The domain cannot be watched.
        """
        watched = self._domains.get(domain)
        if watched is None:
            watched = _Domain(domain, self._log, self._domains.pop)
            watched.source = self._middleware.graph(domain, watched.changed)
            about = f"domain_id: {domain}"
            if watched.source is None:
                self._log.warning(
                    "Graph", "start", "no graph",
                    f"{about}, middleware: {self._middleware.name} does not know it",
                )  # fmt: skip
                return None
            self._domains[domain] = watched
            self._log.info("Graph", "start", "graph started", about)
        reader = GraphEndpoint(watched, mtu, on_ready, key)
        watched.readers.append(reader)
        return reader
