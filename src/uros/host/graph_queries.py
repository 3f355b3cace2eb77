"""The ROS graph as discovered by a middleware, under ROS names.

The rules are those of rmw_dds_common's graph cache, so the results agree with ``ros2``. All names
and types are `printable`: any participant in the domain can announce any text.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from .. import names
from ..middleware.graph import EndpointSource, NodeSource, Source, living_nodes
from ..middleware.guid import CYCLONE_DDS, UROS
from ..printable import printable
from ..qos import HistoryPolicy, QoSProfile

UNKNOWN_NODE: Final = ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_")
BARE_DDS: Final = ("_CREATED_BY_BARE_DDS_APP_", "_CREATED_BY_BARE_DDS_APP_")
NO_HASH: Final = "INVALID"

NamesAndTypes = dict[str, list[str]]

# Octets of a GID that are its participant's.
_PREFIX: Final = 12
_FEEDBACK: Final = "/_action/feedback"
_FEEDBACK_TYPE: Final = "_FeedbackMessage"
_TYPE_HASH: Final = re.compile(rb"typehash=(RIHS\d\d_[0-9a-f]{64});")
# The DDS implementations that announce the history of endpoints.
_ANNOUNCE_HISTORY: Final = (CYCLONE_DDS, UROS)


@dataclass(frozen=True)
class EndpointInfo:
    """A publisher or a subscription; a history of SYSTEM_DEFAULT is unknown."""

    node_namespace: str
    node_name: str
    type_name: str
    type_hash: str
    is_publisher: bool
    gid: bytes
    qos: QoSProfile


@dataclass(frozen=True)
class NodeInfo:
    """The endpoints of one node: names with their types, sorted."""

    name: str
    subscribers: NamesAndTypes
    publishers: NamesAndTypes
    service_servers: NamesAndTypes
    service_clients: NamesAndTypes
    action_servers: NamesAndTypes
    action_clients: NamesAndTypes


class Graph:
    """Queries of the graph as discovered so far; nothing is cached."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def topics(self) -> NamesAndTypes:
        """Return all ROS topics that have a publisher or a subscription, with their types."""
        return _collect(
            (names.topic_from_dds(endpoint.topic), names.type_from_dds(endpoint.type_name))
            for endpoint in self._source.endpoints.values()
        )

    def publishers(self, topic: str) -> list[EndpointInfo]:
        """Return the publishers of a topic."""
        return self._endpoints(topic, True)

    def subscriptions(self, topic: str) -> list[EndpointInfo]:
        """Return the subscriptions of a topic."""
        return self._endpoints(topic, False)

    def services(self) -> NamesAndTypes:
        """Return all services that have a server or a client, with their types."""
        return _collect(
            (
                names.service_from_request(endpoint.topic)
                or names.service_from_reply(endpoint.topic),
                names.service_type_from_dds(endpoint.type_name),
            )
            for endpoint in self._source.endpoints.values()
        )

    def servers(self, service: str) -> list[EndpointInfo]:
        """Return the request readers of a service in participants that write its replies, too."""
        endpoints = self._source.endpoints
        answering = {
            endpoint.participant
            for endpoint in endpoints.values()
            if endpoint.is_writer and names.service_from_reply(printable(endpoint.topic)) == service
        }
        return [
            reader
            for reader in self._dds_endpoints(f"rq{service}Request", False)
            if endpoints[reader.gid].participant in answering
        ]

    def service_endpoints(
        self, service: str, of_clients: bool
    ) -> list[tuple[EndpointInfo, EndpointInfo]]:
        """Return the endpoints of requests and of replies of each client, or of each server."""
        replies: dict[tuple[bytes, str, str], list[EndpointInfo]] = {}
        for reply in self._dds_endpoints(f"rr{service}Reply", not of_clients):
            replies.setdefault(_owner(reply), []).append(reply)
        return [
            (request, replies[_owner(request)].pop(0))
            for request in self._dds_endpoints(f"rq{service}Request", of_clients)
            if replies.get(_owner(request))
        ]

    def actions(self) -> NamesAndTypes:
        """Return all actions that have a server or a client, with their types."""
        return _collect(
            (_action(endpoint.topic), _action_type(endpoint.type_name))
            for endpoint in self._source.endpoints.values()
        )

    def action_nodes(self, action: str, of_clients: bool) -> list[tuple[str, list[str]]]:
        """Return the full names of the nodes with a client, or a server, and its types, sorted."""
        endpoints = self._source.endpoints
        found = []
        for node in living_nodes(self._source):
            gids = node.readers if of_clients else node.writers
            own = [endpoints[gid] for gid in gids if gid in endpoints]
            types = _named(own, _action, _action_type).get(action)
            if types:
                found.append((_full_name(node), types))
        return sorted(found)

    def _endpoints(self, topic: str, is_writer: bool) -> list[EndpointInfo]:
        return self._dds_endpoints(names.topic_to_dds(topic), is_writer)

    def _dds_endpoints(self, dds_name: str, is_writer: bool) -> list[EndpointInfo]:
        owners = {
            gid: (node.namespace, node.name)
            for node in living_nodes(self._source)
            for gid in (node.writers if is_writer else node.readers)
        }
        announced = self._source.announced
        endpoints = []
        for endpoint in self._source.endpoints.values():
            if endpoint.is_writer != is_writer or printable(endpoint.topic) != dds_name:
                continue
            ros = endpoint.participant in announced
            namespace, name = owners.get(endpoint.guid, UNKNOWN_NODE if ros else BARE_DDS)
            endpoints.append(
                EndpointInfo(
                    printable(namespace),
                    printable(name),
                    printable(names.type_from_dds(endpoint.type_name)),
                    type_hash(endpoint.qos.user_data),
                    is_writer,
                    endpoint.guid,
                    _announced_qos(endpoint),
                )
            )
        return sorted(endpoints, key=lambda info: (info.node_namespace, info.node_name, info.gid))

    def nodes(self) -> list[str]:
        """Return the full names of all nodes, sorted; a name may occur more than once."""
        return sorted(map(_full_name, living_nodes(self._source)))

    def node(self, full_name: str) -> NodeInfo | None:
        """Return the endpoints of the node, or of one of them if several have the name."""
        for node in living_nodes(self._source):
            if _full_name(node) == full_name:
                break
        else:
            return None
        endpoints = self._source.endpoints
        writers = [endpoints[gid] for gid in node.writers if gid in endpoints]
        readers = [endpoints[gid] for gid in node.readers if gid in endpoints]
        return NodeInfo(
            full_name,
            _named(readers, names.topic_from_dds, names.type_from_dds),
            _named(writers, names.topic_from_dds, names.type_from_dds),
            _named(readers, names.service_from_request, names.service_type_from_dds),
            _named(readers, names.service_from_reply, names.service_type_from_dds),
            # A server publishes feedback, a client reads it: actions are recognized by this alone.
            _named(writers, _action, _action_type),
            _named(readers, _action, _action_type),
        )


