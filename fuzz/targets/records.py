"""Inputs that are lists of records: one byte of operation, two of length, and the body."""

from collections.abc import Callable, Iterator
from random import Random

Record = tuple[int, bytes]
MutateBytes = Callable[[bytes], bytes]

MAX_RECORDS = 64


def unpack(data: bytes) -> Iterator[Record]:
    """The records in any bytes; the last one may be incomplete."""
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
    """A mutation of a list of records: one inserted, deleted or changed, or two swapped.

    ``material`` has valid records to insert, ``ops`` all operations; ``change`` mutates the body of
    a record with an operation.
    """
    records = list(unpack(data))
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        at = random.randrange(len(records) + 1)
        draw = random.random()
        if not records or draw < 0.3:
            records[at:at] = [random.choice(material)]
            continue
        at = min(at, len(records) - 1)
        op, body = records[at]
        if draw < 0.75:
            records[at] = op, change(op, body)
        elif draw < 0.82:
            records[at] = random.choice(ops), body
        elif draw < 0.9:
            del records[at]
        elif draw < 0.95:
            records.insert(random.randrange(len(records) + 1), (op, body))
        else:
            second = random.randrange(len(records))
            records[at], records[second] = records[second], records[at]
    return pack(records[:MAX_RECORDS])
