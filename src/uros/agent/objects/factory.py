"""Creates nodes and endpoints of the middleware, and all entities of an application."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Protocol

from ... import names
from ...middleware.base import Node
from ...wire import ids
from ..context import AgentContext
from ..log import INFO
from ..policy.limits import use
from ..policy.rules import Settings
from ..session.session import Session
from . import representation
from .application import DOMAIN_FROM_AGENT
from .endpoints import (
    MAX_UNREAD,
    ReaderEndpoint,
    ReplierEndpoint,
    RequesterEndpoint,
    WriterEndpoint,
)
from .kinds import KIND_NAMES, object_label
from .object_table import UNNAMED, Endpoint, Known, Taken, XrceObject, check_room, node_name
from .representation import (
    ApplicationSpec,
    EndpointSpec,
    GroupSpec,
    ParticipantSpec,
    QosProfileSpec,
    TopicSpec,
    TypeSpec,
    UnknownReference,
)
from .ros_graph import TOPIC as GRAPH_TOPIC
from .ros_graph import TYPE as GRAPH_TYPE


class ObjectOwner(Protocol):
    """What the factory uses of the client that it works for: a ProxyClient."""

    key: int
    session: Session

    def log(self, level: int, part: str, function: str, event: str, about: str) -> None:
        """Log a line about the client."""

    def on_ready(self, obj: XrceObject) -> Callable[[], None]:
        """Return the callback for samples that wait in the object's endpoint."""

    def on_refusal(self, obj: XrceObject) -> Callable[[list[int], str], None]:
        """Return the callback for requests that nobody will answer."""

    def on_dropped(self, obj: XrceObject) -> Callable[[str], None]:
        """Return the callback for samples that are dropped because too many wait."""

    def on_too_large(self, object_id: int) -> Callable[[str], None]:
        """Return the callback for messages over ``max_size`` of the rules."""

    def close_object(self, obj: XrceObject) -> None:
        """Close the object's endpoint and the parts of an application."""


