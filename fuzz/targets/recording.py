"""Recordings that ``uros trace`` and ``uros replay`` read: pcapng and JSON lines, of any bytes.

Every message in a recording is described in one line of printable characters.
"""

import json
from collections.abc import Iterator
from random import Random

from uros.agent.observability.format import MAX_LINE, format_message
from uros.agent.observability.message_hooks import MessageEvent
from uros.agent.observability.pcapng import PcapngEncoder
from uros.tools.capture.recordings import parser_for, read
from uros.tools.capture.records import RecordingError

from . import records, submessages
from .datagrams import CAPTURES, captured
from .world import BARE_PING, Place, must
from .xml import scratch

_MESSAGE = 1  # in the first byte: the input is one message, not a file


def _described(message: bytes) -> None:
    line = format_message(message)
    must(len(line) <= MAX_LINE + 100, f"a line of {len(line)} characters")
    must(line.isprintable() or not line, f"a line with {line!r}")


def one_input(data: bytes) -> None:
    if data[:1] == bytes((_MESSAGE,)):
        _described(data[1:])
        return
    data = data[1:]
    path = scratch()
    path.write_bytes(data)
    all_records = []
    error_text = ""
    try:
        for record in read(path):
            all_records.append(record)
    except RecordingError as error:
        error_text = str(error)
        must(str(path) in error_text, f"the file is not named: {error_text[:200]}")
        must(len(error_text) < 2000, "a text for people")
    for record in all_records[:200]:
        must(
            isinstance(record.message, bytes) and 0 <= record.key < 1 << 32,
            f"a record: {record!r:.200}",
        )
        _described(record.message)
    # Parsing in pieces, as from a file that is being written, gives the same records.
    if error_text or not data:
        return
    try:
        parser = parser_for(data, str(path))
        pieces = [
            record for at in range(0, len(data), 7) for record in parser.feed(data[at : at + 7])
        ]
    except RecordingError as error:
        must(False, f"in pieces it is broken: {error}")
    must(pieces == all_records, "in pieces it is another one")


def _pcapng() -> bytes:
    """A capture in the form that the agent writes."""
    packets, place = PcapngEncoder(), Place()
    messages = (("client", BARE_PING), ("agent", BARE_PING), ("client", bytes(70_000)))
    return b"".join(
        packets.encode(
            MessageEvent(place, 1, sender, message[:900], 1_700_000_000_000_000, 7), lost
        )
        for lost, (sender, message) in enumerate(messages)
    )


def seeds() -> Iterator[tuple[str, bytes]]:
    yield "pcapng", b"\0" + _pcapng()
    for name in ("ping", "serial_ping", "tcp_publish", "service"):
        lines = (CAPTURES / f"{name}.jsonl").read_bytes().splitlines(True)
        yield name, b"\0" + b"".join(lines[:8])
    for name, messages in captured():
        if name in ("binary_entities", "rclc_trigger", "publish_reliable"):
            for number, (_, message) in enumerate(messages[:6]):
                yield f"message_{name}_{number}", bytes((_MESSAGE,)) + message


_WORDS = (
    b"\x0a\x0d\x0d\x0a", b"\x4d\x3c\x2b\x1a", b"\x06\0\0\0", b"\x01\0\0\0", b"\xff\xff\xff\xff",
    b"{", b"}", b'"hex": ""', b"null", b"1e999", b"NaN", b'"t": -1', b"[" * 50, b"\\ud800", b"\n",
)  # fmt: skip
_bodies: list[bytes] = []


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    if not _bodies:
        _bodies.extend(message[4:] for _, messages in captured() for _, message in messages)
    head, body = data[:1] or b"\0", data[1:]
    if head == bytes((_MESSAGE,)):
        return head + body[:4] + submessages.change(body[4:], random, mutate_bytes, _bodies)
    draw = random.random()
    if draw < 0.4:
        return head + mutate_bytes(body)
    if draw < 0.7:
        at = random.randrange(len(body) + 1)
        return head + body[:at] + random.choice(_WORDS) + body[at:]
    lines = body.split(b"\n")
    at = random.randrange(len(lines))
    if draw < 0.8:
        del lines[at]
    elif draw < 0.9:
        lines.insert(at, random.choice(lines))
    else:
        message = b"\x81\x80\0\0" + random.choice(_bodies)
        line = {"t": random.random(), "from": random.choice(("client", "agent"))}
        line |= {"client": random.randrange(3), "hex": message.hex()}
        lines.insert(at, json.dumps(line).encode())
    return head + b"\n".join(lines)
