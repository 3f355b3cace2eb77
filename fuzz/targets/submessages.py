"""Mutations of submessages that keep their lengths correct."""

from random import Random

from uros.wire import ids

from .records import MutateBytes
from .world import submessage

KINDS = tuple(range(ids.TIMESTAMP_REPLY + 2))


def unpack(body: bytes) -> list[tuple[int, int, bytes]]:
    """(kind, flags, payload) of the submessages in any bytes."""
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
    """A mutation of a message's body, mostly with correct lengths."""
    if random.random() < 0.1:
        return mutate_bytes(body)
    parts = unpack(body)
    draw = random.random()
    if not parts or draw < 0.25:
        parts[random.randrange(len(parts) + 1) :] = unpack(random.choice(material))
        return pack(parts)
    at = random.randrange(len(parts))
    kind, flags, payload = parts[at]
    if draw < 0.6:
        parts[at] = kind, flags, mutate_bytes(payload)
    elif draw < 0.7:
        # Object ids, streams and counters are small numbers in the first bytes.
        edited = bytearray(payload)
        if edited:
            where = random.randrange(min(len(edited), 12))
            edited[where] = random.choice((0, 1, 2, 0x10, 0x11, 0x7F, 0x80, 0x81, 0xFF))
        parts[at] = kind, flags, bytes(edited)
    elif draw < 0.78:
        parts[at] = kind, random.choice((0, 1, 2, 3, 5, 7, 9, 0x0F, 0xFF)), payload
    elif draw < 0.84:
        parts[at] = random.choice(KINDS), flags, payload
    elif draw < 0.9:
        parts[at] = kind, flags, payload[: random.randrange(len(payload) + 1)]
    elif draw < 0.95:
        parts.insert(random.randrange(len(parts) + 1), parts[at])
    else:
        del parts[at]
    return pack(parts)
