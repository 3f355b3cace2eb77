"""CREATE and the representations of entities (XRCE 7.7.9 and 8.3.5.2).

An entity is described in one of three formats: by reference to a profile the
agent knows, by an XML document, or in binary. On the wire CREATE is::

    request id, object id, kind, format, string or octets, parent id or domain

``push_create`` / ``pull_create`` carry that envelope; ``push_binary_x`` /
``pull_binary_x`` the content of the binary format, which has an alignment of
its own.
"""

from . import ids
from .cdr import Reader, Writer
from .errors import DecodeError, EncodeError, LimitError

try:
    from typing import Final
except ImportError:  # MicroPython
    pass

# Most partitions of a publisher or subscriber. The limit prevents this attack: a list without end.
MAX_PARTITIONS: Final = 64


def push_create(
    w: Writer,
    request_id: int,
    object_id: int,
    form: int,
    content: "str | bytes",
    parent: int,
) -> None:
    """Write a CREATE payload; the kind is the low four bits of ``object_id``.

    ``content`` is text for BY_REFERENCE and AS_XML, octets for IN_BINARY.
    ``parent`` is the object id of the parent, for a participant its domain;
    types, QoS profiles and applications have none.
    """
    w.be16(request_id)
    w.be16(object_id)
    kind = object_id & 0x0F
    w.u8(kind)
    w.u8(form)
    if isinstance(content, str) != (form != ids.IN_BINARY):
        raise EncodeError("format %d does not carry this content" % form)
    if isinstance(content, str):
        w.string(content)
    else:
        w.sequence(content)
    if kind == ids.KIND_PARTICIPANT:
        w.i16(parent)
    elif kind < ids.KIND_TYPE:
        w.be16(parent)


def pull_create(r: Reader) -> "tuple[int, int, int, int, str | bytes, int]":
    """Read ``(request id, object id, kind, format, content, parent)``.

    The kind is that of the payload's kind octet and not of the object id, as in the
    C++ agent; the object id that is returned has it in its low four bits.
    """
    request_id, object_id = r.be16(), r.be16()
    kind = r.u8()
    form = r.u8()
    content: "str | bytes"
    if form == ids.IN_BINARY:
        content = r.sequence()
    elif form in (ids.BY_REFERENCE, ids.AS_XML):
        content = r.string()
    else:
        raise DecodeError("representation format %d does not exist" % form)
    parent = 0
    if kind == ids.KIND_PARTICIPANT:
        parent = r.i16()
    elif kind < ids.KIND_TYPE:
        parent = r.be16()
    return request_id, (object_id & 0xFFF0) | (kind & 0x0F), kind, form, content, parent


def _push_optional(w: Writer, value: "str | None") -> None:
    w.boolean(value is not None)
    if value is not None:
        w.string(value)


def _pull_optional(r: Reader) -> "str | None":
    return r.string() if r.boolean() else None


def push_binary_participant(w: Writer, name: "str | None", domain_reference: "str | None") -> None:
    """Write a participant.

    ``name`` is sent as the QoS profile: there micro-ROS has the node's name, ``namespace/name``.
    """
    _push_optional(w, domain_reference)
    _push_optional(w, name)


def pull_binary_participant(r: Reader) -> "tuple[str | None, str | None]":
    """Read ``(name, domain reference)``."""
    domain_reference = _pull_optional(r)
    return _pull_optional(r), domain_reference


def push_binary_topic(w: Writer, name: str, type_name: "str | None") -> None:
    """Write a topic; names are mangled: ``rt/chatter``, ``std_msgs::msg::dds_::String_``."""
    w.string(name)
    w.boolean(False)  # type reference
    _push_optional(w, type_name)


def pull_binary_topic(r: Reader) -> "tuple[str, str | None]":
    """Read ``(topic name, type name)``."""
    name = r.string()
    _pull_optional(r)
    return name, _pull_optional(r)


def push_binary_group(w: Writer, name: "str | None", partitions: "list[str] | None") -> None:
    """Write a publisher or a subscriber, whose formats are the same."""
    _push_optional(w, name)
    w.boolean(partitions is not None)
    if partitions is not None:
        w.boolean(True)
        w.u32(len(partitions))
        for partition in partitions:
            w.string(partition)
        w.boolean(False)  # group data


def pull_binary_group(r: Reader) -> "tuple[str | None, list[str]]":
    """Read ``(name, partitions)`` of a publisher or a subscriber."""
    name = _pull_optional(r)
    partitions = []
    if r.boolean():
        if r.boolean():
            count = r.u32()
            if count > MAX_PARTITIONS:
                raise LimitError("%d partitions are over the limit of %d" % (count, MAX_PARTITIONS))
            for _ in range(count):
                partitions.append(r.string())
        if r.boolean():
            r.sequence()
    return name, partitions


def push_binary_endpoint(
    w: Writer,
    topic_id: int,
    flags: int,
    depth: "int | None" = None,
    deadline_ms: "int | None" = None,
    lifespan_ms: "int | None" = None,
    user_data: "bytes | None" = None,
    reader: bool = False,
) -> None:
    """Write a datawriter or a datareader with its QoS (``QOS_…`` flags)."""
    w.be16(topic_id)
    w.boolean(True)
    w.u16(flags)
    w.boolean(depth is not None)
    if depth is not None:
        w.u16(depth)
    for milliseconds in (deadline_ms, lifespan_ms):
        w.boolean(milliseconds is not None)
        if milliseconds is not None:
            w.u32(milliseconds)
    w.boolean(user_data is not None)
    if user_data is not None:
        w.sequence(user_data)
    w.boolean(False)  # ownership strength, or time-based filter
    if reader:
        w.boolean(False)  # content-based filter


def pull_binary_endpoint(
    r: Reader, reader: bool
) -> "tuple[int, tuple[int, int | None, int | None, int | None, bytes | None, int | None, str | None] | None]":  # noqa: E501
    """Read ``(topic id, qos)`` of a datawriter or a datareader.

    ``qos`` is None if the client left it out, else ``(flags, depth, deadline ms,
    lifespan ms, user data, extra, filter)``: ``extra`` is a writer's ownership
    strength or a reader's minimum separation in ms, ``filter`` a reader's
    content filter expression.
    """
    topic_id = r.be16()
    if not r.boolean():
        return topic_id, None
    flags = r.u16()
    depth = r.u16() if r.boolean() else None
    deadline = r.u32() if r.boolean() else None
    lifespan = r.u32() if r.boolean() else None
    user_data = r.sequence() if r.boolean() else None
    # 32 bits as the C++ agent reads it. The C client's sources have 64, but never send it.
    extra = r.u32() if r.boolean() else None
    content_filter = _pull_optional(r) if reader else None
    return topic_id, (flags, depth, deadline, lifespan, user_data, extra, content_filter)


def push_binary_service(
    w: Writer,
    name: str,
    request_type: str,
    reply_type: str,
    request_topic: "str | None" = None,
    reply_topic: "str | None" = None,
) -> None:
    """Write a requester or a replier, whose formats are the same."""
    w.string(name)
    w.string(request_type)
    w.string(reply_type)
    _push_optional(w, request_topic)
    _push_optional(w, reply_topic)


def pull_binary_service(r: Reader) -> "tuple[str, str, str, str | None, str | None]":
    """Read ``(service name, request type, reply type, request topic, reply topic)``."""
    return r.string(), r.string(), r.string(), _pull_optional(r), _pull_optional(r)
