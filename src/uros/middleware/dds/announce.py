"""``ros_discovery_info``: telling the ROS graph which endpoint is whose.

One ``rmw_dds_common/msg/ParticipantEntitiesInfo`` a participant, whole at every
change: the participant's Gid, then for every node its namespace, name, and the
Gids of its readers and writers. A Gid is the 16-byte GUID, up to Humble padded
to 24 bytes; :mod:`uros.middleware.dds.gids` decides which.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

from ...qos import DurabilityPolicy, QoSProfile

TOPIC = "ros_discovery_info"
TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
# A participant's USER_DATA. By its enclave it is one of ROS; by "uros" other agents and hosts of
# ours know that its Gids are as long as those of others, and prove nothing.
MARK = b"uros=1;"
USER_DATA = b"enclave=/;" + MARK


def qos() -> QoSProfile:
    """Reliable, transient local, the last one: late nodes get the whole picture."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(eq=False)
class NodeEntities:
    """A node and the GUIDs of its endpoints, in order of creation."""

    namespace: str
    name: str
    readers: list[bytes] = field(default_factory=list)
    writers: list[bytes] = field(default_factory=list)


def encode(guid: bytes, nodes: Iterable[NodeEntities], gid_size: int) -> bytes:
    """The message as CDR with its encapsulation header."""
    pad = bytes(gid_size - 16)
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
