"""A node on DDS."""

from __future__ import annotations

from ...qos import QoSProfile
from ..base import OnReady, Service
from ..discovery_info.listed_node import ListedNode
from ..discovery_info.node_entry import NodeEntry, check_writable
from ..services.form import endpoint_id
from .context import DdsContext
from .domain import DdsDomain
from .endpoints import DdsReader, DdsReplier, DdsRequester, DdsWriter


class DdsNode(ListedNode):
    """A node of the ROS graph; it shares its participant with others.

    Attributes:
        context: What the parts of the middleware share.
        participant: Its participant.
    """

    def __init__(self, context: DdsContext, domain: DdsDomain, namespace: str, name: str) -> None:
        self.context = context
        self.participant = domain.participant()
        self._domain = domain
        super().__init__(
            NodeEntry(self.participant.nodes, self.participant.changed, namespace, name)
        )

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> DdsWriter:
        """Create a publisher's writer."""
        check_writable(topic)
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
        check_writable(service.request_topic)
        return DdsRequester(self, service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> DdsReplier:
        """Create a service's server."""
        check_writable(service.reply_topic)
        return DdsReplier(self, service, qos, on_ready)

    def service_endpoint_id(self) -> str:
        """Return a new id for a service client or server, as rmw_cyclonedds writes it."""
        return endpoint_id(self.participant.guid, next(self.context.service_ids))

    def expect_late_writers(self) -> None:
        """Prepare for a reliable reader; see :mod:`~uros.middleware.dds.late_writer_heartbeat`."""
        self._domain.expect_late_writers(self.participant)
