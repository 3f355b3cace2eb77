"""Numbers of DDSI-RTPS 2.5: submessages, parameters, entities, builtin endpoints, vendors."""

from __future__ import annotations

from typing import Final

from .. import guid

# --- messages (9.4.4, 9.4.5) ----------------------------------------------------------------

PROTOCOL: Final = b"RTPS"
VERSION: Final = b"\x02\x03"
VENDOR: Final = guid.UROS

PAD: Final = 0x01
ACKNACK: Final = 0x06
HEARTBEAT: Final = 0x07
GAP: Final = 0x08
INFO_TS: Final = 0x09
INFO_SRC: Final = 0x0C
INFO_REPLY_IP4: Final = 0x0D
INFO_DST: Final = 0x0E
INFO_REPLY: Final = 0x0F
NACK_FRAG: Final = 0x12
HEARTBEAT_FRAG: Final = 0x13
DATA: Final = 0x15
DATA_FRAG: Final = 0x16

# --- entities (9.3.1.2, 9.3.1.3) ---------------------------------------------------------------

PREFIX_SIZE: Final = guid.PREFIX_SIZE
NO_PREFIX: Final = bytes(PREFIX_SIZE)
ENTITY_UNKNOWN: Final = bytes(4)
ENTITY_PARTICIPANT: Final = guid.PARTICIPANT_ENTITY_ID
SPDP_WRITER: Final = b"\x00\x01\x00\xc2"
SPDP_READER: Final = b"\x00\x01\x00\xc7"
PUBLICATIONS_WRITER: Final = b"\x00\x00\x03\xc2"
PUBLICATIONS_READER: Final = b"\x00\x00\x03\xc7"
SUBSCRIPTIONS_WRITER: Final = b"\x00\x00\x04\xc2"
SUBSCRIPTIONS_READER: Final = b"\x00\x00\x04\xc7"
PARTICIPANT_MESSAGE_WRITER: Final = b"\x00\x02\x00\xc2"
PARTICIPANT_MESSAGE_READER: Final = b"\x00\x02\x00\xc7"
# The last octet of an entity id: user-defined, without a key.
KIND_WRITER_NO_KEY: Final = 0x03
KIND_READER_NO_KEY: Final = 0x04

# Bits of PID_BUILTIN_ENDPOINT_SET (9.3.2.12, table 9.4).
BIT_PARTICIPANT_ANNOUNCER: Final = 1 << 0
BIT_PARTICIPANT_DETECTOR: Final = 1 << 1
BIT_PUBLICATIONS_ANNOUNCER: Final = 1 << 2
BIT_PUBLICATIONS_DETECTOR: Final = 1 << 3
BIT_SUBSCRIPTIONS_ANNOUNCER: Final = 1 << 4
BIT_SUBSCRIPTIONS_DETECTOR: Final = 1 << 5
BIT_PARTICIPANT_MESSAGE_WRITER: Final = 1 << 10
BIT_PARTICIPANT_MESSAGE_READER: Final = 1 << 11

# A kind of ParticipantMessageData (9.6.3.1), four octets in any byte order.
AUTOMATIC_LIVELINESS_UPDATE: Final = b"\x00\x00\x00\x01"

# --- parameters (9.6.3, table 9.18) --------------------------------------------------------

PID_PAD: Final = 0x0000
PID_SENTINEL: Final = 0x0001
PID_PARTICIPANT_LEASE_DURATION: Final = 0x0002
PID_TIME_BASED_FILTER: Final = 0x0004
PID_TOPIC_NAME: Final = 0x0005
PID_OWNERSHIP_STRENGTH: Final = 0x0006
PID_TYPE_NAME: Final = 0x0007
PID_DOMAIN_ID: Final = 0x000F
PID_DOMAIN_TAG: Final = 0x4014
PID_PROTOCOL_VERSION: Final = 0x0015
PID_VENDOR_ID: Final = 0x0016
PID_RELIABILITY: Final = 0x001A
PID_LIVELINESS: Final = 0x001B
PID_DURABILITY: Final = 0x001D
PID_OWNERSHIP: Final = 0x001F
PID_DEADLINE: Final = 0x0023
PID_PARTITION: Final = 0x0029
PID_LIFESPAN: Final = 0x002B
PID_USER_DATA: Final = 0x002C
PID_UNICAST_LOCATOR: Final = 0x002F
PID_MULTICAST_LOCATOR: Final = 0x0030
PID_DEFAULT_UNICAST_LOCATOR: Final = 0x0031
PID_METATRAFFIC_UNICAST_LOCATOR: Final = 0x0032
PID_METATRAFFIC_MULTICAST_LOCATOR: Final = 0x0033
PID_HISTORY: Final = 0x0040
PID_DEFAULT_MULTICAST_LOCATOR: Final = 0x0048
PID_PARTICIPANT_GUID: Final = 0x0050
PID_BUILTIN_ENDPOINT_SET: Final = 0x0058
PID_ENDPOINT_GUID: Final = 0x005A
PID_KEY_HASH: Final = 0x0070
PID_STATUS_INFO: Final = 0x0071
PID_DATA_REPRESENTATION: Final = 0x0073
PID_RELATED_SAMPLE_IDENTITY: Final = 0x0083
# eProsima's number of the same, the only one that Fast DDS 2.6 and 2.9 know.
PID_VENDOR_RELATED_SAMPLE_IDENTITY: Final = 0x800F
# A parameter with this bit is for its vendor's participants.
PID_VENDOR_SPECIFIC: Final = 0x8000
# One with this bit must not be skipped by a receiver that does not know it.
PID_MUST_UNDERSTAND: Final = 0x4000

# PID_STATUS_INFO (9.6.4.9).
STATUS_DISPOSED: Final = 1
STATUS_UNREGISTERED: Final = 2

# Data representations (XTypes 7.6.3.1.1).
XCDR1: Final = 0
XCDR2: Final = 2
REPRESENTATION_NAMES: Final = {XCDR1: "XCDR1", 1: "XML", XCDR2: "XCDR2"}
