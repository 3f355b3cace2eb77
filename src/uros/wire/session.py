"""Payloads of the submessages that run a session (XRCE 8.3.5).

Every submessage has its pair: ``push_x(w, …)`` writes the payload that
``pull_x(r)`` reads back as a tuple of the same values. Ids are 16-bit numbers
whose first octet on the wire is the high one. A result is a pair of octets,
status and implementation status.
"""

from . import ids
from .errors import DecodeError, LimitError

try:
    from typing import Final

    from .cdr import Reader, Writer
except ImportError:  # MicroPython
    pass

# Most properties in one sequence. The limit prevents this attack: a sequence of four billion pairs.
# The clients know two properties (uxr_sm, uxr_hl).
MAX_PROPERTIES: Final = 32
# Most locators in an INFO. The limit prevents this attack: a list of locators without end.
MAX_LOCATORS: Final = 64


def push_create_client(
    w: "Writer",
    key: int,
    session_id: int,
    mtu: int,
    properties: "list[tuple[str, str]] | None" = None,
    vendor: bytes = ids.VENDOR_EPROSIMA,
    version: "tuple[int, int]" = (ids.VERSION_MAJOR, ids.VERSION_MINOR),
    cookie: bytes = ids.COOKIE,
) -> None:
    """Write CREATE_CLIENT, a CLIENT_Representation; ``mtu`` is the client's, in bytes."""
    w.array(cookie, 4)
    w.u8(version[0])
    w.u8(version[1])
    w.array(vendor, 2)
    w.be16(key >> 16)
    w.be16(key & 0xFFFF)
    w.u8(session_id)
    w.boolean(properties is not None)
    if properties is not None:
        w.u32(len(properties))
        for name, value in properties:
            w.string(name)
            w.string(value)
    w.u16(mtu)


def pull_create_client(
    r: "Reader",
) -> "tuple[bytes, tuple[int, int], bytes, int, int, list[tuple[str, str]], int]":
    """Read ``(cookie, version, vendor, key, session id, properties, mtu)``."""
    cookie = r.octets(4)
    version = (r.u8(), r.u8())
    vendor = r.octets(2)
    key = r.be16() << 16 | r.be16()
    session_id = r.u8()
    properties = _pull_properties(r)
    return cookie, version, vendor, key, session_id, properties, r.u16()


def _pull_properties(r: "Reader") -> "list[tuple[str, str]]":
    properties = []
    if r.boolean():
        count = r.u32()
        if count > MAX_PROPERTIES:
            raise LimitError("%d properties are over the limit of %d" % (count, MAX_PROPERTIES))
        for _ in range(count):
            properties.append((r.string(), r.string()))
    return properties


def push_status_agent(w: "Writer", status: int, implementation: int = 0) -> None:
    """Write the answer to CREATE_CLIENT: a result, and the agent's identity."""
    w.u8(status)
    w.u8(implementation)
    _push_agent(w)


def pull_status_agent(r: "Reader") -> "tuple[int, int]":
    """Read ``(status, implementation status)``."""
    status, implementation = r.u8(), r.u8()
    _pull_agent(r)
    return status, implementation


def _push_agent(w: "Writer") -> None:
    w.octets(ids.COOKIE)
    w.u8(ids.VERSION_MAJOR)
    w.u8(ids.VERSION_MINOR)
    w.octets(ids.VENDOR_EPROSIMA)
    w.boolean(False)  # no properties


def _pull_agent(r: "Reader") -> None:
    if r.octets(4) != ids.COOKIE:
        raise DecodeError("an agent that does not say XRCE")
    r.octets(4)  # version, vendor
    _pull_properties(r)


def push_request(w: "Writer", request_id: int, object_id: int) -> None:
    """Write request id and object id: all of DELETE, the start of most other payloads."""
    w.be16(request_id)
    w.be16(object_id)


def pull_request(r: "Reader") -> "tuple[int, int]":
    """Read ``(request id, object id)``."""
    return r.be16(), r.be16()


def push_status(
    w: "Writer", request_id: int, object_id: int, status: int, implementation: int = 0
) -> None:
    """Write the answer to CREATE, DELETE and failed requests."""
    push_request(w, request_id, object_id)
    w.u8(status)
    w.u8(implementation)


def pull_status(r: "Reader") -> "tuple[int, int, int, int]":
    """Read ``(request id, object id, status, implementation status)``."""
    return r.be16(), r.be16(), r.u8(), r.u8()


def push_get_info(w: "Writer", request_id: int, object_id: int, mask: int) -> None:
    """Write GET_INFO of an object; that of OBJECT_AGENT is the ping."""
    push_request(w, request_id, object_id)
    w.u32(mask)


def pull_get_info(r: "Reader") -> "tuple[int, int, int]":
    """Read ``(request id, object id, mask)``."""
    return r.be16(), r.be16(), r.u32()


