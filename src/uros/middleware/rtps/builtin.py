"""Our endpoints of builtin topics (RTPS 8.5.4): reliable, and matched without announcements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from ...qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from . import ids
from .local import EndpointSchedule, LocalReader, LocalWriter
from .outbox import Outbox
from .parameters import EndpointData
from .reader import Sample, StatefulReader
from .reassembly import OctetBudget
from .remote import RemoteParticipant
from .writer import StatefulWriter


class BuiltinTopic(NamedTuple):
    """The numbers of a builtin topic.

    Attributes:
        writer: Entity id of each participant's writer.
        reader: Entity id of each participant's reader.
        writer_bit: The bit of PID_BUILTIN_ENDPOINT_SET of participants that have the writer.
        reader_bit: The same of the reader.
    """

    writer: bytes
    reader: bytes
    writer_bit: int
    reader_bit: int


PUBLICATIONS: Final = BuiltinTopic(
    ids.PUBLICATIONS_WRITER,
    ids.PUBLICATIONS_READER,
    ids.BIT_PUBLICATIONS_ANNOUNCER,
    ids.BIT_PUBLICATIONS_DETECTOR,
)
SUBSCRIPTIONS: Final = BuiltinTopic(
    ids.SUBSCRIPTIONS_WRITER,
    ids.SUBSCRIPTIONS_READER,
    ids.BIT_SUBSCRIPTIONS_ANNOUNCER,
    ids.BIT_SUBSCRIPTIONS_DETECTOR,
)
PARTICIPANT_MESSAGES: Final = BuiltinTopic(
    ids.PARTICIPANT_MESSAGE_WRITER,
    ids.PARTICIPANT_MESSAGE_READER,
    ids.BIT_PARTICIPANT_MESSAGE_WRITER,
    ids.BIT_PARTICIPANT_MESSAGE_READER,
)
# All that each participant of ours has, for PID_BUILTIN_ENDPOINT_SET.
SERVED: Final = (
    ids.BIT_PARTICIPANT_ANNOUNCER
    | ids.BIT_PARTICIPANT_DETECTOR
    | sum(
        topic.writer_bit | topic.reader_bit
        for topic in (PUBLICATIONS, SUBSCRIPTIONS, PARTICIPANT_MESSAGES)
    )
)
# What the history keeps of a topic without a depth: there are no more entity ids.
_LIMIT: Final = 1 << 24
_QOS: Final = QoSProfile(
    durability=DurabilityPolicy.TRANSIENT_LOCAL, history=HistoryPolicy.KEEP_ALL
)


class BuiltinEndpoints:
    """Our writer and our reader of a builtin topic.

    Attributes:
        writer: The writer.
        reader: The reader.

    Args:
        topic: The topic.
        prefix: Our GUID prefix.
        fragment_size: Octets of a fragment.
        outbox: Where the writer's packets go.
        schedule: Where both are scheduled.
        budget: For samples that are incomplete or early.
        deliver: Called with each sample received, again if it came before its turn.
        depth: Samples that the writer's history keeps; None: all.
    """

    def __init__(
        self,
        topic: BuiltinTopic,
        prefix: bytes,
        fragment_size: int,
        outbox: Outbox,
        schedule: EndpointSchedule,
        budget: OctetBudget,
        deliver: Callable[[Sample], None],
        depth: int | None = None,
    ) -> None:
        def accept(sample: Sample) -> bool:
            deliver(sample)
            return True

        self._topic = topic
        self._outbox = outbox
        guid = prefix + topic.writer
        history = StatefulWriter(
            guid, True, True, depth, fragment_size, _LIMIT, repeats=outbox.repeats
        )
        history.on_change = schedule.touch
        self.writer = LocalWriter(outbox, EndpointData(guid, True, "", "", _QOS), history)
        guid = prefix + topic.reader
        # Fast DDS repeats what it announced before a match after 0.1 s only. What it announces then
        # must not wait for that. Delivering it again, in the order of its numbers, corrects what
        # was applied out of order.
        received = StatefulReader(guid, True, True, accept, budget, on_early=deliver)
        received.on_change = schedule.touch
        self.reader = LocalReader(EndpointData(guid, False, "", "", _QOS), received)

    def match(self, remote: RemoteParticipant, now: float) -> None:
        """Match those of another participant that it says it has."""
        topic, bits = self._topic, remote.data.builtin
        if bits & topic.reader_bit:
            guid = remote.prefix + topic.reader
            packets = self.writer.state.match(guid, True, True, now)
            self._outbox.add_packets(self.writer.state, packets)
        if bits & topic.writer_bit:
            self.reader.state.match(remote.prefix + topic.writer, True, now)

    def resume(self, remote: RemoteParticipant, now: float) -> None:
        """Ask another participant again at once, which could not be sent what was due.

        Until it has answered it gets the heartbeats alone, which are answered: all together may
        be more octets than it may be sent.
        """
        self.writer.state.ask(remote.prefix + self._topic.reader, now)
        if remote.is_proven:
            self.reader.state.ask(remote.prefix + self._topic.writer, now)
