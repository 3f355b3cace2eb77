"""``ros_discovery_info`` as others write it: the nodes of their participants, within limits.

Anybody on the network may write there, and each sample is parsed in the data plane's thread. So a
sample counts only for the participant whose writer it came from; it has a limit of its own, and all
that is kept has one. What is taken is paid for in octets, from an allowance that grows by the
second. Where that is used up the reader is deleted, with all that waits in it, and made anew when
the debt is paid: each writer then offers its last sample again, as the topic is transient local.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ...qos import QoSProfile
from . import announce, builtin, config, cyclone
from .reader_listener import Watched

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_GUID_SIZE: Final = 16
_PREFIX: Final = 12
_PARTICIPANT: Final = b"\x00\x00\x01\xc1"  # the last octets of a participant's GUID

# Attack: samples of megabytes. A container with a hundred nodes writes 70 kB.
MAX_SAMPLE: Final = 128 * 1024
# Attack: thousands of nodes of no endpoints, each a node of the graph; or one node with thousands.
MAX_NODES: Final = 1000
MAX_ENDPOINTS: Final = 2000
# Attack: a name that fills the sample. ROS allows 255 characters.
MAX_TEXT: Final = 1024
# Attack: many participants, each with as much as it may say. Octets of samples, and their number.
MAX_KEPT: Final = 4 * 1024 * 1024
MAX_ANNOUNCED: Final = 4096
# Attack: samples faster than they are taken. Unread ones; of three hundred participants that start
# together all have room.
MAX_UNREAD: Final = 300
# Attack: samples without end. Octets that are parsed a second, at first, and in one turn: 16 kB of
# nodes take 5 ms of the thread that all boards share, and twice as many Gids one.
RATE: Final = 256 * 1024
BURST: Final = 2 * 1024 * 1024
TURN: Final = 16 * 1024
# What is not parsed costs so much less, and any sample so much at least.
_SKIPPED: Final = 16
_LEAST: Final = 256
# Deleting and making a reader takes a millisecond, and packets to all peers.
_PAUSE: Final = 1.0


def _mark(sample: bytes) -> tuple[int, int]:
    """What tells a sample from another one."""
    return len(sample), hash(sample)


def participant_of(guid: bytes) -> bytes:
    """The GUID of the participant that an endpoint is of."""
    return guid[:_PREFIX] + _PARTICIPANT


class Announced:
    """What others announce in one domain.

    ``nodes`` maps a participant's GUID to the nodes that it says it has, and ``gid_sizes`` to the
    bytes of a Gid in what it says. ``on_change`` is called after news. ``due`` is when
    :meth:`tick` has something to do. ``parsed`` counts octets.
    """

    def __init__(
        self,
        middleware: DdsMiddleware,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.nodes: dict[bytes, list[announce.NodeEntities]] = {}
        self.gid_sizes: dict[bytes, int] = {}
        self.due: float | None = None
        self.parsed = 0
        self._middleware = middleware
        self._participant = participant
        self._on_change = on_change
        self._kept: dict[bytes, tuple[int, int]] = {}  # by GUID: the mark of the sample
        self._size = 0  # octets of these samples
        self._credit = float(BURST)
        self._since = time.monotonic()
        self._reader: Watched | None = None
        self._qos = announce.qos()
        self._qos.depth = MAX_UNREAD  # the topic has no key: one must not displace another
        self._open()
        middleware.announced.append(self)

    def _about(self) -> tuple[str, str, QoSProfile]:
        return announce.TOPIC, announce.TYPE, self._qos

    def _open(self) -> None:
        entity = self._participant.create_reader(*self._about(), b"")
        self._reader = Watched(self._middleware, entity, self._on_ready)

    def _shut(self) -> None:
        if self._reader is not None:
            reader, self._reader = self._reader, None
            self._middleware.unwatch(reader)
            self._participant.delete_reader(reader.entity, *self._about())

    def ask_again(self) -> None:
        """Read all anew.

        A Fast DDS writer offers what it has when it meets a reader. Where the reader does not know
        the writer by then, the offer is lost and comes again with the next heartbeat, after up to
        three seconds; a new reader gets it at once.
        """
        if self.due is None:
            self._shut()
            self._open()

    def forget(self, guid: bytes) -> None:
        """The participant has left."""
        self.nodes.pop(guid, None)
        self.gid_sizes.pop(guid, None)
        self._size -= self._kept.pop(guid, (0, 0))[0]

    def _on_ready(self) -> None:
        reader = self._reader
        if reader is None:
            return
        reader.taken = True
        last: dict[bytes, bytes] = {}
        octets = 0
        while octets < TURN:
            taken = cyclone.take(reader.entity, 1)
            if not taken:
                break
            sample, info = taken[0]
            writer = builtin.matched_writer(reader.entity, info.publication_handle)
            cost = len(sample) // _SKIPPED
            guid = sample[4 : 4 + _GUID_SIZE]  # whose nodes it tells
            if writer is not None and guid == participant_of(writer[0]):
                last[guid] = sample
                if len(sample) <= MAX_SAMPLE and self._kept.get(guid) != _mark(sample):
                    cost = len(sample)
            octets += max(_LEAST, cost)
        else:
            self._middleware.again(reader)
        for guid, sample in last.items():
            self._announce(guid, sample)
        self._pay(octets)
        if last:
            self._on_change()

    def _announce(self, guid: bytes, sample: bytes) -> None:
        """Keep what a participant says."""
        size, mark = len(sample), _mark(sample)
        if self._kept.get(guid) == mark:
            return
        self.forget(guid)
        if (
            size > MAX_SAMPLE
            or self._size + size > MAX_KEPT
            or len(self._kept) >= MAX_ANNOUNCED
        ):
            self._middleware.notice(
                f"domain {self._participant.domain}: somebody says more in {announce.TOPIC} than"
                f" is kept ({size} bytes; {MAX_SAMPLE} at once, {MAX_KEPT} in all): its nodes are"
                " not known"
            )
            return
        self.parsed += size
        decoded = decode(sample)
        if decoded is not None:
            _, self.nodes[guid], self.gid_sizes[guid] = decoded
            self._kept[guid] = mark
            self._size += size

    def _pay(self, octets: int) -> None:
        now = time.monotonic()
        self._credit = min(BURST, self._credit + (now - self._since) * RATE) - octets
        self._since = now
        if self._credit < 0:
            self._shut()
            self.due = now + max(_PAUSE, -self._credit / RATE)

    def tick(self) -> None:
        """The debt is paid."""
        self.due = None
        self._open()

    def close(self) -> None:
        """Stop reading. Twice is once."""
        self.due = None
        self._shut()
        if self in self._middleware.announced:
            self._middleware.announced.remove(self)


def decode(sample: bytes) -> tuple[bytes, list[announce.NodeEntities], int] | None:
    """The participant's GUID, its nodes and the bytes of a Gid; None for what is no such message.

    Nothing in a sample tells whether its Gids have 16 bytes (from Iron on) or 24: the size with
    which the message ends where the sample ends, and strings are strings, is the right one.
    """
    if len(sample) < 4 or sample[0] != 0 or sample[1] > 1:
        return None
    for gid_size in (config.SHORT_GID, config.LONG_GID):
        try:
            return *_Decoder(sample, gid_size).message(), gid_size
        except (ValueError, struct.error):
            pass
    return None


class _Decoder:
    """CDR of one ``ParticipantEntitiesInfo``; ValueError or struct.error where it does not fit."""

    def __init__(self, sample: bytes, gid_size: int) -> None:
        self._data = memoryview(sample)[4:]
        self._count = struct.Struct("<I" if sample[1] else ">I")
        self._gid_size = gid_size
        self._offset = 0

    def message(self) -> tuple[bytes, list[announce.NodeEntities]]:
        guid = self._gid()
        nodes = [
            announce.NodeEntities(self._text(), self._text(), self._gids(), self._gids())
            for _ in range(self._number(MAX_NODES))
        ]
        rest = bytes(self._data[self._offset :])
        if len(rest) > 3 or any(rest):
            raise ValueError("octets are left")
        return guid, nodes

    def _number(self, most: int) -> int:
        self._offset += -self._offset % 4
        number: int = self._count.unpack_from(self._data, self._offset)[0]
        self._offset += 4
        if number > most:
            raise ValueError("more than is taken")
        return number

    def _bytes(self, size: int) -> bytes:
        start, self._offset = self._offset, self._offset + size
        if self._offset > len(self._data):
            raise ValueError("the sample ends early")
        return bytes(self._data[start : self._offset])

    def _text(self) -> str:
        raw = self._bytes(self._number(MAX_TEXT))
        if raw[-1:] != b"\0":
            raise ValueError("a string without its end")
        return raw[:-1].decode()

    def _gids(self) -> list[bytes]:
        return [self._gid() for _ in range(self._number(MAX_ENDPOINTS))]

    def _gid(self) -> bytes:
        raw = self._bytes(self._gid_size)
        if any(raw[_GUID_SIZE:]):
            raise ValueError("a padding that is none")
        return raw[:_GUID_SIZE]
