"""The kinds of objects, the kind of each one's parent, and ids as text."""

from __future__ import annotations

from typing import Final

from ...wire import ids

KIND_NAMES: Final = {
    ids.KIND_PARTICIPANT: "participant",
    ids.KIND_TOPIC: "topic",
    ids.KIND_PUBLISHER: "publisher",
    ids.KIND_SUBSCRIBER: "subscriber",
    ids.KIND_DATAWRITER: "datawriter",
    ids.KIND_DATAREADER: "datareader",
    ids.KIND_REQUESTER: "requester",
    ids.KIND_REPLIER: "replier",
    ids.KIND_TYPE: "type",
    ids.KIND_QOS_PROFILE: "qos_profile",
    ids.KIND_APPLICATION: "application",
}
# The kind of an object's parent; a CREATE of the other kinds names none.
PARENTS: Final = {
    ids.KIND_TOPIC: ids.KIND_PARTICIPANT,
    ids.KIND_PUBLISHER: ids.KIND_PARTICIPANT,
    ids.KIND_SUBSCRIBER: ids.KIND_PARTICIPANT,
    ids.KIND_DATAWRITER: ids.KIND_PUBLISHER,
    ids.KIND_DATAREADER: ids.KIND_SUBSCRIBER,
    ids.KIND_REQUESTER: ids.KIND_PARTICIPANT,
    ids.KIND_REPLIER: ids.KIND_PARTICIPANT,
}
# Kinds that have a node of the middleware.
WITH_NODE: Final = (
    ids.KIND_PARTICIPANT,
    ids.KIND_DATAWRITER,
    ids.KIND_DATAREADER,
    ids.KIND_REQUESTER,
    ids.KIND_REPLIER,
)


def parent_id(kind: int, parent: int) -> int:
    """Return the id of an object's parent, with the right kind in its low bits; 0: none."""
    within = PARENTS.get(kind)
    return 0 if within is None else (parent & 0xFFF0) | within


def object_label(object_id: int) -> str:
    """Return an id as the C++ agent's log has it: number and kind, ``0x000(5)``."""
    return f"0x{object_id >> 4:03X}({object_id & 15})"


def key_label(key: int) -> str:
    """Return a client key as uros always writes it, and as ``--allow-key`` takes it."""
    return f"0x{key:08X}"
