"""Samples in a writer's history, and what is sent of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from . import ids
from .submessages import MAX_BITS, encode_gap


class Change(NamedTuple):
    """A sample in the history.

    Attributes:
        number: Its sequence number.
        payload: The sample with its encapsulation header; None for a farewell.
        inline_qos: Inline QoS, little endian; empty without one.
        time_ns: When it was written, in ns since 1970; None: unknown.
        readers: The GUIDs of the only readers that it is for; None: for all.
        is_key: Whether the payload is a key.
        with_header: The payload for readers that expect the identity of a request in it, and not in
            inline QoS; None where there is no such difference.
        written_at: When it was written, by the clock of deadlines in seconds.
        expires: When its lifespan is over; infinity: never.
    """

    number: int
    payload: bytes | None
    inline_qos: bytes
    time_ns: int | None
    readers: frozenset[bytes] | None
    is_key: bool
    with_header: bytes | None
    written_at: float
    expires: float

    @property
    def octets(self) -> int:
        """What it takes of the history's limit."""
        return len(self.payload or b"") + len(self.with_header or b"")

    def is_for(self, reader: bytes) -> bool:
        """Return whether it is for the reader of a GUID."""
        return self.readers is None or reader in self.readers


class Packet(NamedTuple):
    """Submessages for one reader, or for all matched readers.

    Attributes:
        reader: The GUID of the reader; None: for all.
        submessages: The submessages, which must stay in one message.
        time_ns: The source time of DATA in it; None without one.
    """

    reader: bytes | None
    submessages: bytes
    time_ns: int | None


def gaps(writer: bytes, reader: bytes, numbers: list[int]) -> Iterator[Packet]:
    """Yield GAP submessages for numbers that a reader does not get.

    Args:
        writer: Entity id of the writer.
        reader: The reader's GUID.
        numbers: The numbers, which rise.
    """
    at = 0
    while at < len(numbers):
        start = base = numbers[at]
        while at < len(numbers) and numbers[at] == base:
            at += 1
            base += 1
        near = []
        while at < len(numbers) and numbers[at] < base + MAX_BITS:
            near.append(numbers[at])
            at += 1
        octets = encode_gap(reader[ids.PREFIX_SIZE :], writer, start, base, near)
        yield Packet(reader, octets, None)
