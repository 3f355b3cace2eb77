"""Helpers of the portable tests. Runs on CPython and on MicroPython.

pytest does not rewrite the assertions of this module, so each has a message with the values.
"""

from uros.wire import data, entities, session
from uros.wire.cdr import Reader, Writer
from uros.wire.errors import DecodeError, EncodeError, WireError
from uros.wire.framing import frame, frame_size

# Whether floats have 32 bits, as on most boards; determined where the test runs.
SINGLE_FLOATS = float("1.000000001") == 1.0

# Every decoder of a payload, by the name of the payload.
PULLS = {
    "create_client": session.pull_create_client,
    "status_agent": session.pull_status_agent,
    "request": session.pull_request,
    "status": session.pull_status,
    "get_info": session.pull_get_info,
    "info": session.pull_info,
    "acknack": session.pull_acknack,
    "heartbeat": session.pull_heartbeat,
    "timestamp": session.pull_timestamp,
    "timestamp_reply": session.pull_timestamp_reply,
    "create": entities.pull_create,
    "binary_participant": entities.pull_binary_participant,
    "binary_topic": entities.pull_binary_topic,
    "binary_group": entities.pull_binary_group,
    "binary_writer": lambda r: entities.pull_binary_endpoint(r, False),
    "binary_reader": lambda r: entities.pull_binary_endpoint(r, True),
    "binary_service": entities.pull_binary_service,
    "read_data": data.pull_read_data,
    "sample_identity": lambda r: data.pull_sample_identity(r.buf, r.start, r.end, r.little),
}


def refused(error, call, *arguments):
    """The message of the error that ``call`` must raise; its class must be exactly ``error``."""
    try:
        result = call(*arguments)
    except WireError as raised:
        assert type(raised) is error, raised
        return str(raised)
    raise AssertionError(f"not refused: {arguments!r} gave {result!r}")


def reader(octets, little=True):
    """A Reader of all the octets."""
    return Reader(octets, 0, len(octets), little)


def pair(octets, push, pull, values, arguments=None):
    """Check that ``push(arguments)`` writes ``octets`` (hex) and that ``pull`` reads ``values``.

    Both must refuse every shorter buffer. ``arguments`` are the values where not given.
    """
    octets = bytes.fromhex(octets)
    arguments = values if arguments is None else arguments
    w = Writer(bytearray(len(octets)))
    push(w, *arguments)
    assert bytes(w.buf) == octets and w.offset == len(octets), (w.offset, bytes(w.buf))
    r = reader(octets)
    pulled = pull(r)
    assert pulled == values, pulled
    assert r.remaining() == 0, r.remaining()
    for size in range(len(octets)):
        refused(DecodeError, pull, reader(octets[:size]))
        refused(EncodeError, push, Writer(bytearray(size)), *arguments)


def fits_single(values):
    """Whether all floats in lists and dicts are exact where floats have 32 bits.

    Only floats with few digits count: MicroPython rounds when it reads others, such as 0.1.
    """
    if isinstance(values, dict):
        return all(fits_single(values[name]) for name in values)
    if isinstance(values, (list, tuple)):
        return all(fits_single(value) for value in values)
    if not isinstance(values, float) or values != values or abs(values) == float("inf"):
        return True
    return abs(values) < 4096 and values * 256 == int(values * 256)


def framed(payload, source=1, destination=0):
    """The frame of a payload on a serial line."""
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, source, destination, out)])
