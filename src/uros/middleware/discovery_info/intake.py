"""What is kept of other participants' discovery info, and how many octets are parsed a second.

Anybody on the network may write to ``ros_discovery_info``, and each sample is parsed in the data
plane's thread. So a sample counts only for the participant whose writer sent it, samples have a
size limit, and so has all that is kept. Octets are charged against a token bucket. Once that is
empty, :class:`Turn` says for how long the reader is to be deleted, with every sample
that waits in it. If it were kept, its history would grow; if it had a small history, it would lose
other writers' samples. A new reader gets the last sample of each writer again, because the topic is
transient local.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from ...token_bucket import TokenBucket
from ..guid import participant_of
from .codec import TOPIC, NodeEntities, decode, subject_of

# The largest sample in octets. A container with a hundred nodes writes 70 kB, an agent with 4096
# boards of five endpoints each 450 kB.
MAX_SAMPLE: Final = 512 * 1024
# The most octets of all samples that are kept, and the most participants, because many participants
# may each send as much as they may.
MAX_KEPT: Final = 4 * 1024 * 1024
MAX_PARTICIPANTS: Final = 4096
# The depth of the reader, because samples may arrive faster than they are taken. It holds one
# sample of each of three hundred participants that start together.
MAX_UNREAD: Final = 300
# The most octets that are parsed in a second, at once after a quiet time, and in one call of
# ``on_ready``. Samples may arrive without end: 16 kB of nodes take 5 ms of the thread that all
# boards share, and twice as many octets of Gids take 1 ms.
RATE: Final = 256 * 1024
BURST: Final = 2 * 1024 * 1024
TURN: Final = 16 * 1024
# A sample that is not parsed is charged this fraction of its octets, any sample at least so many.
_SKIPPED: Final = 16
_LEAST: Final = 256
# The shortest time for which the reader is deleted, in seconds: deleting and creating one takes a
# millisecond, and sends packets to all peers.
_PAUSE: Final = 1.0


class Turn(NamedTuple):
    """What one call of :meth:`Intake.read` did.

    Attributes:
        is_changed: Whether the nodes may have changed.
        has_more: Whether samples may be left for another turn.
        pause: The seconds for which the reader is to be deleted; None while there are tokens.
    """

    is_changed: bool
    has_more: bool
    pause: float | None


def _fingerprint(sample: bytes) -> tuple[int, int]:
    """Return a value that distinguishes a sample from others."""
    return len(sample), hash(sample)


class Intake:
    """Discovery info of the participants in one domain.

    Attributes:
        nodes: The nodes of each participant, by the participant's GUID.
        gid_sizes: Octets of a Gid in the participant's message, by its GUID.
        parsed: Octets parsed so far.

    Args:
        domain: The domain, for notices.
        notice: Called with a line for the user.
    """

    def __init__(self, domain: int, notice: Callable[[str], None]) -> None:
        self.nodes: dict[bytes, list[NodeEntities]] = {}
        self.gid_sizes: dict[bytes, int] = {}
        self.parsed = 0
        self._domain = domain
        self._notice = notice
        self._kept: dict[bytes, tuple[int, int]] = {}  # fingerprint of the sample, by GUID
        self._size = 0  # octets of these samples
        self._tokens = TokenBucket(BURST, RATE)

    def read(self, take: Callable[[], tuple[bytes | None, bytes] | None], now: float) -> Turn:
        """Read samples until there are no more, or as many octets as a turn may parse.

        Args:
            take: Takes a sample from the reader, with the GUID of the writer that sent it (None if
                that has left already); None if there is no sample.
            now: Seconds of a monotonic clock.
        """
        latest: dict[bytes, bytes] = {}  # sample by participant
        octets = 0
        has_more = True
        while octets < TURN:
            taken = take()
            if taken is None:
                has_more = False
                break
            writer, sample = taken
            counts, cost = self._cost(writer, sample)
            if counts:
                latest[subject_of(sample)] = sample
            octets += cost
        for sample in latest.values():
            self._accept(sample)
        return Turn(bool(latest), has_more, self._charge(octets, now))

    def _cost(self, writer: bytes | None, sample: bytes) -> tuple[bool, int]:
        """Return whether a sample counts, and the octets it is charged.

        Args:
            writer: GUID of the writer that sent it; None if that has left already.
            sample: The sample.
        """
        cost = len(sample) // _SKIPPED
        guid = subject_of(sample)
        counts = writer is not None and guid == participant_of(writer)
        if counts and len(sample) <= MAX_SAMPLE and self._kept.get(guid) != _fingerprint(sample):
            cost = len(sample)
        return counts, max(_LEAST, cost)

    def _accept(self, sample: bytes) -> None:
        """Parse a sample that counts, and keep its nodes if the limits allow."""
        guid, size, fingerprint = subject_of(sample), len(sample), _fingerprint(sample)
        if self._kept.get(guid) == fingerprint:
            return
        self.forget(guid)
        if size > MAX_SAMPLE or self._size + size > MAX_KEPT or len(self._kept) >= MAX_PARTICIPANTS:
            self._notice(
                f"domain {self._domain}: a participant writes more to {TOPIC} than is kept"
                f" ({size} bytes; {MAX_SAMPLE} a sample, {MAX_KEPT} in all): its nodes are not"
                " known"
            )
            return
        self.parsed += size
        decoded = decode(sample)
        if decoded is not None:
            _, self.nodes[guid], self.gid_sizes[guid] = decoded
            self._kept[guid] = fingerprint
            self._size += size

    def forget(self, guid: bytes) -> None:
        """Drop the discovery info of a participant, which has left."""
        self.nodes.pop(guid, None)
        self.gid_sizes.pop(guid, None)
        self._size -= self._kept.pop(guid, (0, 0))[0]

    def _charge(self, octets: int, now: float) -> float | None:
        """Take octets from the token bucket.

        Args:
            octets: As :meth:`_cost` returned them.
            now: Seconds of a monotonic clock.

        Returns:
            The seconds for which the reader is to be deleted; None while there are tokens.
        """
        self._tokens.available(now)
        self._tokens.spend(octets)
        available = self._tokens.available(now)
        return max(_PAUSE, -available / RATE) if available < 0 else None
