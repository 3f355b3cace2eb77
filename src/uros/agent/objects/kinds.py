"""Kinds of a client's objects, what each is made in, and how ids are written."""

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
# In what an object is made; a CREATE of the other kinds names no parent.
PARENTS: Final = {
    ids.KIND_TOPIC: ids.KIND_PARTICIPANT,
    ids.KIND_PUBLISHER: ids.KIND_PARTICIPANT,
    ids.KIND_SUBSCRIBER: ids.KIND_PARTICIPANT,
    ids.KIND_DATAWRITER: ids.KIND_PUBLISHER,
    ids.KIND_DATAREADER: ids.KIND_SUBSCRIBER,
    ids.KIND_REQUESTER: ids.KIND_PARTICIPANT,
    ids.KIND_REPLIER: ids.KIND_PARTICIPANT,
}
# Kinds that stand on a participant of the middleware, or are one.
WITH_NODE: Final = (
    ids.KIND_PARTICIPANT,
    ids.KIND_DATAWRITER,
    ids.KIND_DATAREADER,
    ids.KIND_REQUESTER,
    ids.KIND_REPLIER,
)


def parent_id(kind: int, parent: int) -> int:
    """The object id of an object's parent, whichever kind the client wrote into it; 0: none."""
    within = PARENTS.get(kind)
    return 0 if within is None else (parent & 0xFFF0) | within


def object_label(object_id: int) -> str:
    """As in the C++ agent's log: number and kind, ``0x000(5)``."""
    return f"0x{object_id >> 4:03X}({object_id & 15})"


def key_label(key: int) -> str:
    """A client's key as everything of ours writes it, and as ``--allow-key`` takes it."""
    return f"0x{key:08X}"
