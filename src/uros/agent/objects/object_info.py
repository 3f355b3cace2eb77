"""Answers GET_INFO about a client's objects (XRCE 8.3.5.3 and 8.3.5.7).

The configuration is the representation that the object was created with. Datawriters and
datareaders have the activity of the specification. The configuration comes first, as in eProsima's
clients. The answer about the agent itself is :func:`~.wire.session.push_info`.
"""

from __future__ import annotations

from ...wire import ids
from ...wire import session as messages
from ...wire.cdr import Writer
from ...wire.header import header_size
from ..session.session import Session
from .endpoints import WriterEndpoint
from .object_table import XrceObject


def send_info(
    session: Session,
    obj: XrceObject | None,
    request_id: int,
    object_id: int,
    mask: int,
    stream: int,
    now: int,
) -> None:
    """Answer a GET_INFO; reliably if it came on a reliable stream.

    Args:
        session: The client's session.
        obj: The object; None if it does not exist, and for the client and the session.
        request_id: The request's.
        object_id: The id that the request names.
        mask: INFO_CONFIGURATION, INFO_ACTIVITY, or both.
        stream: The stream that the request came on.
        now: The time, in milliseconds modulo 2^30.
    """
    reliable = stream >= ids.STREAM_RELIABLE
    payload = _info(session, obj, request_id, object_id, mask, stream)
    if not reliable and header_size(session.session_id) + 4 + len(payload) > session.mtu:
        mask &= ~ids.INFO_CONFIGURATION  # more than one message can say
        payload = _info(session, obj, request_id, object_id, mask, stream)
    out = ids.STREAM_RELIABLE if reliable else ids.STREAM_NONE
    session.send(ids.INFO, ids.FLAG_LITTLE_ENDIAN, out, payload, now)


def _info(
    session: Session,
    obj: XrceObject | None,
    request_id: int,
    object_id: int,
    mask: int,
    stream: int,
) -> bytes:
    itself = object_id in (ids.OBJECT_CLIENT, ids.OBJECT_SESSION)
    size = 64
    if obj is not None and obj.representation is not None:
        content = obj.representation[1]
        size += len(content) if isinstance(content, bytes) else 4 * len(content)
    w = Writer(bytearray(size))
    exists = itself or obj is not None
    status = ids.STATUS_OK if exists else ids.STATUS_ERR_UNKNOWN_REFERENCE
    # 1: the session exists. If it is 0, clients create their session again.
    messages.push_status(w, request_id, object_id, status, 1)
    config = bool(mask & ids.INFO_CONFIGURATION)
    if itself and config:
        w.boolean(True)
        w.u8(ids.KIND_CLIENT)
        messages.push_create_client(w, session.key, session.session_id, session.mtu)
    elif obj is not None and obj.representation is not None and config:
        w.boolean(True)
        _variant(w, obj, *obj.representation)
    else:
        w.boolean(False)
    if obj is None or not mask & ids.INFO_ACTIVITY:
        w.boolean(False)
    elif isinstance(obj.endpoint, WriterEndpoint):
        w.boolean(True)
        w.u8(ids.KIND_DATAWRITER)
        w.u16(session.last_received(stream))
        count = obj.endpoint.written
        w.octets(bytes(-(w.offset - w.start) % 8))
        w.octets((count & (1 << 64) - 1).to_bytes(8, "little"))
    elif obj.kind == ids.KIND_DATAREADER and obj.endpoint is not None:
        w.boolean(True)
        w.u8(ids.KIND_DATAREADER)
        carrier = ids.STREAM_NONE if obj.delivery is None else obj.delivery.stream_id
        w.u16(session.last_acknowledged(carrier))
    else:
        w.boolean(False)
    return bytes(memoryview(w.buf)[: w.offset])


def _variant(w: Writer, obj: XrceObject, form: int, content: str | bytes, parent: int) -> None:
    """Write an ObjectVariant: the kind, then the content of CREATE."""
    w.u8(obj.kind)
    w.u8(form)
    if isinstance(content, bytes):
        w.sequence(content)
    else:
        w.string(content)
    if obj.kind == ids.KIND_PARTICIPANT:
        w.i16(parent)
    elif obj.kind < ids.KIND_TYPE:
        w.be16(parent)
