"""Submessages that keep their lengths right however their bytes are changed."""

from random import Random

from uros.wire import ids

from .records import MutateBytes
from .world import submessage

KINDS = tuple(range(ids.TIMESTAMP_REPLY + 2))


def unpack(body: bytes) -> list[tuple[int, int, bytes]]:
    """(kind, flags, payload) of what can be found in any bytes."""
    out = []
    at = 0
    while at + 4 <= len(body):
        size = body[at + 2] | body[at + 3] << 8
        out.append((body[at], body[at + 1], body[at + 4 : at + 4 + size]))
        at += 4 + size + (-size & 3)
    return out


def pack(parts: list[tuple[int, int, bytes]]) -> bytes:
    return b"".join(submessage(kind, payload, flags) for kind, flags, payload in parts)


def change(body: bytes, random: Random, mutate_bytes: MutateBytes, material: list[bytes]) -> bytes:
    """Another body of a message; most of the time its lengths are right."""
    if random.random() < 0.1:
        return mutate_bytes(body)
    parts = unpack(body)
    what = random.random()
    if not parts or what < 0.25:
        parts[random.randrange(len(parts) + 1) :] = unpack(random.choice(material))
        return pack(parts)
    at = random.randrange(len(parts))
    kind, flags, payload = parts[at]
    if what < 0.6:
        parts[at] = kind, flags, mutate_bytes(payload)
    elif what < 0.7:
        # Object ids, streams and counters are small numbers in the first bytes.
        edited = bytearray(payload)
        if edited:
            where = random.randrange(min(len(edited), 12))
            edited[where] = random.choice((0, 1, 2, 0x10, 0x11, 0x7F, 0x80, 0x81, 0xFF))
        parts[at] = kind, flags, bytes(edited)
    elif what < 0.78:
        parts[at] = kind, random.choice((0, 1, 2, 3, 5, 7, 9, 0x0F, 0xFF)), payload
    elif what < 0.84:
        parts[at] = random.choice(KINDS), flags, payload
    elif what < 0.9:
        parts[at] = kind, flags, payload[: random.randrange(len(payload) + 1)]
    elif what < 0.95:
        parts.insert(random.randrange(len(parts) + 1), parts[at])
    else:
        del parts[at]
    return pack(parts)