def _owner(endpoint: EndpointInfo) -> tuple[bytes, str, str]:
    """Return the participant and the node of an endpoint."""
    return endpoint.gid[:_PREFIX], endpoint.node_namespace, endpoint.node_name


def _full_name(node: NodeSource) -> str:
    return printable(names.join(node.namespace, node.name))


def type_hash(user_data: bytes) -> str:
    """Return the type hash in an endpoint's USER_DATA, or what ros2 prints without one."""
    match = _TYPE_HASH.search(user_data)
    return match[1].decode() if match else NO_HASH


def _announced_qos(endpoint: EndpointSource) -> QoSProfile:
    if endpoint.guid.startswith(_ANNOUNCE_HISTORY):
        return endpoint.qos
    profile = copy.copy(endpoint.qos)
    profile.history = HistoryPolicy.SYSTEM_DEFAULT
    profile.depth = 0
    return profile


def _named(
    endpoints: Iterable[EndpointSource],
    name: Callable[[str], str | None],
    type_name: Callable[[str], str],
) -> NamesAndTypes:
    return _collect((name(endpoint.topic), type_name(endpoint.type_name)) for endpoint in endpoints)


def _collect(pairs: Iterable[tuple[str | None, str]]) -> NamesAndTypes:
    types: dict[str, set[str]] = {}
    for name, type_name in pairs:
        if name is not None:
            types.setdefault(printable(name), set()).add(printable(type_name))
    return {name: sorted(types[name]) for name in sorted(types)}


def _action(dds_name: str) -> str | None:
    name = names.topic_from_dds(dds_name)
    return name[: -len(_FEEDBACK)] if name and name.endswith(_FEEDBACK) else None


def _action_type(dds_type: str) -> str:
    return names.type_from_dds(dds_type).removesuffix(_FEEDBACK_TYPE)
