"""Decodes whole XRCE messages with the codecs of uros.wire and encodes them again.

It is not a codec: it only maps submessages to their pull and push functions. The tests of recorded
conversations use it on CPython and on MicroPython.
"""

from uros.wire import data, entities, header, ids, session
from uros.wire.cdr import Reader, Writer


class PaddedWriter(Writer):
    """A Writer that records which octets are padding.

    The padding of C clients is uninitialized memory, so a comparison must leave it out.
    """

    def __init__(self, size):
        super().__init__(bytearray(size))
        self.pads = []

    def _next(self, size, align):
        before = self.offset
        at = super()._next(size, align)
        self.pads.extend(range(before, at))
        return at

    def matches(self, octets):
        """Whether octets equal the written ones, padding excepted."""
        octets = bytearray(octets)
        for at in self.pads:
            if at < len(octets):
                octets[at] = 0
        return bytes(octets) == bytes(memoryview(self.buf)[: self.offset])


_PULL = {
    ids.CREATE_CLIENT: session.pull_create_client,
    ids.GET_INFO: session.pull_get_info,
    ids.DELETE: session.pull_request,
    ids.STATUS_AGENT: session.pull_status_agent,
    ids.STATUS: session.pull_status,
    ids.INFO: session.pull_info,
    ids.READ_DATA: data.pull_read_data,
    ids.ACKNACK: session.pull_acknack,
    ids.HEARTBEAT: session.pull_heartbeat,
    ids.TIMESTAMP: session.pull_timestamp,
    ids.TIMESTAMP_REPLY: session.pull_timestamp_reply,
}


def _push_create_client(w, cookie, version, vendor, key, session_id, properties, mtu):
    session.push_create_client(w, key, session_id, mtu, properties or None, vendor, version, cookie)


_PUSH = {
    ids.CREATE_CLIENT: _push_create_client,
    ids.GET_INFO: session.push_get_info,
    ids.DELETE: session.push_request,
    ids.STATUS_AGENT: session.push_status_agent,
    ids.STATUS: session.push_status,
    ids.INFO: session.push_info,
    ids.READ_DATA: data.push_read_data,
    ids.ACKNACK: session.push_acknack,
    ids.HEARTBEAT: session.push_heartbeat,
    ids.TIMESTAMP: session.push_timestamp,
    ids.TIMESTAMP_REPLY: session.push_timestamp_reply,
}


def unpack(message):
    """(header, [(kind, flags, payload)]): header is (session, stream, sequence, key)."""
    end = len(message)
    session_id, stream, sequence, key, at = header.pull_header(message, end)
    out = []
    while at < end:
        kind, flags, start, stop = header.pull_subheader(message, at, end)
        out.append((kind, flags, bytes(message[start:stop])))
        at = stop + (-stop & 3)
    return (session_id, stream, sequence, key), out


def pack(head, submessages):
    """Encode a message; the inverse of unpack."""
    size = 8
    for _, _, payload in submessages:
        size += 8 + len(payload)
    w = header.MessageWriter(bytearray(size), head[0], head[1], head[2], head[3] or 0)
    for kind, flags, payload in submessages:
        w.begin(kind, flags)
        w.octets(payload)
    return w.finish()


def decode(kind, flags, payload):
    """The values in a payload; no octet may be left over.

    The binary representation of an entity stays encoded: decode_binary decodes it.
    """
    r = Reader(payload, 0, len(payload), bool(flags & ids.FLAG_LITTLE_ENDIAN))
    if kind == ids.CREATE:
        values = list(entities.pull_create(r))
    elif kind in (ids.WRITE_DATA, ids.DATA):
        values = list(session.pull_request(r))
        if values[1] & 0x0F == ids.KIND_REPLIER:
            values.append(data.pull_sample_identity(payload, r.offset, r.end, r.little))
            r.offset += data.SAMPLE_IDENTITY_SIZE
        values.append(r.octets(r.remaining()))
    elif kind == ids.FRAGMENT:
        values = [r.octets(r.remaining())]
    elif kind == ids.RESET:
        values = []
    else:
        values = list(_PULL[kind](r))
    assert r.remaining() == 0, (kind, r.remaining())
    return values


def encode(kind, values):
    """A PaddedWriter with the encoded values, little endian; the inverse of decode."""
    w = PaddedWriter(600)
    if kind == ids.CREATE:
        request_id, object_id, object_kind, form, content, parent = values
        assert object_id & 0x0F == object_kind
        entities.push_create(w, request_id, object_id, form, content, parent)
    elif kind in (ids.WRITE_DATA, ids.DATA):
        session.push_request(w, values[0], values[1])
        if values[1] & 0x0F == ids.KIND_REPLIER:
            data.push_sample_identity(w.buf, w.offset, values[2][0], values[2][1])
            w.offset += data.SAMPLE_IDENTITY_SIZE
        w.octets(values[-1])
    elif kind == ids.FRAGMENT:
        w.octets(values[0])
    elif kind != ids.RESET:
        _PUSH[kind](w, *values)
    return w


def decode_binary(kind, content, little=True):
    """The values in the binary representation of an entity."""
    r = Reader(content, 0, len(content), little)
    if kind == ids.KIND_PARTICIPANT:
        values = entities.pull_binary_participant(r)
    elif kind == ids.KIND_TOPIC:
        values = entities.pull_binary_topic(r)
    elif kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        values = entities.pull_binary_group(r)
    elif kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
        values = entities.pull_binary_endpoint(r, kind == ids.KIND_DATAREADER)
    else:
        values = entities.pull_binary_service(r)
    assert r.remaining() == 0, (kind, r.remaining())
    return values


def encode_binary(kind, values):
    """A PaddedWriter with the encoded values; the inverse of decode_binary."""
    w = PaddedWriter(600)
    if kind == ids.KIND_PARTICIPANT:
        entities.push_binary_participant(w, values[0], values[1])
    elif kind == ids.KIND_TOPIC:
        entities.push_binary_topic(w, values[0], values[1])
    elif kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        entities.push_binary_group(w, values[0], values[1] or None)
    elif kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
        topic_id, qos = values
        assert qos[5] is None and qos[6] is None  # no client sends them
        entities.push_binary_endpoint(
            w, topic_id, qos[0], qos[1], qos[2], qos[3], qos[4], kind == ids.KIND_DATAREADER
        )
    else:
        entities.push_binary_service(w, *values)
    return w


def check(message):
    """Decode a whole message and check that encoding the values gives the same octets.

    Returns the result of unpack, with decoded values in place of the payloads.
    """
    head, submessages = unpack(message)
    out = []
    for kind, flags, payload in submessages:
        values = decode(kind, flags, payload)
        assert encode(kind, values).matches(payload), (kind, values, payload)
        if kind == ids.CREATE and values[3] == ids.IN_BINARY:
            content = values[4]
            values[4] = decode_binary(values[2], content)
            assert encode_binary(values[2], values[4]).matches(content), (values, content)
        out.append((kind, flags, values))
    again = pack(head, submessages)
    # C clients pad the last submessage too.
    assert again == message[: len(again)] and len(message) - len(again) < 4, (again, message)
    return head, out