def push_info(
    w: "Writer",
    request_id: int,
    object_id: int,
    status: int,
    implementation: int,
    locators: "list[tuple[bytes, int]]",
) -> None:
    """Write INFO of the agent, the answer to a ping.

    ``locators`` are (address, port), the address of 4 bytes (IPv4) or of 16
    (IPv6). ``implementation`` is 1 if the client has a session, 0 if not;
    eProsima's clients decide by it whether to reconnect.
    """
    push_status(w, request_id, object_id, status, implementation)
    w.boolean(True)
    w.u8(ids.KIND_AGENT)
    _push_agent(w)
    w.boolean(True)
    w.u8(ids.KIND_AGENT)
    w.i16(1)  # available
    w.u32(len(locators))
    for address, port in locators:
        if len(address) == 16:
            w.u8(2)  # ADDRESS_FORMAT_LARGE: IPv6
            w.octets(address)
            w.u32(port)
        else:
            w.u8(1)  # ADDRESS_FORMAT_MEDIUM: IPv4
            w.array(address, 4)
            w.u16(port)


def pull_info(r: "Reader") -> "tuple[int, int, int, int, list[tuple[bytes, int]]]":
    """Read ``(request id, object id, status, implementation status, locators)``.

    Locators of other formats than IPv4 and IPv6 are skipped.
    """
    request_id, object_id, status, implementation = pull_status(r)
    locators: "list[tuple[bytes, int]]" = []
    if r.boolean():
        if r.u8() != ids.KIND_AGENT:
            raise DecodeError("INFO about something that is not the agent")
        _pull_agent(r)
    if r.boolean() and r.u8() == ids.KIND_AGENT:
        r.i16()
        count = r.u32()
        if count > MAX_LOCATORS:
            raise LimitError("%d locators are over the limit of %d" % (count, MAX_LOCATORS))
        for _ in range(count):
            form = r.u8()
            if form == 0:
                r.octets(3)
            elif form == 1:
                address = r.octets(4)
                locators.append((address, r.u16()))
            elif form == 2:
                address = r.octets(16)
                locators.append((address, r.u32()))
            elif form == 3:
                r.string()
            else:
                raise DecodeError("locator format %d does not exist" % form)
    return request_id, object_id, status, implementation, locators


def push_acknack(w: "Writer", first_unacked: int, missing: int, stream_id: int) -> None:
    """Write ACKNACK: everything before ``first_unacked`` was received.

    Bit i of the 16-bit ``missing`` requests ``first_unacked + i`` again.
    """
    w.u16(first_unacked)
    w.be16(missing)
    w.u8(stream_id)


def acknack_message(
    session_id: int, key: int, first_unacked: int, missing: int, stream_id: int
) -> bytes:
    """Return an ACKNACK message with its header; one is sent for every burst received."""
    # Written octet by octet, since a format for struct would take more of a board's heap.
    body = bytes(
        (
            ids.ACKNACK,
            ids.FLAG_LITTLE_ENDIAN,
            5,
            0,
            first_unacked & 0xFF,
            first_unacked >> 8,
            missing >> 8,
            missing & 0xFF,
            stream_id,
        )
    )
    if session_id & 0x80:
        return bytes((session_id, 0, 0, 0)) + body
    octets = (key >> 24, key >> 16 & 0xFF, key >> 8 & 0xFF, key & 0xFF)
    return bytes((session_id, 0, 0, 0) + octets) + body


def pull_acknack(r: "Reader") -> "tuple[int, int, int]":
    """Read ``(first unacknowledged, missing, stream id)``."""
    return r.u16(), r.be16(), r.u8()


def push_heartbeat(w: "Writer", first_unacked: int, last_sent: int, stream_id: int) -> None:
    """Write HEARTBEAT: the sender holds ``first_unacked`` to ``last_sent``."""
    w.u16(first_unacked)
    w.u16(last_sent)
    w.u8(stream_id)


def pull_heartbeat(r: "Reader") -> "tuple[int, int, int]":
    """Read ``(first unacknowledged, last sent, stream id)``."""
    return r.u16(), r.u16(), r.u8()


def push_timestamp(w: "Writer", seconds: int, nanoseconds: int) -> None:
    """Write the client's time of sending, in seconds since 1970 or since its start.

    The field is signed in the C sources and has no agreed meaning from 2038
    on; here it is unsigned and lasts until 2106.
    """
    w.u32(seconds)
    w.u32(nanoseconds)


def pull_timestamp(r: "Reader") -> "tuple[int, int]":
    """Read ``(seconds, nanoseconds)``."""
    return r.u32(), r.u32()


def push_timestamp_reply(
    w: "Writer",
    transmit: "tuple[int, int]",
    receive: "tuple[int, int]",
    originate: "tuple[int, int]",
) -> None:
    """Write the agent's times of sending and receiving, and the client's stamp.

    Each is (seconds since 1970, nanoseconds).
    """
    for seconds, nanoseconds in (transmit, receive, originate):
        push_timestamp(w, seconds, nanoseconds)


def pull_timestamp_reply(
    r: "Reader",
) -> "tuple[tuple[int, int], tuple[int, int], tuple[int, int]]":
    """Read ``(transmit, receive, originate)``, each (seconds, nanoseconds)."""
    return pull_timestamp(r), pull_timestamp(r), pull_timestamp(r)
