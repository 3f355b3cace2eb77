"""The message on ``ros_discovery_info``: ``rmw_dds_common/msg/ParticipantEntitiesInfo`` in CDR.

One message describes one participant and is sent whole at every change: the participant's Gid, and
for every node its namespace, its name and the Gids of its readers and writers. A Gid is the
16-octet GUID, up to Humble padded to 24 octets; :mod:`~uros.middleware.discovery_info.gid_size`
decides which.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from ...qos import DurabilityPolicy, QoSProfile
from ..guid import GUID_SIZE

TOPIC: Final = "ros_discovery_info"
TYPE: Final = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"

# Octets of a Gid: 24 up to Humble, 16 from Iron on.
SHORT_GID: Final = 16
LONG_GID: Final = 24

# The most nodes of a message and endpoints of a node, because a message may list any number of
# nodes, each one of the graph, or one with thousands of endpoints. An agent announces a node for
# each of up to 4096 clients.
MAX_NODES: Final = 4096
MAX_ENDPOINTS: Final = 2000
# The longest name in octets, because a name may fill the sample. ROS allows 255 characters.
MAX_TEXT: Final = 1024


def qos() -> QoSProfile:
    """Return the profile of the topic's writers: reliable, transient local, keep last 1."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(eq=False)
class NodeEntities:
    """A node and the GUIDs of its endpoints, in order of creation."""

    namespace: str
    name: str
    readers: list[bytes] = field(default_factory=list)
    writers: list[bytes] = field(default_factory=list)


def encode(guid: bytes, nodes: Iterable[NodeEntities], gid_size: int) -> bytes:
    """Return the message as CDR with its encapsulation header.

    Args:
        guid: The GUID of the participant.
        nodes: The participant's nodes.
        gid_size: Octets of each Gid, :data:`SHORT_GID` or :data:`LONG_GID`.
    """
    pad = bytes(gid_size - GUID_SIZE)
    out = bytearray(b"\x00\x01\x00\x00")

    def count(value: int) -> None:
        out.extend(bytes(-len(out) % 4))
        out.extend(struct.pack("<I", value))

    def string(text: str) -> None:
        raw = text.encode() + b"\0"
        count(len(raw))
        out.extend(raw)

    out += guid + pad
    nodes = list(nodes)
    count(len(nodes))
    for node in nodes:
        string(node.namespace)
        string(node.name)
        for gids in (node.readers, node.writers):
            count(len(gids))
            for gid in gids:
                out += gid + pad
    return bytes(out)


def subject_of(sample: bytes) -> bytes:
    """Return the GUID of the participant that a sample describes, without decoding the rest."""
    return sample[4 : 4 + GUID_SIZE]


def decode(sample: bytes) -> tuple[bytes, list[NodeEntities], int] | None:
    """Decode a sample within the limits of this module.

    Nothing in a sample tells whether its Gids have 16 or 24 octets. The right size is the one with
    which the message ends at the end of the sample and all its strings are valid.

    Returns:
        The participant's GUID, its nodes and the octets of a Gid; None for any other bytes.
    """
    if len(sample) < 4 or sample[0] != 0 or sample[1] > 1:
        return None
    for gid_size in (SHORT_GID, LONG_GID):
        try:
            return *_Decoder(sample, gid_size).message(), gid_size
        except (ValueError, struct.error):
            pass
    return None


class _Decoder:
    """Decodes a ``ParticipantEntitiesInfo``; raises ValueError or struct.error for other bytes."""

    def __init__(self, sample: bytes, gid_size: int) -> None:
        self._data = memoryview(sample)[4:]
        self._count = struct.Struct("<I" if sample[1] else ">I")
        self._gid_size = gid_size
        self._offset = 0

    def message(self) -> tuple[bytes, list[NodeEntities]]:
        guid = self._gid()
        nodes = [
            NodeEntities(self._text(), self._text(), self._gids(), self._gids())
            for _ in range(self._number(MAX_NODES))
        ]
        rest = bytes(self._data[self._offset :])
        if len(rest) > 3 or any(rest):
            raise ValueError("octets are left after the message")
        return guid, nodes

    def _number(self, most: int) -> int:
        self._offset += -self._offset % 4
        number: int = self._count.unpack_from(self._data, self._offset)[0]
        self._offset += 4
        if number > most:
            raise ValueError("a sequence beyond its limit")
        return number

    def _bytes(self, size: int) -> bytes:
        start, self._offset = self._offset, self._offset + size
        if self._offset > len(self._data):
            raise ValueError("the sample ends early")
        return bytes(self._data[start : self._offset])

    def _text(self) -> str:
        raw = self._bytes(self._number(MAX_TEXT))
        if raw[-1:] != b"\0":
            raise ValueError("a string without its terminator")
        return raw[:-1].decode()

    def _gids(self) -> list[bytes]:
        return [self._gid() for _ in range(self._number(MAX_ENDPOINTS))]

    def _gid(self) -> bytes:
        raw = self._bytes(self._gid_size)
        if any(raw[GUID_SIZE:]):
            raise ValueError("padding that is not zero")
        return raw[:GUID_SIZE]
