"""Write cursor: how much of the client is already on disk, so that only changes are written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ...qos import HistoryPolicy
from ...wire.streams import MAX_HELD, Fragments
from ..context import ClientState
from ..objects.endpoints import WriterEndpoint
from ..objects.object_table import XrceObject
from ..objects.representation import EndpointSpec
from ..session.session import Session
from .journal import SLOT_SIZE
from .records import (
    SLOT_IN,
    SLOT_IN_AT,
    SLOT_OUT,
    SLOT_OUT_AT,
    ClientRecords,
    Incoming,
    Outgoing,
    Reading,
)

# The last sample of a transient-local datawriter is stored up to this size, in bytes.
MAX_LATCHED: Final = 64 * 1024


class InboundCursor:
    """How much of a reliable stream from a client is on disk; ``at``: its offset in the slot."""

    __slots__ = ("at", "next", "pending", "skip", "whole")

    def __init__(self, at: int) -> None:
        self.at = at
        self.next = -1
        self.pending = 0  # bytes of `whole` that are on disk
        self.whole: bytearray | None = None
        self.skip = False

    def is_whole(self, fragments: Fragments) -> bool:
        """Return whether there are no fragments, neither new ones nor any on disk."""
        whole, skip = fragments.export()
        return self.whole is whole and not (self.pending or self.skip or skip or whole)


class OutboundCursor:
    """How much of a reliable stream to a client is on disk; ``at``: its offset in the slot."""

    __slots__ = ("at", "next", "sent")

    def __init__(self, at: int) -> None:
        self.at = at
        self.next = 0
        self.sent = -1


class WriteCursor:
    """A stored client, and how much of it is on disk.

    Args:
        client: The client.
        records: Its records on disk.
        serial: The serial of its records in the journal.
        index: Its slot.
    """

    __slots__ = ("best_effort", "changed", "client", "count", "hold_until", "incoming", "index",
                 "records", "limited", "news", "outgoing", "serial", "slot", "inbound_cursors",
                 "outbound_cursors")  # fmt: skip

    def __init__(
        self, client: ClientState, records: ClientRecords, serial: int, index: int
    ) -> None:
        self.client = client
        self.records = records
        self.serial = serial
        self.index = index
        self.count = 0
        self.slot = bytearray(SLOT_SIZE)
        self.changed = False
        self.hold_until = 0.0
        self.limited: set[int] = set()  # objects whose READ_DATA has a limit
        self.news: set[int] = set()  # ids of datawriters whose last sample is not on disk
        self.start_streams()

    def start_streams(self) -> None:
        """Begin with streams of which nothing is on disk."""
        self.incoming, self.outgoing, self.best_effort = self.client.session.streams()
        self.inbound_cursors: dict[int, InboundCursor] = {}
        self.outbound_cursors: dict[int, OutboundCursor] = {}
        self.slot[SLOT_IN_AT:] = bytes(SLOT_SIZE - SLOT_IN_AT)

    def inbound(self, stream_id: int) -> InboundCursor:
        """Return the cursor of a stream from the client; the first call adds it."""
        at = SLOT_IN_AT + len(self.inbound_cursors) * SLOT_IN.size
        return self.inbound_cursors.setdefault(stream_id, InboundCursor(at))

    def outbound(self, stream_id: int) -> OutboundCursor:
        """Return the cursor of a stream to the client; the first call adds it."""
        at = SLOT_OUT_AT + len(self.outbound_cursors) * SLOT_OUT.size
        return self.outbound_cursors.setdefault(stream_id, OutboundCursor(at))

    def resume(self) -> None:
        """Take over the streams of the file for the restored session."""
        self.start_streams()
        for stream_id, stored in self.records.incoming.items():
            inbound = self.inbound(stream_id)
            inbound.next, inbound.skip = stored.next, stored.skip
            inbound.pending = len(stored.fragments)
            # The session's own buffer, which grows with further fragments.
            inbound.whole = self.incoming[stream_id].fragments.export()[0]
            stored.fragments = bytearray()
        for stream_id, out in self.records.outgoing.items():
            outbound = self.outbound(stream_id)
            outbound.next, outbound.sent = out.next, out.sent
        self.records.incoming, self.records.outgoing = {}, {}

    def note_limits(self, object_id: int, reading: Reading) -> None:
        """Note whether a READ_DATA has a limit, so that the samples left must be stored."""
        control = reading[2]
        if control is None or control[0] != 0xFFFF or control[1]:
            self.limited.add(object_id)

    def watch_samples(self, obj: XrceObject, attend: Callable[[Session], None]) -> None:
        """Store the last sample of a transient-local datawriter of depth 1."""
        spec, object_id, session = obj.spec, obj.object_id, self.client.session
        endpoint = obj.endpoint
        if not isinstance(endpoint, WriterEndpoint) or object_id > 0xFFFF:
            return
        assert isinstance(spec, EndpointSpec)
        qos = spec.qos
        if not qos.transient_local or qos.history == HistoryPolicy.KEEP_ALL or qos.depth != 1:
            return
        latched, news = self.records.latched, self.news

        def record_last_sample(sample: memoryview) -> None:
            # A longer one is not stored, and the one before it is not the last any more.
            latched[object_id] = bytes(sample) if len(sample) <= MAX_LATCHED else b""
            news.add(object_id)
            attend(session)

        endpoint.set_recorder(record_last_sample)

    def fill(self) -> None:
        """Copy the streams as they are on disk into the records, for a rewrite."""
        records = self.records
        for stream_id, inbound in self.inbound_cursors.items():
            pending = bytearray()
            if inbound.pending:
                # The rest may have arrived and stalled: then this is the beginning of the message,
                # and the padding after its end has no meaning.
                assert inbound.whole is not None
                pending = inbound.whole[: inbound.pending].ljust(inbound.pending, b"\0")
            records.incoming[stream_id] = Incoming(max(0, inbound.next), pending, inbound.skip)
        for stream_id, outbound in self.outbound_cursors.items():
            out = self.outgoing[stream_id]
            # Messages acknowledged since the last write, whether they had been sent or not.
            acked, _, _, messages = out.export()
            if (outbound.next - acked) & 0xFFFF > MAX_HELD:
                outbound.next = acked
            if outbound.sent < 0 or (outbound.sent - acked) & 0xFFFF > MAX_HELD:
                outbound.sent = acked
            count = (outbound.next - acked) & 0xFFFF
            numbers = ((acked + index) & 0xFFFF for index in range(count))
            kept_messages = {number: messages[number] for number in numbers}
            records.outgoing[stream_id] = Outgoing(
                acked, outbound.sent, outbound.next, kept_messages
            )
