"""Numbers that the DDS-XRCE specification assigns (formal/20-02-01, annex A)."""

try:
    from typing import Final
except ImportError:  # MicroPython
    pass

COOKIE: Final = b"XRCE"
VERSION_MAJOR: Final = 1
VERSION_MINOR: Final = 0
VENDOR_EPROSIMA: Final = b"\x01\x0f"

# Session ids: from 0x80 on, the message header carries no client key (8.3.2).
SESSION_NONE_WITH_KEY: Final = 0x00
SESSION_NONE_WITHOUT_KEY: Final = 0x80

# Stream ids (8.3.2.3): 0 none, 1..127 best effort, 128..255 reliable.
STREAM_NONE: Final = 0x00
STREAM_BEST_EFFORT: Final = 0x01
STREAM_RELIABLE: Final = 0x80

# Submessages (8.3.5, table 8).
CREATE_CLIENT: Final = 0
CREATE: Final = 1
GET_INFO: Final = 2
DELETE: Final = 3
STATUS_AGENT: Final = 4
STATUS: Final = 5
INFO: Final = 6
WRITE_DATA: Final = 7
READ_DATA: Final = 8
DATA: Final = 9
ACKNACK: Final = 10
HEARTBEAT: Final = 11
RESET: Final = 12
FRAGMENT: Final = 13
TIMESTAMP: Final = 14
TIMESTAMP_REPLY: Final = 15

# Submessage flags (8.3.4.2).
FLAG_LITTLE_ENDIAN: Final = 0x01
FLAG_REUSE: Final = 0x02  # CREATE
FLAG_REPLACE: Final = 0x04  # CREATE
FLAG_LAST_FRAGMENT: Final = 0x02  # FRAGMENT

# Data formats, in the flags of WRITE_DATA and DATA (8.3.5.8).
FORMAT_DATA: Final = 0x00
FORMAT_SAMPLE: Final = 0x02
FORMAT_DATA_SEQ: Final = 0x08
FORMAT_SAMPLE_SEQ: Final = 0x0A
FORMAT_PACKED_SAMPLES: Final = 0x0E
FORMAT_MASK: Final = 0x0E

# Object kinds: the low four bits of an object id (7.7.3).
KIND_INVALID: Final = 0x00
KIND_PARTICIPANT: Final = 0x01
KIND_TOPIC: Final = 0x02
KIND_PUBLISHER: Final = 0x03
KIND_SUBSCRIBER: Final = 0x04
KIND_DATAWRITER: Final = 0x05
KIND_DATAREADER: Final = 0x06
KIND_REQUESTER: Final = 0x07
KIND_REPLIER: Final = 0x08
KIND_TYPE: Final = 0x0A
KIND_QOS_PROFILE: Final = 0x0B
KIND_APPLICATION: Final = 0x0C
KIND_AGENT: Final = 0x0D
KIND_CLIENT: Final = 0x0E
KIND_OTHER: Final = 0x0F

# Object ids with a meaning of their own (7.7.2).
OBJECT_INVALID: Final = 0x0000
OBJECT_AGENT: Final = 0xFFFD
OBJECT_CLIENT: Final = 0xFFFE
OBJECT_SESSION: Final = 0xFFFF

# Status values (7.7.6).
STATUS_OK: Final = 0x00
STATUS_OK_MATCHED: Final = 0x01
STATUS_ERR_DDS_ERROR: Final = 0x80
STATUS_ERR_MISMATCH: Final = 0x81
STATUS_ERR_ALREADY_EXISTS: Final = 0x82
STATUS_ERR_DENIED: Final = 0x83
STATUS_ERR_UNKNOWN_REFERENCE: Final = 0x84
STATUS_ERR_INVALID_DATA: Final = 0x85
STATUS_ERR_INCOMPATIBLE: Final = 0x86
STATUS_ERR_RESOURCES: Final = 0x87

# Representation formats (7.7.9).
BY_REFERENCE: Final = 0x01
AS_XML: Final = 0x02
IN_BINARY: Final = 0x03

# GET_INFO masks (7.7.13).
INFO_CONFIGURATION: Final = 0x01
INFO_ACTIVITY: Final = 0x02

# Endpoint QoS flags of the binary representation (7.7.9.5).
QOS_RELIABLE: Final = 0x01
QOS_KEEP_LAST: Final = 0x02
QOS_OWNERSHIP_EXCLUSIVE: Final = 0x04
QOS_TRANSIENT_LOCAL: Final = 0x08
QOS_TRANSIENT: Final = 0x10
QOS_PERSISTENT: Final = 0x20

# READ_DATA delivery control (7.7.11).
MAX_SAMPLES_UNLIMITED: Final = 0xFFFF


# Whether `status_name` returns names. A build for a board sets it to False, to get numbers instead.
NAMES_STATUS: Final = True
# Names from STATUS_ERR_DDS_ERROR on, in one text, which takes less of a board's heap than eight.
_ERRORS: Final = (
    "DDS_ERROR MISMATCH ALREADY_EXISTS DENIED UNKNOWN_REFERENCE INVALID_DATA INCOMPATIBLE RESOURCES"
)


def status_name(status: int) -> str:
    """Return the specification's name of a status value, or its number in hex."""
    if NAMES_STATUS:
        if status == STATUS_OK:
            return "OK"
        if status == STATUS_OK_MATCHED:
            return "OK_MATCHED"
        errors = _ERRORS.split()
        index = status - STATUS_ERR_DDS_ERROR
        if 0 <= index < len(errors):
            return "ERR_" + errors[index]
    return "0x%02X" % status
