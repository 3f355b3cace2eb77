"""Keys in the USER_DATA QoS of participants and endpoints: ``key=value;``, one after the other."""

from __future__ import annotations

from typing import Final

# Every participant of ROS 2 announces the enclave it is in.
ENCLAVE: Final = b"enclave="
# Participants of uros; tells agents and host programs that the Gid size in this participant's
# discovery info follows that of others and is no evidence of its own.
UROS: Final = b"uros=1;"
PARTICIPANT: Final = b"enclave=/;" + UROS
# Further for those that announce no nodes, as another participant lists their endpoints; tools need
# not wait for their discovery info.
WITHOUT_NODES: Final = b"uros_nodes=0;"
# Temporary readers without a node; see uros.middleware.dds.late_writer_heartbeat.
PROBE_READER: Final = b"uros_offer=1;"


def type_hash(type_name: str) -> bytes:
    """Return ``typehash=RIHS01_…;`` for a DDS type name, or nothing for a type uros lacks."""
    from ..interfaces.typehash import known_hash  # here, because it loads the table of hashes

    package, _, rest = type_name.partition("::")
    kind, _, name = rest.partition("::dds_::")
    if not name.endswith("_"):
        return b""
    digest = known_hash(f"{package}/{kind}/{name[:-1]}")
    return f"typehash={digest};".encode() if digest else b""
