"""A node on DDS."""

from __future__ import annotations

from ...qos import QoSProfile
from ..base import MiddlewareError, Node, OnReady, Service
from ..discovery_info import codec
from ..guid import participant_of
from ..services.form import endpoint_id
from .context import DdsContext
from .domain import DdsDomain
from .endpoints import DdsReader, DdsReplier, DdsRequester, DdsWriter


class DdsNode(Node):
    """A node of the ROS graph; it shares its participant with others.

    Attributes:
        context: What the parts of the middleware share.
        participant: Its participant.
    """

    def __init__(self, context: DdsContext, domain: DdsDomain, namespace: str, name: str) -> None:
        self.context = context
        self.participant = domain.participant()
        self._domain = domain
        self._entities = codec.NodeEntities(namespace, name)
        self._endpoints: list[DdsWriter | DdsReader] = []
        self.participant.nodes.append(self._entities)
        self.participant.changed()

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> DdsWriter:
        """Create a publisher's writer."""
        _check_writable(topic)
        return DdsWriter(self, topic, type_name, qos, b"")

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> DdsReader:
        """Create a subscription's reader."""
        return DdsReader(self, topic, type_name, qos, on_ready, b"")

    def create_requester(
        self, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> DdsRequester:
        """Create a service client."""
        _check_writable(service.request_topic)
        return DdsRequester(self, service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> DdsReplier:
        """Create a service's server."""
        _check_writable(service.reply_topic)
        return DdsReplier(self, service, qos, on_ready)

    def service_endpoint_id(self) -> str:
        """Return a new id for a service client or server, as rmw_cyclonedds writes it."""
        return endpoint_id(self.participant.guid, next(self.context.service_ids))

    def expect_late_writers(self) -> None:
        """Prepare for a reliable reader; see :mod:`~uros.middleware.dds.late_writer_heartbeat`."""
        self._domain.expect_late_writers(self.participant)

    def adopt(self, readers: list[bytes], writers: list[bytes]) -> None:
        """List endpoints of another participant of this process as this node's alone.

        Args:
            readers: GUIDs of readers.
            writers: GUIDs of writers.
        """
        self._entities.readers += readers
        self._entities.writers += writers
        self.participant.changed()
        self._suppress(readers + writers)

    def disown(self, readers: list[bytes], writers: list[bytes]) -> None:
        """Undo :meth:`adopt`."""
        for listed, guids in (
            (self._entities.readers, readers),
            (self._entities.writers, writers),
        ):
            for guid in guids:
                listed.remove(guid)
        self.participant.changed()
        self._suppress(readers + writers)

    def _suppress(self, guids: list[bytes]) -> None:
        self._domain.suppress_nodes_of({participant_of(guid) for guid in guids})

    def register(self, endpoint: DdsWriter | DdsReader) -> None:
        """List an endpoint in the discovery info."""
        self._endpoints.append(endpoint)
        self._guids_like(endpoint).append(endpoint.guid)
        self.participant.changed()

    def unregister(self, endpoint: DdsWriter | DdsReader) -> None:
        """Remove an endpoint from the discovery info."""
        self._endpoints.remove(endpoint)
        self._guids_like(endpoint).remove(endpoint.guid)
        self.participant.changed()

    def _guids_like(self, endpoint: DdsWriter | DdsReader) -> list[bytes]:
        is_writer = isinstance(endpoint, DdsWriter)
        return self._entities.writers if is_writer else self._entities.readers

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        for endpoint in list(self._endpoints):
            endpoint.close()
        if self._entities in self.participant.nodes:
            self.participant.nodes.remove(self._entities)
            self.participant.changed()


def _check_writable(topic: str) -> None:
    """Raises MiddlewareError for a topic that nodes may not write to.

    Otherwise a board could write what only middlewares write, such as nodes that do not exist.
    Cyclone itself refuses the names of its builtin topics (DCPS…).
    """
    if topic == codec.TOPIC:
        raise MiddlewareError(f"nodes do not write on {topic}: it belongs to the middleware")
