"""The answer to GET_INFO about a client's objects (XRCE 8.3.5.3 and 8.3.5.7).

The configuration is what the object was created with; of activity, data writers and
readers have the numbers that the specification gives them. In the order of eProsima's
clients: configuration first. What the agent says of itself is :func:`~.wire.session.push_info`.
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
    thing: XrceObject | None,
    request_id: int,
    object_id: int,
    mask: int,
    stream: int,
    now: int,
) -> None:
    """Answer a GET_INFO that came on ``stream``: reliably where it came so.

    ``thing`` is None for what does not exist and for the client and the session.
    """
    reliable = stream >= ids.STREAM_RELIABLE
    payload = _info(session, thing, request_id, object_id, mask, stream)
    if not reliable and header_size(session.session_id) + 4 + len(payload) > session.mtu:
        mask &= ~ids.INFO_CONFIGURATION  # more than one message can say
        payload = _info(session, thing, request_id, object_id, mask, stream)
    out = ids.STREAM_RELIABLE if reliable else ids.STREAM_NONE
    session.send(ids.INFO, ids.FLAG_LITTLE_ENDIAN, out, payload, now)


def _info(
    session: Session,
    thing: XrceObject | None,
    request_id: int,
    object_id: int,
    mask: int,
    stream: int,
) -> bytes:
    itself = object_id in (ids.OBJECT_CLIENT, ids.OBJECT_SESSION)
    size = 64
    if thing is not None and thing.representation is not None:
        content = thing.representation[1]
        size += len(content) if isinstance(content, bytes) else 4 * len(content)
    w = Writer(bytearray(size))
    known = itself or thing is not None
    status = ids.STATUS_OK if known else ids.STATUS_ERR_UNKNOWN_REFERENCE
    # 1: the asker's session is known, by which clients tell whether to start anew.
    messages.push_status(w, request_id, object_id, status, 1)
    config = bool(mask & ids.INFO_CONFIGURATION)
    if itself and config:
        w.boolean(True)
        w.u8(ids.KIND_CLIENT)
        messages.push_create_client(w, session.key, session.session_id, session.mtu)
    elif thing is not None and thing.representation is not None and config:
        w.boolean(True)
        _variant(w, thing, *thing.representation)
    else:
        w.boolean(False)
    if thing is None or not mask & ids.INFO_ACTIVITY:
        w.boolean(False)
    elif isinstance(thing.endpoint, WriterEndpoint):
        w.boolean(True)
        w.u8(ids.KIND_DATAWRITER)
        w.u16(session.last_received(stream))
        count = thing.endpoint.written
        w.octets(bytes(-(w.offset - w.start) % 8))
        w.octets((count & (1 << 64) - 1).to_bytes(8, "little"))
    elif thing.kind == ids.KIND_DATAREADER and thing.endpoint is not None:
        w.boolean(True)
        w.u8(ids.KIND_DATAREADER)
        carrier = ids.STREAM_NONE if thing.delivery is None else thing.delivery.stream_id
        w.u16(session.last_acknowledged(carrier))
    else:
        w.boolean(False)
    return bytes(memoryview(w.buf)[: w.offset])


def _variant(w: Writer, thing: XrceObject, form: int, content: str | bytes, parent: int) -> None:
    """ObjectVariant: the kind, then what CREATE said."""
    w.u8(thing.kind)
    w.u8(form)
    if isinstance(content, bytes):
        w.sequence(content)
    else:
        w.string(content)
    if thing.kind == ids.KIND_PARTICIPANT:
        w.i16(parent)
    elif thing.kind < ids.KIND_TYPE:
        w.be16(parent)
