"""What a writer knows of a matched reader."""

from __future__ import annotations

from typing import Final

# Seconds between heartbeats while a reader has not acknowledged everything, at first.
HEARTBEAT_FIRST: Final = 0.05
# A reader that has matched here may not know the writer yet, and one of Cyclone begins after the
# first heartbeat: samples wait for its first acknowledgement, or for so many seconds.
_MAX_WAIT: Final = 1.0


class ReaderProxy:
    """What a writer knows of one matched reader.

    Attributes:
        guid: The reader's GUID.
        reliable: Whether it acknowledges.
        first: The first number that is for it.
        acked: All numbers up to this one are acknowledged.
        last_at_match: The last number that the writer had written when they matched.
        heard_at: When it acknowledged last, or matched.
        is_stalled: Whether a full history is not kept for it, as it does not acknowledge.
        behind_since: When its acknowledgements began to be behind earlier ones; None: they are not.
        wants_header: Whether it expects the identity of a request in the payload.
        waits_until: When samples are sent although it has acknowledged nothing; None after its
            first acknowledgement.
    """

    __slots__ = (
        "acked", "acknack_counter", "behind_since", "first", "fragments", "guid", "heard_at",
        "heartbeat_at", "heartbeat_pause", "holes", "is_stalled", "last_at_match",
        "nack_frag_counter", "reliable", "requested", "resend_at", "waits_until", "wants_header",
    )  # fmt: skip

    def __init__(
        self, guid: bytes, reliable: bool, first: int, last: int, wants_header: bool, now: float
    ) -> None:
        self.guid = guid
        self.reliable = reliable
        self.first = first
        self.acked = first - 1
        self.last_at_match = last
        self.heard_at = now
        self.is_stalled = False
        self.behind_since: float | None = None
        self.acknack_counter: int | None = None
        self.nack_frag_counter: int | None = None
        self.requested: set[int] = set()  # numbers to send again
        self.fragments: dict[int, set[int]] = {}  # fragments to send again, by number
        self.holes: list[tuple[int, int]] = []  # runs of numbers that it is told not to wait for
        self.resend_at: float | None = None
        self.heartbeat_at: float | None = None
        self.heartbeat_pause = HEARTBEAT_FIRST
        self.wants_header = wants_header
        self.waits_until = now + _MAX_WAIT if reliable else None
