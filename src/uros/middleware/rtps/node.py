"""A node on RTPS."""

from __future__ import annotations

from functools import partial

from ...qos import QoSProfile
from .. import user_data
from ..base import OnReady, Service
from ..discovery_info.listed_node import ListedNode
from ..discovery_info.node_entry import NodeEntry, check_writable
from ..services.form import CLIENT_ID, SERVICE_ID, endpoint_id
from .domain import RtpsDomain
from .endpoints import RtpsReader, RtpsWriter
from .services import MIN_DEPTH, RtpsReplier, RtpsRequester


class RtpsNode(ListedNode):
    """A node of the ROS graph; it shares its participant with the others of its domain.

    Args:
        domain: The domain.
        entry: The node in the discovery info, of the domain's participant or of another one.
    """

    def __init__(self, domain: RtpsDomain, entry: NodeEntry) -> None:
        super().__init__(entry)
        self._domain = domain

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> RtpsWriter:
        """Create a publisher's writer."""
        check_writable(topic)
        writer = RtpsWriter(self._domain, topic, type_name, _announced(qos, type_name))
        self._register(writer)
        return writer

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> RtpsReader:
        """Create a subscription's reader."""
        profile = _announced(qos, type_name)
        reader = RtpsReader(self._domain, topic, type_name, profile, on_ready)
        self._register(reader)
        return reader

    def create_requester(
        self, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> RtpsRequester:
        """Create a service client."""
        check_writable(service.request_topic)
        profile = self._service_profile(qos, CLIENT_ID)
        requester = RtpsRequester(self._domain, service, profile, on_ready)
        self._register(*requester.endpoints)
        return requester

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> RtpsReplier:
        """Create a service's server."""
        check_writable(service.reply_topic)
        profile = self._service_profile(qos, SERVICE_ID)
        replier = RtpsReplier(self._domain, service, profile, on_ready)
        self._register(*replier.endpoints)
        return replier

    def _service_profile(self, qos: QoSProfile, key: bytes) -> QoSProfile:
        """A copy of a profile with an id as rmw_cyclonedds writes it, and room for bursts."""
        number = next(self._domain.service_ids)
        user_data = endpoint_id(self._domain.participant.guid, number).encode() + b";"
        profile = _with_user_data(qos, key + user_data)
        profile.depth = max(profile.depth, MIN_DEPTH)
        return profile

    def _register(self, *endpoints: RtpsWriter | RtpsReader) -> None:
        """List endpoints in the discovery info until they are closed."""
        for endpoint in endpoints:
            self.register(endpoint)
            endpoint.on_close = partial(self.unregister, endpoint)


def _announced(qos: QoSProfile, type_name: str) -> QoSProfile:
    """A copy of a profile with the type's hash in USER_DATA."""
    return _with_user_data(qos, user_data.type_hash(type_name))


def _with_user_data(qos: QoSProfile, more: bytes) -> QoSProfile:
    fields = {name: getattr(qos, name) for name in QoSProfile.__slots__}
    return QoSProfile(**dict(fields, user_data=qos.user_data + more))
