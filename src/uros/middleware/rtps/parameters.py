"""Parameter lists (RTPS 9.4.2.11): discovery data of participants and endpoints, inline QoS.

A list is read with the limits of this module, whatever its sample announces. An unknown parameter
is skipped; one that must be understood makes its list void (9.6.3.2).
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from ...qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from ..guid import participant_of
from . import ids, locators
from .locators import Locator
from .submessages import MalformedError

# Encapsulation headers of a parameter list (10.2.1.2).
PL_CDR_BE: Final = b"\x00\x02"
PL_CDR_LE: Final = b"\x00\x03"
# Attack: locators without end, each of which would get datagrams.
MAX_LOCATORS: Final = 16
# Attack: names that fill a sample. ROS allows 255 characters.
MAX_NAME: Final = 512
MAX_USER_DATA: Final = 8192
MAX_PARTITIONS: Final = 64
# Parameters of one list; each vendor sends about 30.
MAX_PARAMETERS: Final = 256
_INFINITE_SECONDS: Final = 0x7FFFFFFF

_DURABILITY: Final = {
    0: DurabilityPolicy.VOLATILE,
    1: DurabilityPolicy.TRANSIENT_LOCAL,
    2: DurabilityPolicy.TRANSIENT,
    3: DurabilityPolicy.PERSISTENT,
}
_DURABILITY_NUMBER: Final = {policy: number for number, policy in _DURABILITY.items()}
# Liveliness that is asserted by participant (1) is more than automatic, and ROS has no name for it.
_LIVELINESS: Final = {
    0: LivelinessPolicy.AUTOMATIC,
    1: LivelinessPolicy.AUTOMATIC,
    2: LivelinessPolicy.MANUAL_BY_TOPIC,
}


@dataclass
class ParticipantData:
    """SPDPdiscoveredParticipantData (8.5.3.2).

    Attributes:
        guid: Its GUID.
        domain: The domain that it says it is in; None where it says none.
        domain_tag: Its domain tag; participants of another tag are not for us.
        builtin: The builtin endpoints that it has, as bits.
        lease_ms: Milliseconds without a sign of life after which it is gone; None: never.
        metatraffic_unicast: Where discovery data goes to.
        metatraffic_multicast: The same, by multicast.
        default_unicast: Where data for endpoints without locators goes to.
        default_multicast: The same, by multicast.
        user_data: USER_DATA.
    """

    guid: bytes
    domain: int | None = None
    domain_tag: str = ""
    builtin: int = 0
    lease_ms: int | None = 100_000  # the default of table 9.18
    metatraffic_unicast: list[Locator] = field(default_factory=list)
    metatraffic_multicast: list[Locator] = field(default_factory=list)
    default_unicast: list[Locator] = field(default_factory=list)
    default_multicast: list[Locator] = field(default_factory=list)
    user_data: bytes = b""


@dataclass(eq=False)
class EndpointData:
    """DiscoveredWriterData or DiscoveredReaderData (8.5.4.4).

    Attributes:
        guid: Its GUID.
        is_writer: Whether it is a writer.
        topic: The DDS name of its topic.
        type_name: The DDS name of its type.
        qos: Its profile, with USER_DATA and partitions. Fast DDS announces no history: then its
            policy is SYSTEM_DEFAULT, and the depth 0.
        unicast: Its own locators; where it has none, those of its participant count.
        multicast: The same, by multicast.
        representations: Data representations that it offers or accepts.
    """

    guid: bytes
    is_writer: bool
    topic: str
    type_name: str
    qos: QoSProfile
    unicast: list[Locator] = field(default_factory=list)
    multicast: list[Locator] = field(default_factory=list)
    representations: tuple[int, ...] = (ids.XCDR1,)

    def is_of_same(self, other: EndpointData) -> bool:
        """Return whether both are writers, or readers, of one topic and type."""
        ours = self.is_writer, self.topic, self.type_name
        return ours == (other.is_writer, other.topic, other.type_name)

    @property
    def participant(self) -> bytes:
        """The GUID of its participant."""
        return participant_of(self.guid)


@dataclass
class InlineQos:
    """What a sample's inline QoS says.

    Attributes:
        key_hash: The key hash; empty without one.
        status: STATUS_INFO: disposed, unregistered.
        related: GUID and sequence number of the request that a reply answers; None without one.
    """

    key_hash: bytes = b""
    status: int = 0
    related: tuple[bytes, int] | None = None


# --- reading ----------------------------------------------------------------------------------

_LITTLE: Final = struct.Struct("<HH")
_BIG: Final = struct.Struct(">HH")


def parameters(raw: bytes | memoryview, little: bool) -> Iterator[tuple[int, bytes]]:
    """Yield number and value of each parameter up to the sentinel.

    The bit of parameters that must be understood is part of the number.

    Raises:
        MalformedError: A parameter is longer than the list, or there are too many.
    """
    form = _LITTLE if little else _BIG
    at = 0
    for _ in range(MAX_PARAMETERS):
        if at + 4 > len(raw):
            return  # some implementations leave the sentinel out
        pid, length = form.unpack_from(raw, at)
        at += 4
        if pid == ids.PID_SENTINEL:
            return
        if at + length > len(raw):
            raise MalformedError(f"parameter 0x{pid:04x} is longer than its list")
        if pid != ids.PID_PAD:
            yield pid, bytes(raw[at : at + length])
        at += length + -length % 4
    raise MalformedError(f"more than {MAX_PARAMETERS} parameters")


def encapsulated(payload: bytes | memoryview) -> tuple[bytes | memoryview, bool]:
    """Return the parameter list of a payload, and whether it is little endian.

    Raises:
        MalformedError: It is not a parameter list.
    """
    head = bytes(payload[:2])
    if len(payload) < 4 or head not in (PL_CDR_LE, PL_CDR_BE):
        raise MalformedError(f"encapsulation {head.hex()} is not a parameter list")
    return payload[4:], head == PL_CDR_LE


def _understood(pid: int) -> None:
    """Raise MalformedError for an unknown parameter that must be understood."""
    if pid & ids.PID_MUST_UNDERSTAND and not pid & ids.PID_VENDOR_SPECIFIC:
        raise MalformedError(f"parameter 0x{pid:04x} must be understood, and is not")


class _Value:
    """Reads the values of one byte order; MalformedError where they are too short."""

    def __init__(self, little: bool) -> None:
        self.little = little
        self._mark = "<" if little else ">"

    def unpack(self, form: str, raw: bytes, at: int = 0) -> tuple[int, ...]:
        try:
            return struct.unpack_from(self._mark + form, raw, at)
        except struct.error as error:
            raise MalformedError("a parameter is too short") from error

    def word(self, raw: bytes) -> int:
        return self.unpack("I", raw)[0]

    def octets(self, raw: bytes, most: int) -> bytes:
        size = self.word(raw)
        if size > most or 4 + size > len(raw):
            raise MalformedError(f"a sequence of {size} octets")
        return raw[4 : 4 + size]

    def text(self, raw: bytes) -> str:
        value = self.octets(raw, MAX_NAME)
        if value[-1:] != b"\0":
            raise MalformedError("a string without its terminator")
        try:
            return value[:-1].decode()
        except UnicodeDecodeError as error:
            raise MalformedError("a string that is not UTF-8") from error

    def texts(self, raw: bytes) -> tuple[str, ...]:
        count = self.word(raw)
        if count > MAX_PARTITIONS:
            raise MalformedError(f"{count} partitions")
        out, at = [], 4
        for _ in range(count):
            at += -at % 4
            out.append(self.text(raw[at:]))
            at += 4 + self.word(raw[at:])
        return tuple(out)

    def duration_ms(self, raw: bytes, at: int = 0) -> int | None:
        """Milliseconds, rounded up; None: infinite, in either of its two forms."""
        seconds, fraction = self.unpack("iI", raw, at)
        if seconds == _INFINITE_SECONDS or (seconds, fraction) == (-1, 0xFFFFFFFF):
            return None
        ns = (fraction * 10**9 + (1 << 31)) >> 32  # some round fractions up, and some down
        return seconds * 1000 + -(-ns // 10**6)

    def locator(self, raw: bytes) -> Locator | None:
        if len(raw) < locators.SIZE:
            raise MalformedError("a locator is too short")
        return locators.decode(raw, self.little)


def _guid(raw: bytes) -> bytes:
    if len(raw) < 16:
        raise MalformedError("a GUID is too short")
    return raw[:16]


def read_participant(payload: bytes | memoryview) -> ParticipantData:
    """Read the data of a participant.

    Raises:
        MalformedError: It is not valid, or has no GUID.
    """
    raw, little = encapsulated(payload)
    value = _Value(little)
    data = ParticipantData(b"")
    lists = {
        ids.PID_METATRAFFIC_UNICAST_LOCATOR: data.metatraffic_unicast,
        ids.PID_METATRAFFIC_MULTICAST_LOCATOR: data.metatraffic_multicast,
        ids.PID_DEFAULT_UNICAST_LOCATOR: data.default_unicast,
        ids.PID_DEFAULT_MULTICAST_LOCATOR: data.default_multicast,
    }
    for pid, body in parameters(raw, little):
        if pid in lists:
            locator = value.locator(body)
            if locator is not None and len(lists[pid]) < MAX_LOCATORS:
                lists[pid].append(locator)
        elif pid == ids.PID_PARTICIPANT_GUID:
            data.guid = _guid(body)
        elif pid == ids.PID_DOMAIN_ID:
            data.domain = value.word(body)
        elif pid == ids.PID_DOMAIN_TAG:
            data.domain_tag = value.text(body)
        elif pid == ids.PID_BUILTIN_ENDPOINT_SET:
            data.builtin = value.word(body)
        elif pid == ids.PID_PARTICIPANT_LEASE_DURATION:
            data.lease_ms = value.duration_ms(body)
        elif pid == ids.PID_USER_DATA:
            data.user_data = value.octets(body, MAX_USER_DATA)
        else:
            _understood(pid)
    if data.guid[ids.PREFIX_SIZE :] != ids.ENTITY_PARTICIPANT:
        raise MalformedError("a participant without its GUID")
    return data


def read_endpoint(payload: bytes | memoryview, is_writer: bool) -> EndpointData:
    """Read the data of a writer or reader.

    Args:
        payload: The sample of a builtin topic.
        is_writer: Whether it comes from the topic of publications.

    Raises:
        MalformedError: It is not valid, or lacks its GUID, topic or type.
    """
    raw, little = encapsulated(payload)
    value = _Value(little)
    qos = QoSProfile(history=HistoryPolicy.SYSTEM_DEFAULT, depth=0)
    if not is_writer:
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    data = EndpointData(b"", is_writer, "", "", qos)
    lists = {ids.PID_UNICAST_LOCATOR: data.unicast, ids.PID_MULTICAST_LOCATOR: data.multicast}
    for pid, body in parameters(raw, little):
        if pid in lists:
            locator = value.locator(body)
            if locator is not None and len(lists[pid]) < MAX_LOCATORS:
                lists[pid].append(locator)
        elif pid == ids.PID_ENDPOINT_GUID:
            data.guid = _guid(body)
        elif pid == ids.PID_KEY_HASH:
            data.guid = data.guid or _guid(body)  # older implementations send no endpoint GUID
        elif pid == ids.PID_TOPIC_NAME:
            data.topic = value.text(body)
        elif pid == ids.PID_TYPE_NAME:
            data.type_name = value.text(body)
        elif pid == ids.PID_DATA_REPRESENTATION:
            count = value.word(body)
            if count > 16:
                raise MalformedError(f"{count} data representations")
            if count:
                data.representations = value.unpack(f"{count}h", body, 4)
        else:
            _read_policy(qos, pid, body, value)
    if len(data.guid) != 16 or not data.topic or not data.type_name:
        raise MalformedError("an endpoint without its GUID, topic or type")
    return data


def _read_policy(qos: QoSProfile, pid: int, body: bytes, value: _Value) -> None:
    if pid == ids.PID_RELIABILITY:
        reliable = value.word(body) > 1
        qos.reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    elif pid == ids.PID_DURABILITY:
        qos.durability = _DURABILITY.get(value.word(body), DurabilityPolicy.VOLATILE)
    elif pid == ids.PID_HISTORY:
        kind, depth = value.unpack("Ii", body)
        qos.history = HistoryPolicy.KEEP_ALL if kind else HistoryPolicy.KEEP_LAST
        qos.depth = 0 if kind else max(0, depth)
    elif pid == ids.PID_DEADLINE:
        qos.deadline_ms = value.duration_ms(body)
    elif pid == ids.PID_LIFESPAN:
        qos.lifespan_ms = value.duration_ms(body)
    elif pid == ids.PID_LIVELINESS:
        qos.liveliness = _LIVELINESS.get(value.word(body), LivelinessPolicy.AUTOMATIC)
        qos.liveliness_lease_ms = value.duration_ms(body, 4)
    elif pid == ids.PID_OWNERSHIP:
        qos.ownership_exclusive = value.word(body) == 1
    elif pid == ids.PID_OWNERSHIP_STRENGTH:
        qos.ownership_strength = value.unpack("i", body)[0]
    elif pid == ids.PID_TIME_BASED_FILTER:
        qos.separation_ms = value.duration_ms(body)
    elif pid == ids.PID_PARTITION:
        qos.partitions = value.texts(body)
    elif pid == ids.PID_USER_DATA:
        qos.user_data = value.octets(body, MAX_USER_DATA)
    else:
        _understood(pid)


def read_inline_qos(raw: bytes, little: bool) -> InlineQos:
    """Read the inline QoS of a sample.

    Raises:
        MalformedError: It is not valid.
    """
    qos = InlineQos()
    for pid, body in parameters(raw, little):
        if pid == ids.PID_KEY_HASH:
            qos.key_hash = body[:16]
        elif pid == ids.PID_STATUS_INFO:
            qos.status = body[3] if len(body) > 3 else 0  # big endian, always
        elif pid in (ids.PID_RELATED_SAMPLE_IDENTITY, ids.PID_VENDOR_RELATED_SAMPLE_IDENTITY):
            if len(body) < 24:
                raise MalformedError("a sample identity is too short")
            high, low = struct.unpack_from("<iI" if little else ">iI", body, 16)
            qos.related = body[:16], (high << 32) + low
        else:
            _understood(pid)
    return qos


# --- writing, little endian ---------------------------------------------------------------------


def _parameter(pid: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack("<HH", pid, len(body)) + body


def _octets(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def _text(value: str) -> bytes:
    return _octets(value.encode() + b"\0")


def _texts(values: Iterable[str]) -> bytes:
    out = b""
    count = 0
    for value in values:
        out += bytes(-len(out) % 4) + _text(value)
        count += 1
    return struct.pack("<I", count) + out


def _duration(milliseconds: int | None) -> bytes:
    if milliseconds is None:
        return struct.pack("<iI", _INFINITE_SECONDS, 0xFFFFFFFF)
    seconds, ms = divmod(milliseconds, 1000)
    # Rounded up: Cyclone would read the last nanosecond less, and tools a millisecond less.
    return struct.pack("<iI", seconds, -((-ms << 32) // 1000))


def _history(qos: QoSProfile) -> bytes:
    if qos.history == HistoryPolicy.KEEP_ALL:
        return struct.pack("<Ii", 1, -1)  # without a limit
    return struct.pack("<Ii", 0, max(1, qos.depth))


_SENTINEL: Final = struct.pack("<HH", ids.PID_SENTINEL, 0)
_HEAD: Final = PL_CDR_LE + b"\0\0"


def write_participant(data: ParticipantData) -> bytes:
    """Return the payload that announces a participant."""
    out = [
        _HEAD,
        _parameter(ids.PID_PROTOCOL_VERSION, ids.VERSION + b"\0\0"),
        _parameter(ids.PID_VENDOR_ID, ids.VENDOR + b"\0\0"),
        _parameter(ids.PID_PARTICIPANT_GUID, data.guid),
        _parameter(ids.PID_BUILTIN_ENDPOINT_SET, struct.pack("<I", data.builtin)),
        _parameter(ids.PID_PARTICIPANT_LEASE_DURATION, _duration(data.lease_ms)),
    ]
    if data.domain is not None:
        out.append(_parameter(ids.PID_DOMAIN_ID, struct.pack("<I", data.domain)))
    if data.domain_tag:
        out.append(_parameter(ids.PID_DOMAIN_TAG, _text(data.domain_tag)))
    for pid, places in (
        (ids.PID_METATRAFFIC_UNICAST_LOCATOR, data.metatraffic_unicast),
        (ids.PID_METATRAFFIC_MULTICAST_LOCATOR, data.metatraffic_multicast),
        (ids.PID_DEFAULT_UNICAST_LOCATOR, data.default_unicast),
        (ids.PID_DEFAULT_MULTICAST_LOCATOR, data.default_multicast),
    ):
        out += [_parameter(pid, locators.encode(place)) for place in places]
    if data.user_data:
        out.append(_parameter(ids.PID_USER_DATA, _octets(data.user_data)))
    return b"".join([*out, _SENTINEL])


def write_endpoint(data: EndpointData) -> bytes:
    """Return the payload that announces a writer or reader."""
    qos = data.qos
    out = [
        _HEAD,
        _parameter(ids.PID_ENDPOINT_GUID, data.guid),
        _parameter(ids.PID_PARTICIPANT_GUID, data.participant),
        _parameter(ids.PID_TOPIC_NAME, _text(data.topic)),
        _parameter(ids.PID_TYPE_NAME, _text(data.type_name)),
        # The blocking time of Fast DDS's and Cyclone's default profile; it has no effect elsewhere.
        _parameter(ids.PID_RELIABILITY, struct.pack("<I", 1 + qos.reliable) + _duration(100)),
        _parameter(
            ids.PID_DURABILITY, struct.pack("<I", _DURABILITY_NUMBER.get(qos.durability, 0))
        ),
        _parameter(ids.PID_HISTORY, _history(qos)),
        _parameter(ids.PID_DEADLINE, _duration(qos.deadline_ms or None)),
        _parameter(
            ids.PID_LIVELINESS,
            struct.pack("<I", 2 if qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC else 0)
            + _duration(qos.liveliness_lease_ms or None),
        ),
        _parameter(ids.PID_OWNERSHIP, struct.pack("<I", qos.ownership_exclusive)),
        _parameter(
            ids.PID_DATA_REPRESENTATION,
            struct.pack(f"<I{len(data.representations)}h", len(data.representations),
                        *data.representations),
        ),
    ]  # fmt: skip
    if data.is_writer:
        out.append(_parameter(ids.PID_LIFESPAN, _duration(qos.lifespan_ms or None)))
        if qos.ownership_strength is not None:
            out.append(
                _parameter(ids.PID_OWNERSHIP_STRENGTH, struct.pack("<i", qos.ownership_strength))
            )
    elif qos.separation_ms:
        out.append(_parameter(ids.PID_TIME_BASED_FILTER, _duration(qos.separation_ms)))
    if qos.partitions:
        out.append(_parameter(ids.PID_PARTITION, _texts(qos.partitions)))
    if qos.user_data:
        out.append(_parameter(ids.PID_USER_DATA, _octets(qos.user_data)))
    for pid, places in (
        (ids.PID_UNICAST_LOCATOR, data.unicast), (ids.PID_MULTICAST_LOCATOR, data.multicast)
    ):  # fmt: skip
        out += [_parameter(pid, locators.encode(place)) for place in places]
    return b"".join([*out, _SENTINEL])


def write_key(guid: bytes) -> bytes:
    """Return the payload that is the key of a participant or endpoint, for a farewell."""
    pid = (
        ids.PID_PARTICIPANT_GUID
        if guid[ids.PREFIX_SIZE :] == ids.ENTITY_PARTICIPANT
        else ids.PID_ENDPOINT_GUID
    )
    return _HEAD + _parameter(pid, guid) + _SENTINEL


def read_key(payload: bytes | memoryview) -> bytes:
    """Return the GUID in the key of a participant or endpoint.

    Raises:
        MalformedError: There is none.
    """
    raw, little = encapsulated(payload)
    for pid, body in parameters(raw, little):
        if pid in (ids.PID_PARTICIPANT_GUID, ids.PID_ENDPOINT_GUID, ids.PID_KEY_HASH):
            return _guid(body)
    raise MalformedError("a key without a GUID")


def write_farewell_qos(guid: bytes) -> bytes:
    """Return the inline QoS of DATA that disposes and unregisters a participant or endpoint."""
    status = bytes(3) + bytes([ids.STATUS_DISPOSED | ids.STATUS_UNREGISTERED])
    return _parameter(ids.PID_KEY_HASH, guid) + _parameter(ids.PID_STATUS_INFO, status) + _SENTINEL


@functools.lru_cache(maxsize=64)  # that of a client's requests is always the same
def write_related_identity(guid: bytes, number: int) -> bytes:
    """Return inline QoS with a request's identity, under the numbers of OMG and of eProsima."""
    body = guid + struct.pack("<iI", number >> 32, number & 0xFFFFFFFF)
    return (
        _parameter(ids.PID_RELATED_SAMPLE_IDENTITY, body)
        + _parameter(ids.PID_VENDOR_RELATED_SAMPLE_IDENTITY, body)
        + _SENTINEL
    )
