"""How much of a living client is in the state file, so that only what is new gets there."""

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
from .records import SLOT_IN, SLOT_IN_AT, SLOT_OUT, SLOT_OUT_AT, Incoming, Kept, Outgoing, Reading

# The last sample of a transient-local writer is kept up to this size.
MAX_LATCHED: Final = 64 * 1024


class From:
    """How far a reliable stream from a client is in the file. ``at``: its place in the slot."""

    __slots__ = ("at", "next", "pending", "skip", "whole")

    def __init__(self, at: int) -> None:
        self.at = at
        self.next = -1
        self.pending = 0  # bytes of `whole` that are in the file
        self.whole: bytearray | None = None
        self.skip = False

    def is_whole(self, fragments: Fragments) -> bool:
        """Whether no fragment has come since the last look, nor before the last whole message."""
        pending = self.pending or self.skip or fragments._skip or fragments._whole
        return self.whole is fragments._whole and not pending


class To:
    """The same of one to a client."""

    __slots__ = ("at", "next", "sent")

    def __init__(self, at: int) -> None:
        self.at = at
        self.next = 0
        self.sent = -1


class Entry:
    """A client that is kept, and what of it is in the file."""

    __slots__ = ("best_effort", "changed", "client", "count", "hold_until", "incoming", "index",
                 "kept", "limited", "news", "outgoing", "serial", "slot", "streams_from",
                 "streams_to")  # fmt: skip

    def __init__(self, client: ClientState, kept: Kept, serial: int, index: int) -> None:
        self.client = client
        self.kept = kept
        self.serial = serial
        self.index = index
        self.count = 0
        self.slot = bytearray(SLOT_SIZE)
        self.changed = False
        self.hold_until = 0.0
        self.limited: set[int] = set()  # objects whose READ_DATA ends by itself
        self.news: set[int] = set()  # writers with another last sample
        self.start_streams()

    def start_streams(self) -> None:
        self.incoming, self.outgoing, self.best_effort = self.client.session.streams()
        self.streams_from: dict[int, From] = {}
        self.streams_to: dict[int, To] = {}
        self.slot[SLOT_IN_AT:] = bytes(SLOT_SIZE - SLOT_IN_AT)

    def stream_from(self, stream_id: int) -> From:
        at = SLOT_IN_AT + len(self.streams_from) * SLOT_IN.size
        return self.streams_from.setdefault(stream_id, From(at))

    def stream_to(self, stream_id: int) -> To:
        at = SLOT_OUT_AT + len(self.streams_to) * SLOT_OUT.size
        return self.streams_to.setdefault(stream_id, To(at))

    def resume(self) -> None:
        """The file's numbers are the session's."""
        self.start_streams()
        for stream_id, it in self.kept.incoming.items():
            came = self.stream_from(stream_id)
            came.next, came.pending, came.skip = it.next, len(it.fragments), it.skip
            # The session's own bytes, to which the next ones come.
            came.whole = self.incoming[stream_id].fragments._whole
            it.fragments = bytearray()
        for stream_id, out in self.kept.outgoing.items():
            goes = self.stream_to(stream_id)
            goes.next, goes.sent = out.next, out.sent
        self.kept.incoming, self.kept.outgoing = {}, {}

    def note_limits(self, object_id: int, reading: Reading) -> None:
        """Of READ_DATA that ends by itself, what is left is to be written."""
        control = reading[2]
        if control is None or control[0] != 0xFFFF or control[1]:
            self.limited.add(object_id)

    def watch_samples(self, thing: XrceObject, attend: Callable[[Session], None]) -> None:
        """Keep the last sample of a writer that late readers can ask for it."""
        spec, object_id, session = thing.spec, thing.object_id, self.client.session
        endpoint = thing.endpoint
        if not isinstance(endpoint, WriterEndpoint) or object_id > 0xFFFF:
            return
        assert isinstance(spec, EndpointSpec)
        qos = spec.qos
        if not qos.transient_local or qos.history == HistoryPolicy.KEEP_ALL or qos.depth != 1:
            return
        latched, news = self.kept.latched, self.news

        def record_last_sample(sample: memoryview) -> None:
            # A longer one is not kept, and what was before it is the last no more.
            latched[object_id] = bytes(sample) if len(sample) <= MAX_LATCHED else b""
            news.add(object_id)
            attend(session)

        endpoint.set_recorder(record_last_sample)

    def fill(self) -> None:
        """The streams as they were written down, from what the session still holds of them."""
        kept = self.kept
        for stream_id, came in self.streams_from.items():
            pending = bytearray()
            if came.pending:
                # The rest may have come and stalled: then this is its beginning, and what was
                # cut off behind its end means nothing.
                assert came.whole is not None
                pending = came.whole[: came.pending].ljust(came.pending, b"\0")
            kept.incoming[stream_id] = Incoming(max(0, came.next), pending, came.skip)
        for stream_id, goes in self.streams_to.items():
            out = self.outgoing[stream_id]
            # What was acknowledged since the last look, whether it had been sent or not.
            acked = out.acked
            if (goes.next - acked) & 0xFFFF > MAX_HELD:
                goes.next = acked
            if goes.sent < 0 or (goes.sent - acked) & 0xFFFF > MAX_HELD:
                goes.sent = acked
            numbers = ((acked + it) & 0xFFFF for it in range((goes.next - acked) & 0xFFFF))
            held = {it: out._held[it] for it in numbers}
            kept.outgoing[stream_id] = Outgoing(acked, goes.sent, goes.next, held)
