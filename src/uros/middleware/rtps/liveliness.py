"""Participant messages: we assert that our writers are alive (RTPS 8.4.13).

A reader may request that each writer shows within a lease that it is alive. For writers with
AUTOMATIC liveliness their participant does so, by a sample of a builtin topic. Those with
MANUAL_BY_TOPIC show it by what they write.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

from ...qos import LivelinessPolicy, QoSProfile
from . import ids
from .builtin import BuiltinEndpoints

# Messages in the time of the shortest lease: one may come late, and be repeated.
_PER_LEASE: Final = 3
# Attack: a lease of a millisecond. Seconds between messages, at least.
_MIN_PERIOD: Final = 0.02
_CDR_LE: Final = b"\x00\x01\x00\x00"


def write_participant_message(prefix: bytes) -> bytes:
    """Return ParticipantMessageData (9.6.3.1) of AUTOMATIC liveliness, without data."""
    return _CDR_LE + prefix + ids.AUTOMATIC_LIVELINESS_UPDATE + bytes(4)


class LivelinessAssertion:
    """Asserts AUTOMATIC liveliness for the writers of a participant.

    Attributes:
        due: When :meth:`poll` writes the next message; None while no writer has a lease.

    Args:
        topic: Our endpoints of participant messages.
        prefix: Our GUID prefix.
    """

    def __init__(self, topic: BuiltinEndpoints, prefix: bytes) -> None:
        self.due: float | None = None
        self._topic = topic
        self._message = write_participant_message(prefix)
        self._writers: Counter[int] = Counter()  # by lease in ms

    def add(self, qos: QoSProfile, now: float) -> None:
        """Assert the liveliness of a writer of this profile, if that is ours to do."""
        lease = _lease(qos)
        if lease is None:
            return
        self._writers[lease] += 1
        if lease == min(self._writers):
            self.due = now

    def remove(self, qos: QoSProfile) -> None:
        """Undo :meth:`add`."""
        lease = _lease(qos)
        if lease is None:
            return
        self._writers[lease] -= 1
        if not self._writers[lease]:
            del self._writers[lease]
        if not self._writers:
            self.due = None

    def poll(self, now: float) -> None:
        """Write a message if one is due."""
        if self.due is not None and self.due <= now:
            self.due = now + max(_MIN_PERIOD, min(self._writers) / 1000 / _PER_LEASE)
            self._topic.writer.write(self._message, None, now)


def _lease(qos: QoSProfile) -> int | None:
    """The lease in ms within which the participant asserts liveliness; None: it does not."""
    is_manual = qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    return None if is_manual else qos.liveliness_lease_ms or None
