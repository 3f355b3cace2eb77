"""The reader of other participants' ``ros_discovery_info`` in one domain."""

from __future__ import annotations

import time
from collections.abc import Callable

from ...qos import QoSProfile
from ..discovery_info import codec, intake
from . import builtin, cyclone
from .context import DdsContext
from .dispatcher import ReaderListener
from .participant import SharedParticipant


class DiscoveryInfoReader:
    """Reads discovery info within the limits of :mod:`uros.middleware.discovery_info.intake`.

    Attributes:
        intake: What has been read.
        due: When :meth:`tick` creates the reader again (``time.monotonic``), or None.

    Args:
        context: What the parts of the middleware share.
        participant: The participant that reads.
        on_change: Called after changes, in the data plane's thread.
    """

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.intake = intake.Intake(participant.domain, context.notice)
        self.due: float | None = None
        self._context = context
        self._participant = participant
        self._on_change = on_change
        self._listener: ReaderListener | None = None
        self._qos = codec.qos()
        # The topic has no key: with a depth of 1 participants would displace each other's samples.
        self._qos.depth = intake.MAX_UNREAD
        self._create()
        context.schedule.add(self)

    def _arguments(self) -> tuple[str, str, QoSProfile]:
        return codec.TOPIC, codec.TYPE, self._qos

    def _create(self) -> None:
        entity = self._participant.create_reader(*self._arguments(), b"")
        self._listener = ReaderListener(self._context.dispatcher, entity, self._on_ready)

    def _delete(self) -> None:
        if self._listener is not None:
            listener, self._listener = self._listener, None
            self._context.dispatcher.unwatch(listener)
            self._participant.delete_reader(listener.entity, *self._arguments())

    def recreate(self) -> None:
        """Read everything again with a new reader, unless one is due anyway.

        A Fast DDS writer offers its samples when it matches a reader. If the reader does not know
        the writer yet, that heartbeat is lost, and the next comes after up to three seconds; a new
        reader gets one at once.
        """
        if self.due is None:
            self._delete()
            self._create()

    def _on_ready(self) -> None:
        listener = self._listener
        if listener is None:
            return
        listener.taken = True
        now = time.monotonic()
        turn = self.intake.read(lambda: self._take(listener.entity), now)
        if turn.has_more:
            self._context.dispatcher.requeue(listener)
        if turn.pause is not None:
            self._delete()
            self.due = now + turn.pause
        if turn.is_changed:
            self._on_change()

    def _take(self, entity: int) -> tuple[bytes | None, bytes] | None:
        samples = cyclone.take(entity, 1)
        if not samples:
            return None
        sample, info = samples[0]
        writer = builtin.matched_writer(entity, info.publication_handle)
        return writer and writer[0], sample

    def tick(self, now: float) -> None:
        """Create the reader again: the token bucket has filled up."""
        self.due = None
        self._create()

    def close(self) -> None:
        """Stop reading; idempotent."""
        self.due = None
        self._delete()
        self._context.schedule.remove(self)