class ObjectFactory:
    """Creates the nodes and endpoints of one client's objects.

    It gets the client with each call and keeps no reference to it. The client has a reference to
    the factory, and a reference cycle would keep both in memory until the garbage collector runs.
    """

    def __init__(
        self, agent: AgentContext, objects: dict[int, XrceObject], definitions: Known
    ) -> None:
        self._agent = agent
        self._objects = objects
        self._known = definitions
        # What the middleware keeps until it is closed: types and domains that the client has used.
        self._types: set[str] = set()
        self._domains: set[int] = set()
        self._unnamed = UNNAMED

    def create(self, client: ObjectOwner, obj: XrceObject) -> str:
        """Create the object's node, endpoint or parts.

        Args:
            client: The client that owns the object.
            obj: The object, which gets what is created.

        Returns:
            The text that describes it in the log line, after its id.

        Raises:
            UnknownReference: Its parent, or what it refers to, does not exist.
            NameRefused: The rules do not allow its name.
            TooMany: The client would exceed a limit.
            Taken: The id of an application's entity is in use.
            MiddlewareError: The middleware cannot create it.
        """
        spec = obj.spec
        if isinstance(spec, ParticipantSpec):
            return self._create_node(client, obj, spec)
        if isinstance(spec, (TypeSpec, QosProfileSpec)):
            return ""
        if isinstance(spec, ApplicationSpec):
            self._create_parts(client, obj, spec)
            return f", entities: {len(obj.parts)}"
        parent = self._objects.get(obj.parent)
        if parent is None:
            raise UnknownReference(
                f"its {KIND_NAMES[obj.parent & 15]} {object_label(obj.parent)} does not exist"
            )
        about = f", {KIND_NAMES[parent.kind]}_id: {object_label(parent.object_id)}"
        if isinstance(spec, TopicSpec):
            parent.settings.topic(spec.name)  # refuse it here, not with its first endpoint
            if names.split_dds(spec.name) is None and not self._agent.middleware.any_name:
                client.log(
                    INFO, "ProxyClient", "create_topic", "not a ROS topic",
                    f"topic: {spec.name}, ROS 2 nodes see names that begin with rt/ only",
                )  # fmt: skip
        if isinstance(spec, (TopicSpec, GroupSpec)):
            return about
        participant = self._participant_of(parent)
        node, obj.settings = participant.node, participant.settings
        assert node is not None
        if isinstance(spec, EndpointSpec):
            obj.endpoint = self._create_endpoint(client, obj, spec, parent, node)
        else:
            service = obj.settings.service(spec.service())
            obj.named = service.request_topic, service.request_type
            ready, budget = client.on_ready(obj), self._agent.budget
            dropped = client.on_dropped(obj)
            if obj.kind == ids.KIND_REQUESTER:
                obj.endpoint = RequesterEndpoint(
                    node,
                    service,
                    obj.object_id,
                    ready,
                    client.on_refusal(obj),
                    budget,
                    dropped,
                )
            else:
                obj.endpoint = ReplierEndpoint(node, service, ready, budget, dropped)
        obj.node = node
        return about

    def _create_parts(self, client: ObjectOwner, obj: XrceObject, spec: ApplicationSpec) -> None:
        """Create all entities of an application, or none."""
        kinds = [obj.kind, *(item.kind for item in spec.items)]
        check_room(self._objects, kinds, self._agent.limits)
        try:
            for item in spec.items:
                object_id = item.object_id
                if object_id is None:
                    object_id = self._unnamed << 4 | item.kind
                    self._unnamed += 1
                elif object_id in self._objects or object_id == obj.object_id:
                    raise Taken(f"its {object_label(object_id)} exists already")
                parts = obj.parts
                parent = parts[item.parent].object_id if item.kind != ids.KIND_PARTICIPANT else 0
                own = representation.from_profile(item.kind, item.profile, item.parent, self._known)
                part = XrceObject(object_id, parent, own)
                self.create(client, part)
                self._objects[object_id] = part
                parts.append(part)
        except Exception:
            client.close_object(obj)
            raise

    def _domain(self, spec: ParticipantSpec, settings: Settings) -> int:
        for domain in (settings.domain, self._agent.domain_override):
            if domain is not None:
                return domain
        return self._agent.domain_of_agent if spec.domain == DOMAIN_FROM_AGENT else spec.domain

    def _create_node(self, client: ObjectOwner, obj: XrceObject, spec: ParticipantSpec) -> str:
        agent, key = self._agent, client.key
        requested_name = node_name(spec.name)
        settings = agent.rules.settings(
            key, agent.address(key), names.join(*requested_name), agent.clock.monotonic
        )
        settings.any_name = agent.middleware.any_name
        domain = self._domain(spec, settings)
        use(self._domains, domain, agent.limits.domains, "domains")
        namespace, name = settings.node(*requested_name)
        obj.settings = settings
        obj.named = names.join(namespace, name), str(domain)
        obj.node = agent.middleware.create_node(domain, namespace, name, spec.localhost_only)
        return f", domain_id: {domain}, node: {names.join(namespace, name)}"

    def _participant_of(self, obj: XrceObject) -> XrceObject:
        participant = obj
        if obj.kind != ids.KIND_PARTICIPANT:
            parent = self._objects.get(obj.parent)
            if parent is None:
                raise UnknownReference(f"its participant {object_label(obj.parent)} does not exist")
            participant = parent
        return participant

    def _create_endpoint(
        self,
        client: ObjectOwner,
        obj: XrceObject,
        spec: EndpointSpec,
        group: XrceObject,
        node: Node,
    ) -> Endpoint:
        topic, settings = self._topic(spec), obj.settings
        name = settings.topic(topic.name)
        use(self._types, topic.type_name, self._agent.limits.types, "types")
        obj.named = name, topic.type_name
        qos = copy(spec.qos)
        if isinstance(group.spec, GroupSpec) and group.spec.partitions and not qos.partitions:
            qos.partitions = group.spec.partitions
        qos.depth = min(qos.depth, MAX_UNREAD)  # rules may raise it again
        settings.apply(qos, topic.name)
        if obj.kind == ids.KIND_DATAREADER:
            if (topic.name, topic.type_name) == (GRAPH_TOPIC, GRAPH_TYPE):
                participant = self._objects[group.parent].spec
                assert isinstance(participant, ParticipantSpec)
                graph = self._agent.graphs.reader(
                    self._domain(participant, settings),
                    lambda: client.session.mtu,
                    client.on_ready(obj),
                    client.key,
                )
                if graph is not None:
                    return graph
            return ReaderEndpoint(
                node, name, topic.type_name, qos, client.on_ready(obj), self._agent.budget,
                client.on_dropped(obj),
            )  # fmt: skip
        writer = WriterEndpoint(
            node.create_writer(name, topic.type_name, qos),
            qos,
            self._agent.budget,
            settings.limiter,
            client.on_too_large(obj.object_id),
        )
        client.session.writers[obj.object_id] = writer.write
        return writer

    def _topic(self, spec: EndpointSpec) -> TopicSpec:
        if spec.topic_id is not None:
            topic_id = (spec.topic_id & 0xFFF0) | ids.KIND_TOPIC
            topic = self._objects.get(topic_id)
            if topic is None or not isinstance(topic.spec, TopicSpec):
                raise UnknownReference(f"its topic {object_label(topic_id)} does not exist")
            return topic.spec
        assert spec.topic is not None
        for obj in self._objects.values():
            if isinstance(obj.spec, TopicSpec) and spec.topic.name in (
                obj.spec.name,
                obj.representation and obj.representation[1],  # any_name: its text is its name
            ):
                return obj.spec
        if not spec.topic.type_name:
            raise UnknownReference(f"the type of topic {spec.topic.name!r} is not known")
        return spec.topic
