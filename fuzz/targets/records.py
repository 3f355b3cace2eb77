"""Inputs that are lists of records: an operation of one byte, a length of two, and bytes."""

from collections.abc import Callable, Iterator
from random import Random

Record = tuple[int, bytes]
MutateBytes = Callable[[bytes], bytes]

MAX_RECORDS = 64


def unpack(data: bytes) -> Iterator[Record]:
    """The records of any bytes; the last may be cut short."""
    at = 0
    for _ in range(MAX_RECORDS):
        if at + 3 > len(data):
            return
        stop = at + 3 + (data[at + 1] | data[at + 2] << 8)
        yield data[at], data[at + 3 : stop]
        at = stop


def pack(records: list[Record]) -> bytes:
    return b"".join(
        bytes((op,)) + min(len(body), 0xFFFF).to_bytes(2, "little") + body[:0xFFFF]
        for op, body in records
    )


def mutate(
    data: bytes,
    random: Random,
    ops: tuple[int, ...],
    material: list[Record],
    change: Callable[[int, bytes], bytes],
) -> bytes:
    """Another list of records: one more, one less, one changed, two swapped.

    ``material`` are good records to take, ``ops`` all operations, ``change`` changes the bytes
    of a record with that operation.
    """
    records = list(unpack(data))
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        at = random.randrange(len(records) + 1)
        what = random.random()
        if not records or what < 0.3:
            records[at:at] = [random.choice(material)]
            continue
        at = min(at, len(records) - 1)
        op, body = records[at]
        if what < 0.75:
            records[at] = op, change(op, body)
        elif what < 0.82:
            records[at] = random.choice(ops), body
        elif what < 0.9:
            del records[at]
        elif what < 0.95:
            records.insert(random.randrange(len(records) + 1), (op, body))
        else:
            other = random.randrange(len(records))
            records[at], records[other] = records[other], records[at]
    return pack(records[:MAX_RECORDS])
