"""Formats one XRCE message of either direction as a line of text.

::

    0x81 reliable 5: CREATE #10 datawriter 0x001(5) in publisher 0x001(3) on topic 0x001(2) ...

Any bytes are accepted: nothing is raised, bytes that cannot be decoded are shown in hex after
``??`` and the reason, and the length of a line is limited. Names from outside are escaped, because
they could control a terminal. Entities are parsed as the agent parses them, by
:mod:`uros.agent.objects.representation`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from ...printable import printable_ascii
from ...qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from ...wire import ids
from ...wire import session as messages
from ...wire.cdr import Reader
from ...wire.data import SAMPLE_IDENTITY_SIZE, pull_read_data, pull_sample_identity
from ...wire.entities import pull_create
from ...wire.errors import DecodeError
from ...wire.header import header_size, pull_subheader
from ..objects import xml_profiles
from ..objects.kinds import KIND_NAMES, PARENTS, key_label, object_label
from ..objects.representation import (
    ApplicationSpec,
    EndpointSpec,
    GroupSpec,
    ParticipantSpec,
    QosProfileSpec,
    ServiceSpec,
    Spec,
    TopicSpec,
    TypeSpec,
    UnknownReference,
    parse,
)

# Limits of one line: submessages, characters, characters of a name, elements of a list, and bytes
# of payload. A message may have 16,000 submessages, names of 64 kB and long lists.
MAX_SUBMESSAGES: Final = 16
MAX_LINE: Final = 2000
_MAX_TEXT: Final = 100
_MAX_LISTED: Final = 8
_MAX_BYTES: Final = 16
# XML up to this size is parsed; of a longer one only the beginning is shown.
_MAX_XML: Final = 8192

PERFORMANCE: Final = 16  # eProsima's, for measuring; agents drop it

KINDS: Final = {
    ids.CREATE_CLIENT: "CREATE_CLIENT",
    ids.CREATE: "CREATE",
    ids.GET_INFO: "GET_INFO",
    ids.DELETE: "DELETE",
    ids.STATUS_AGENT: "STATUS_AGENT",
    ids.STATUS: "STATUS",
    ids.INFO: "INFO",
    ids.WRITE_DATA: "WRITE_DATA",
    ids.READ_DATA: "READ_DATA",
    ids.DATA: "DATA",
    ids.ACKNACK: "ACKNACK",
    ids.HEARTBEAT: "HEARTBEAT",
    ids.RESET: "RESET",
    ids.FRAGMENT: "FRAGMENT",
    ids.TIMESTAMP: "TIMESTAMP",
    ids.TIMESTAMP_REPLY: "TIMESTAMP_REPLY",
    PERFORMANCE: "PERFORMANCE",
}
_NAMED: Final = {
    ids.OBJECT_AGENT: "agent",
    ids.OBJECT_CLIENT: "client",
    ids.OBJECT_SESSION: "session",
}
_FORMATS: Final = {
    ids.FORMAT_DATA: "",
    ids.FORMAT_SAMPLE: "sample",
    ids.FORMAT_DATA_SEQ: "data sequence",
    ids.FORMAT_SAMPLE_SEQ: "sample sequence",
    ids.FORMAT_PACKED_SAMPLES: "packed samples",
}


class ParsedSubmessage(NamedTuple):
    """One submessage: the name of its kind, and its content as text."""

    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.kind} {self.text}".rstrip()


class ParsedMessage(NamedTuple):
    """A parsed message.

    Attributes:
        session: Session id; None if the header is incomplete.
        stream: Stream id.
        number: Sequence number; None if the header has none.
        key: Client key; None if the header has none.
        parts: The submessages up to the first that cannot be decoded.
        error: Why the rest cannot be decoded, with its bytes; "" if everything was decoded.
    """

    session: int | None
    stream: int | None
    number: int | None
    key: int | None
    parts: list[ParsedSubmessage]
    error: str

    def __str__(self) -> str:
        texts = [str(part) for part in self.parts]
        if self.error:
            texts.append(self.error)
        text = f"{_head(self)} {'; '.join(texts)}".strip()
        return text if len(text) <= MAX_LINE else f"{text[: MAX_LINE - 3]}..."


def format_message(message: bytes) -> str:
    """Format a message as one line of at most ``MAX_LINE`` printable ASCII characters."""
    return str(parse_message(message))


def parse_message(message: bytes) -> ParsedMessage:
    """Parse a message as far as it can be decoded; raises nothing."""
    size = len(message)
    if size < 4 or size < header_size(message[0]):
        about = f"?? {_count(size, 'byte')}, too few for a header: {_octets(message)}"
        return ParsedMessage(None, None, None, None, [], about.rstrip(": "))
    session_id, stream = message[0], message[1]
    number = int.from_bytes(message[2:4], "little")
    at = header_size(session_id)
    key = int.from_bytes(message[4:8], "big") if at == 8 else None
    parts: list[ParsedSubmessage] = []
    error = ""
    if at == size:
        error = "?? no submessage"
    while at + 4 <= size and not error:
        if len(parts) >= MAX_SUBMESSAGES:
            error = f"... and {size - at} bytes more"
            break
        try:
            kind, flags, start, stop = pull_subheader(message, at, size)
        except DecodeError as cause:
            kind = message[at]
            name = KINDS.get(kind, f"submessage {kind}")
            error = f"?? {name}: {cause}: {_octets(message[at:])}"
            break
        parts.append(_part(kind, flags, message[start:stop]))
        at = stop + (-stop & 3)
    if not error and any(message[at:]):  # C clients fill up with zeros
        error = f"?? {_count(size - at, 'byte')} left over: {_octets(message[at:])}"
    return ParsedMessage(session_id, stream, number, key, parts, error)


def stream_name(stream: int) -> str:
    """Return ``reliable`` or ``best effort``, with the id if it is not the usual one."""
    if stream == ids.STREAM_NONE:
        return "none"
    kind, usual = ("reliable", ids.STREAM_RELIABLE)
    if stream < ids.STREAM_RELIABLE:
        kind, usual = ("best effort", ids.STREAM_BEST_EFFORT)
    return kind if stream == usual else f"{kind} (0x{stream:02X})"


def object_name(object_id: int) -> str:
    """Return an object id as the log shows it; agent, client and session by their names."""
    return _NAMED.get(object_id) or object_label(object_id)


def _head(message: ParsedMessage) -> str:
    if message.session is None or message.stream is None:
        return ""
    text = f"0x{message.session:02X}"
    if message.key is not None:
        text += f" key {key_label(message.key)}"
    if message.stream or message.number:
        text += f" {stream_name(message.stream)} {message.number}"
    return f"{text}:"


# --- submessages --------------------------------------------------------------------


def _part(kind: int, flags: int, payload: bytes) -> ParsedSubmessage:
    name = KINDS.get(kind)
    if name is None:
        about = f"of {_count(len(payload), 'byte')}: {_octets(payload)}"
        return ParsedSubmessage(f"submessage {kind}", about.rstrip(": "))
    r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
    texts: list[str] = []
    try:
        for text in _TEXTS[kind](r, flags):
            texts.append(text)
    except DecodeError as error:
        texts.append(f"?? {error}: {_octets(payload)}")
    else:
        if r.remaining():
            texts.append(f"?? {_count(r.remaining(), 'byte')} more: {_octets(payload[r.offset :])}")
    if not r.little and kind not in (ids.RESET, ids.FRAGMENT):
        texts.append("[big endian]")
    return ParsedSubmessage(name, " ".join(text for text in texts if text))


def _create_client(r: Reader, flags: int) -> Iterator[str]:
    cookie, version, vendor, key, session_id, properties, mtu = messages.pull_create_client(r)
    yield f"key {key_label(key)} session 0x{session_id:02X} mtu {mtu}"
    if cookie != ids.COOKIE:
        yield f"?? cookie {_octets(cookie)}"
    yield f"XRCE {version[0]}.{version[1]} vendor {vendor.hex().upper()}"
    if properties:
        yield f"[{_listed(f'{escape(name)}={escape(value)}' for name, value in properties)}]"


def _create(r: Reader, flags: int) -> Iterator[str]:
    request, object_id, kind, form, content, parent = pull_create(r)
    name = KIND_NAMES.get(kind, f"kind {kind}")
    yield f"#{request} {name} {object_name(object_id)}"
    within = PARENTS.get(kind)
    if within is not None:
        yield f"in {KIND_NAMES[within]} {object_name(parent)}"
    elif kind == ids.KIND_PARTICIPANT:
        yield f"in domain {parent}"
    yield from _representation(kind, form, content, parent, r.little)
    bits = ((ids.FLAG_REUSE, "reuse"), (ids.FLAG_REPLACE, "replace"))
    modes = [name for bit, name in bits if flags & bit]
    if modes:
        yield f"[{' '.join(modes)}]"


def _representation(
    kind: int, form: int, content: str | bytes, parent: int, little: bool
) -> Iterator[str]:
    if form == ids.BY_REFERENCE:
        yield f"by reference {_quoted(str(content))}"
        return
    try:
        if len(content) > _MAX_XML:
            raise DecodeError(f"{len(content)} characters")
        spec = parse(kind, form, content, parent, little, _NOTHING)
    except (DecodeError, xml_profiles.ProfileError, UnknownReference) as error:
        about = _octets(content) if isinstance(content, bytes) else _quoted(content)
        yield f"{_form(form)} ?? {escape(str(error))}: {about}"
        return
    yield from _spec(spec)
    if form == ids.AS_XML:
        yield "(XML)"


def _form(form: int) -> str:
    return "binary" if form == ids.IN_BINARY else "XML"


class _Nothing:
    """References lead to other messages and files, which are not known here."""

    def find(self, tag: str, name: str) -> xml_profiles.Profile | None:
        return None


_NOTHING: Final = _Nothing()


def _spec(spec: Spec) -> Iterator[str]:
    if isinstance(spec, ParticipantSpec):
        yield "without a name" if spec.name is None else _quoted(spec.name)
        yield "on this machine only" if spec.localhost_only else ""
    elif isinstance(spec, TopicSpec):
        yield f"{escape(spec.name)} of type {escape(spec.type_name)}"
    elif isinstance(spec, GroupSpec):
        if spec.partitions:
            yield f"partitions {_listed(map(_quoted, spec.partitions))}"
    elif isinstance(spec, EndpointSpec):
        if spec.topic is not None:
            yield f"on {escape(spec.topic.name)}"
        elif spec.topic_id is not None:
            yield f"on topic {object_name(spec.topic_id)}"
        yield _qos(spec.qos)
    elif isinstance(spec, ServiceSpec):
        topics = escape(spec.request_topic), escape(spec.reply_topic)
        yield f"{topics[0]} of type {escape(spec.request_type)}, {topics[1]} of type"
        yield escape(spec.reply_type)
    elif isinstance(spec, TypeSpec):
        yield _listed(map(escape, sorted(spec.names)))
    elif isinstance(spec, QosProfileSpec):
        yield _listed(map(escape, spec.named))
    elif isinstance(spec, ApplicationSpec):
        kinds = [KIND_NAMES.get(item.kind, "?") for item in spec.items]
        yield f"of {_listed(f'{kinds.count(kind)} {kind}' for kind in dict.fromkeys(kinds))}"


_DURABILITIES: Final = {
    DurabilityPolicy.TRANSIENT_LOCAL: "transient_local",
    DurabilityPolicy.TRANSIENT: "transient",
    DurabilityPolicy.PERSISTENT: "persistent",
}


def _qos(qos: QoSProfile) -> str:
    """Format reliability and history, and the other policies that are not the default."""
    best_effort = qos.reliability == ReliabilityPolicy.BEST_EFFORT
    words = ["best_effort" if best_effort else "reliable", _DURABILITIES.get(qos.durability, "")]
    words.append("keep_all" if qos.history == HistoryPolicy.KEEP_ALL else f"keep_last {qos.depth}")
    for name, milliseconds in (
        ("deadline", qos.deadline_ms), ("lifespan", qos.lifespan_ms),
        ("separation", qos.separation_ms), ("lease", qos.liveliness_lease_ms),
    ):  # fmt: skip
        words.append("" if milliseconds is None else f"{name} {milliseconds} ms")
    if qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC:
        words.append("manual_by_topic")
    if qos.ownership_strength is not None:
        words.append(f"ownership_strength {qos.ownership_strength}")
    elif qos.ownership_exclusive:
        words.append("ownership exclusive")
    if qos.partitions:
        words.append(f"partitions {_listed(map(_quoted, qos.partitions))}")
    if qos.user_data:
        words.append(f"user_data {_octets(qos.user_data)}")
    return " ".join(word for word in words if word)


def _request(r: Reader) -> str:
    request, object_id = messages.pull_request(r)
    return f"#{request} {object_name(object_id)}"


def _delete(r: Reader, flags: int) -> Iterator[str]:
    yield _request(r)


def _get_info(r: Reader, flags: int) -> Iterator[str]:
    request, object_id, mask = messages.pull_get_info(r)
    bits = ((ids.INFO_CONFIGURATION, "configuration"), (ids.INFO_ACTIVITY, "activity"))
    names = [name for bit, name in bits if mask & bit]
    rest = mask & ~(ids.INFO_CONFIGURATION | ids.INFO_ACTIVITY)
    if rest:
        names.append(f"0x{rest:X}")
    yield f"#{request} {object_name(object_id)} {' and '.join(names) or 'nothing'}"


def _status_agent(r: Reader, flags: int) -> Iterator[str]:
    yield _status_value(*messages.pull_status_agent(r))


def _status(r: Reader, flags: int) -> Iterator[str]:
    request, object_id, status, implementation = messages.pull_status(r)
    yield f"#{request} {object_name(object_id)} {_status_value(status, implementation)}"


def _status_value(status: int, implementation: int) -> str:
    return ids.status_name(status) + (f"/{implementation}" if implementation else "")


def _info(r: Reader, flags: int) -> Iterator[str]:
    request, object_id = messages.pull_request(r)
    r.offset = r.start
    if object_id == ids.OBJECT_AGENT:
        _, _, status, info_mask, locators = messages.pull_info(r)
        yield f"#{request} {object_name(object_id)} {ids.status_name(status)}"
        yield "session known" if info_mask else "no session"
        if locators:
            yield f"at {_listed(_locator(*locator) for locator in locators)}"
        return
    yield from _status(r, flags)
    if r.remaining():
        yield _bytes(r)


def _locator(address: bytes, port: int) -> str:
    import ipaddress

    host = ipaddress.ip_address(address)
    return f"{host}:{port}" if host.version == 4 else f"[{host}]:{port}"


def _data(r: Reader, flags: int, answers: bool = True) -> Iterator[str]:
    request, object_id = messages.pull_request(r)
    yield f"#{request} {object_name(object_id)}"
    form = flags & ids.FORMAT_MASK
    if form:
        yield f"as {_FORMATS.get(form, f'format {form:#x}')}"
    if object_id & 0x0F == ids.KIND_REPLIER and not form and r.remaining() >= SAMPLE_IDENTITY_SIZE:
        guid, number = pull_sample_identity(r.buf, r.offset, r.end, r.little)
        r.offset += SAMPLE_IDENTITY_SIZE
        yield f"call {number} of {guid.hex()},"
    elif object_id & 0x0F == ids.KIND_REQUESTER and answers and not form and r.remaining() >= 4:
        yield f"answer to {_request(r)},"
    yield _bytes(r)


def _write_data(r: Reader, flags: int) -> Iterator[str]:
    yield from _data(r, flags, False)


def _read_data(r: Reader, flags: int) -> Iterator[str]:
    request, object_id, stream, form, content_filter, control = pull_read_data(r)
    yield f"#{request} {object_name(object_id)} on {stream_name(stream)}"
    if form & ids.FORMAT_MASK:
        yield f"as {_FORMATS.get(form & ids.FORMAT_MASK, f'format {form:#x}')}"
    if content_filter is not None:
        yield f"filter {_quoted(content_filter)}"
    if control is None:
        yield "one sample"
        return
    most, seconds, rate, pace = control
    if most == 0:
        yield "stop"
        return
    yield "all samples" if most == ids.MAX_SAMPLES_UNLIMITED else f"{most} samples"
    yield f"for {seconds} s" if seconds else ""
    yield f"at most {rate} bytes/s" if rate else ""
    yield f"{pace} ms apart" if pace else ""


def _acknack(r: Reader, flags: int) -> Iterator[str]:
    first, missing, stream = messages.pull_acknack(r)
    numbers = [str((first + i) & 0xFFFF) for i in range(16) if missing >> i & 1]
    yield f"{stream_name(stream)}: all before {first} arrived"
    if numbers:
        yield f"but not {', '.join(numbers)}"


def _heartbeat(r: Reader, flags: int) -> Iterator[str]:
    first, last, stream = messages.pull_heartbeat(r)
    if (last + 1 - first) & 0xFFFF:
        yield f"{stream_name(stream)}: {first} to {last} are to be acknowledged"
    else:
        yield f"{stream_name(stream)}: nothing before {first} is to be acknowledged"


def _reset(r: Reader, flags: int) -> Iterator[str]:
    yield ""


def _fragment(r: Reader, flags: int) -> Iterator[str]:
    yield "last," if flags & ids.FLAG_LAST_FRAGMENT else ""
    yield _bytes(r)


def _timestamp(r: Reader, flags: int) -> Iterator[str]:
    yield _time(*messages.pull_timestamp(r))


def _timestamp_reply(r: Reader, flags: int) -> Iterator[str]:
    transmit, receive, originate = messages.pull_timestamp_reply(r)
    yield f"to {_time(*originate)}: received {_time(*receive)}, sent {_time(*transmit)}"


def _performance(r: Reader, flags: int) -> Iterator[str]:
    yield _bytes(r)


_TEXTS: Final[dict[int, Callable[[Reader, int], Iterator[str]]]] = {
    ids.CREATE_CLIENT: _create_client,
    ids.CREATE: _create,
    ids.GET_INFO: _get_info,
    ids.DELETE: _delete,
    ids.STATUS_AGENT: _status_agent,
    ids.STATUS: _status,
    ids.INFO: _info,
    ids.WRITE_DATA: _write_data,
    ids.READ_DATA: _read_data,
    ids.DATA: _data,
    ids.ACKNACK: _acknack,
    ids.HEARTBEAT: _heartbeat,
    ids.RESET: _reset,
    ids.FRAGMENT: _fragment,
    ids.TIMESTAMP: _timestamp,
    ids.TIMESTAMP_REPLY: _timestamp_reply,
    PERFORMANCE: _performance,
}


# --- values -------------------------------------------------------------------------


def _time(seconds: int, nanoseconds: int) -> str:
    if nanoseconds >= 1_000_000_000:
        return f"{seconds} s and {nanoseconds} ns"
    return f"{seconds}.{nanoseconds:09d} s"


def _octets(data: bytes) -> str:
    text = data[:_MAX_BYTES].hex(" ").upper()
    return f"{text} ..." if len(data) > _MAX_BYTES else text


def _bytes(r: Reader) -> str:
    """Format the remaining bytes: their number, and the first of them."""
    rest = r.octets(r.remaining())
    return _count(len(rest), "byte") + (f": {_octets(rest)}" if rest else "")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def escape(text: str) -> str:
    """Escape a name from outside and cut it to its limit."""
    if len(text) > _MAX_TEXT:
        return f"{escape(text[:_MAX_TEXT])}... ({len(text)} characters)"
    return printable_ascii(text) or "''"


def _quoted(text: str) -> str:
    words = " ".join(text[: 2 * _MAX_TEXT].split())
    cut = len(words) > _MAX_TEXT or len(text) > 2 * _MAX_TEXT
    return ascii(words[:_MAX_TEXT]) + ("..." if cut else "")


def _listed(texts: Iterator[str] | map[str]) -> str:
    entries = list(texts)
    more = len(entries) - _MAX_LISTED
    return ", ".join(entries[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
