"""What the parts of one DDS middleware share, and its readers by topic."""

from __future__ import annotations

import itertools

from ...qos import QoSProfile
from ..base import Middleware, OnReady
from ..ref_counted import RefCounted
from .dispatcher import Dispatcher, ReaderListener
from .participant import SharedParticipant
from .schedule import Schedule


class TopicReader(ReaderListener):
    """A reader of a topic that a node has.

    Attributes:
        participant: The participant it belongs to.
        type_name: The DDS name of its type.
        qos: Its profile.
        needs_heartbeat: Whether writers that Cyclone discovers late must be made to send a
            heartbeat; see :mod:`~uros.middleware.dds.late_writer_heartbeat`.
    """

    __slots__ = ("needs_heartbeat", "participant", "qos", "type_name")

    def __init__(
        self,
        dispatcher: Dispatcher,
        entity: int,
        on_ready: OnReady,
        participant: SharedParticipant,
        type_name: str,
        qos: QoSProfile,
        needs_heartbeat: bool,
    ) -> None:
        self.participant = participant
        self.type_name = type_name
        self.qos = qos
        self.needs_heartbeat = needs_heartbeat
        super().__init__(dispatcher, entity, on_ready, may_be_local=True)


class DdsContext:
    """What nodes, endpoints and the readers of discovery need of their middleware.

    Attributes:
        middleware: The contract's side: its ``batching``, ``on_type_conflict`` and notices.
        dispatcher: Tells readers of their samples.
        schedule: What is done by time.
        readers: This middleware's readers by (domain, topic), each list kept up to date.
        unsent: Writers that hold samples back until a flush.
        service_ids: Numbers for the ids of service clients and servers.
    """

    def __init__(self, middleware: Middleware) -> None:
        self.middleware = middleware
        self.dispatcher = Dispatcher()
        self.schedule = Schedule()
        self.readers = RefCounted[tuple[int, str], list[TopicReader]](
            lambda _key: [], lambda _readers: None
        )
        self.unsent: set[int] = set()
        self.service_ids = itertools.count(1)

    def notice(self, text: str) -> None:
        """Pass a notice to the user, once for each text."""
        self.middleware.notice(text)
