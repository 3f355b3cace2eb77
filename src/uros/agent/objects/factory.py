"""What a CREATE makes on the network: nodes, endpoints, and all entities of an application."""

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

    def log(self, level: int, part: str, function: str, what: str, about: str) -> None:
        """Log a line about the client."""

    def on_ready(self, obj: XrceObject) -> Callable[[], None]:
        """The callback for samples that wait in the object's endpoint."""

    def on_refusal(self, obj: XrceObject) -> Callable[[list[int], str], None]:
        """The callback for requests that nobody will answer."""

    def on_dropped(self, obj: XrceObject) -> Callable[[str], None]:
        """The callback for samples that are dropped because too many wait."""

    def on_too_large(self, object_id: int) -> Callable[[str], None]:
        """The callback for messages over ``max_size`` of the rules."""

    def close_object(self, obj: XrceObject) -> None:
        """Close the object's endpoint and the parts of an application."""


class ObjectFactory:
    """Makes what the objects of one client stand for.

    It does not hold the client, which holds it: that would stay until Python looks for circles.
    """

    def __init__(
        self, agent: AgentContext, objects: dict[int, XrceObject], known: Known
    ) -> None:
        self._agent = agent
        self._objects = objects
        self._known = known
        # What the client has used of the middleware that is not given back before the end.
        self._types: set[str] = set()
        self._domains: set[int] = set()
        self._unnamed = UNNAMED

    def make(self, client: ObjectOwner, thing: XrceObject) -> str:
        """Bring the object to life; what the log says of it besides its id."""
        spec = thing.spec
        if isinstance(spec, ParticipantSpec):
            return self._make_node(client, thing, spec)
        if isinstance(spec, (TypeSpec, QosProfileSpec)):
            return ""
        if isinstance(spec, ApplicationSpec):
            self._make_parts(client, thing, spec)
            return f", entities: {len(thing.parts)}"
        parent = self._objects.get(thing.parent)
        if parent is None:
            raise UnknownReference(
                f"its {KIND_NAMES[thing.parent & 15]} {object_label(thing.parent)} does not exist"
            )
        about = f", {KIND_NAMES[parent.kind]}_id: {object_label(parent.object_id)}"
        if isinstance(spec, TopicSpec):
            parent.settings.topic(spec.name)  # refused here, and not only with its first endpoint
            if names.split_dds(spec.name) is None and not self._agent.middleware.any_name:
                client.log(
                    INFO, "ProxyClient", "create_topic", "not a ROS topic",
                    f"topic: {spec.name}, ROS 2 nodes see names that begin with rt/ only",
                )  # fmt: skip
        if isinstance(spec, (TopicSpec, GroupSpec)):
            return about
        participant = self._participant_of(parent)
        node, thing.settings = participant.node, participant.settings
        assert node is not None
        if isinstance(spec, EndpointSpec):
            thing.endpoint = self._make_endpoint(client, thing, spec, parent, node)
        else:
            service = thing.settings.service(spec.service())
            thing.named = service.request_topic, service.request_type
            ready, budget = client.on_ready(thing), self._agent.budget
            dropped = client.on_dropped(thing)
            if thing.kind == ids.KIND_REQUESTER:
                thing.endpoint = RequesterEndpoint(
                    node, service, thing.object_id, ready, client.on_refusal(thing), budget,
                    dropped,
                )
            else:
                thing.endpoint = ReplierEndpoint(node, service, ready, budget, dropped)
        thing.node = node
        return about

    def _make_parts(self, client: ObjectOwner, thing: XrceObject, spec: ApplicationSpec) -> None:
        """All entities of an application, or none."""
        kinds = [thing.kind, *(it.kind for it in spec.items)]
        check_room(self._objects, kinds, self._agent.limits)
        try:
            for item in spec.items:
                object_id = item.object_id
                if object_id is None:
                    object_id = self._unnamed << 4 | item.kind
                    self._unnamed += 1
                elif object_id in self._objects or object_id == thing.object_id:
                    raise Taken(f"its {object_label(object_id)} exists already")
                made = thing.parts
                parent = made[item.parent].object_id if item.kind != ids.KIND_PARTICIPANT else 0
                own = representation.from_profile(
                    item.kind, item.profile, item.parent, self._known
                )
                part = XrceObject(object_id, parent, own)
                self.make(client, part)
                self._objects[object_id] = part
                made.append(part)
        except Exception:
            client.close_object(thing)
            raise

    def _domain(self, spec: ParticipantSpec, settings: Settings) -> int:
        for domain in (settings.domain, self._agent.domain_override):
            if domain is not None:
                return domain
        return self._agent.domain_of_agent if spec.domain == DOMAIN_FROM_AGENT else spec.domain

    def _make_node(self, client: ObjectOwner, thing: XrceObject, spec: ParticipantSpec) -> str:
        agent, key = self._agent, client.key
        given = node_name(spec.name)
        settings = agent.rules.settings(
            key, agent.address(key), names.join(*given), agent.clock.monotonic
        )
        settings.any_name = agent.middleware.any_name
        domain = self._domain(spec, settings)
        use(self._domains, domain, agent.limits.domains, "domains")
        namespace, name = settings.node(*given)
        thing.settings = settings
        thing.named = names.join(namespace, name), str(domain)
        thing.node = agent.middleware.create_node(domain, namespace, name, spec.localhost_only)
        return f", domain_id: {domain}, node: {names.join(namespace, name)}"

    def _participant_of(self, thing: XrceObject) -> XrceObject:
        participant = thing
        if thing.kind != ids.KIND_PARTICIPANT:
            found = self._objects.get(thing.parent)
            if found is None:
                raise UnknownReference(
                    f"its participant {object_label(thing.parent)} does not exist"
                )
            participant = found
        return participant

    def _make_endpoint(
        self,
        client: ObjectOwner,
        thing: XrceObject,
        spec: EndpointSpec,
        group: XrceObject,
        node: Node,
    ) -> Endpoint:
        topic, settings = self._topic(spec), thing.settings
        name = settings.topic(topic.name)
        use(self._types, topic.type_name, self._agent.limits.types, "types")
        thing.named = name, topic.type_name
        qos = copy(spec.qos)
        if isinstance(group.spec, GroupSpec) and group.spec.partitions and not qos.partitions:
            qos.partitions = group.spec.partitions
        qos.depth = min(qos.depth, MAX_UNREAD)  # the agent's owner may want more
        settings.apply(qos, topic.name)
        if thing.kind == ids.KIND_DATAREADER:
            if (topic.name, topic.type_name) == (GRAPH_TOPIC, GRAPH_TYPE):
                participant = self._objects[group.parent].spec
                assert isinstance(participant, ParticipantSpec)
                graph = self._agent.graphs.reader(
                    self._domain(participant, settings),
                    lambda: client.session.mtu,
                    client.on_ready(thing),
                    client.key,
                )
                if graph is not None:
                    return graph
            return ReaderEndpoint(
                node, name, topic.type_name, qos, client.on_ready(thing), self._agent.budget,
                client.on_dropped(thing),
            )  # fmt: skip
        writer = WriterEndpoint(
            node.create_writer(name, topic.type_name, qos),
            qos,
            self._agent.budget,
            settings.limiter,
            client.on_too_large(thing.object_id),
        )
        client.session.writers[thing.object_id] = writer.write
        return writer

    def _topic(self, spec: EndpointSpec) -> TopicSpec:
        if spec.topic_id is not None:
            topic_id = (spec.topic_id & 0xFFF0) | ids.KIND_TOPIC
            found = self._objects.get(topic_id)
            if found is None or not isinstance(found.spec, TopicSpec):
                raise UnknownReference(f"its topic {object_label(topic_id)} does not exist")
            return found.spec
        assert spec.topic is not None
        for thing in self._objects.values():
            if isinstance(thing.spec, TopicSpec) and spec.topic.name in (
                thing.spec.name,
                thing.representation and thing.representation[1],  # any_name: its text is its name
            ):
                return thing.spec
        if not spec.topic.type_name:
            raise UnknownReference(f"the type of topic {spec.topic.name!r} is not known")
        return spec.topic
