"""GUIDs of DDS entities (RTPS 9.3.1): a 12-octet prefix of the participant, a 4-octet entity id."""

from __future__ import annotations

from typing import Final

GUID_SIZE: Final = 16
PREFIX_SIZE: Final = 12
PARTICIPANT_ENTITY_ID: Final = b"\x00\x00\x01\xc1"

# The low six bits of a GUID's last octet tell a writer's kind (table 9.1): with a key, without one.
_WRITER_KINDS: Final = (0x02, 0x03)

# The first two octets of a GUID are the vendor id of the DDS implementation.
FAST_DDS: Final = b"\x01\x0f"
CYCLONE_DDS: Final = b"\x01\x10"
# Of the form of those, and of nobody in OMG's list of vendors.
UROS: Final = b"\x01\x75"


def participant_of(guid: bytes) -> bytes:
    """Return the GUID of the participant that an endpoint belongs to."""
    return guid[:PREFIX_SIZE] + PARTICIPANT_ENTITY_ID


def is_writer(guid: bytes) -> bool:
    """Return whether a GUID is one of a writer; else it is one of a reader or participant."""
    return guid[-1] & 0x3F in _WRITER_KINDS
