"""Samples in a writer's history, and what is sent of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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


def holes(numbers: Iterable[int], first: int, last: int) -> list[tuple[int, int]]:
    """Return the runs from ``first`` to ``last`` that are not in ``numbers``.

    Args:
        numbers: Numbers from ``first`` to ``last``, which rise.
        first: The first number.
        last: The last number.

    Returns:
        The first and last number of each run.
    """
    out = []
    for number in numbers:
        if number > first:
            out.append((first, number - 1))
        first = number + 1
    if first <= last:
        out.append((first, last))
    return out


def runs(numbers: Iterable[int]) -> list[tuple[int, int]]:
    """Return the first and last number of each run of numbers, which rise."""
    out: list[tuple[int, int]] = []
    for number in numbers:
        if out and out[-1][1] == number - 1:
            out[-1] = out[-1][0], number
        else:
            out.append((number, number))
    return out


def gaps(writer: bytes, reader: bytes, without: list[tuple[int, int]]) -> Iterator[Packet]:
    """Yield GAP submessages for numbers that a reader does not get.

    Args:
        writer: Entity id of the writer.
        reader: The reader's GUID.
        without: The first and last number of each run of them. The runs rise and do not touch.
    """
    at = 0
    while at < len(without):
        start, last = without[at]
        base = last + 1
        at += 1
        near: list[int] = []
        while at < len(without) and without[at][1] < base + MAX_BITS:
            near.extend(range(without[at][0], without[at][1] + 1))
            at += 1
        octets = encode_gap(reader[ids.PREFIX_SIZE :], writer, start, base, near)
        yield Packet(reader, octets, None)
