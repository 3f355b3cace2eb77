"""Hostile bytes: every decoder raises DecodeError at most, for any input."""

import json
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.conversation import decode, decode_binary, unpack
from support.examples import examples
from support.portable import PULLS

from uros.wire import data, entities, header, ids, session, streams
from uros.wire.cdr import MAX_STRING, Reader
from uros.wire.errors import DecodeError, LimitError

# Small numbers make plausible lengths and flags.
OCTETS = st.lists(st.one_of(st.integers(0, 3), st.integers(0, 255)), max_size=120).map(bytes)

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
DATAGRAMS = sorted(
    {
        json.loads(line)["hex"]
        for file in CAPTURES.glob("*.jsonl")
        if not file.stem.startswith(("serial_", "tcp_"))
        for line in file.read_text().splitlines()
    },
    key=len,
)


def test_every_decoder_is_tested() -> None:
    decoders = {
        name.removeprefix("pull_")
        for module in (session, entities, data)
        for name in vars(module)
        if name.startswith("pull_")
    }
    decoders |= {"binary_writer", "binary_reader"}
    assert decoders - {"binary_endpoint"} == PULLS.keys()


@pytest.mark.parametrize("name", PULLS)
@settings(deadline=None)
@given(octets=OCTETS, start=st.integers(0, 7), little=st.booleans())
def test_any_bytes(name: str, octets: bytes, start: int, little: bool) -> None:
    r = Reader(octets, min(start, len(octets)), len(octets), little)
    try:
        PULLS[name](r)
    except DecodeError:
        pass
    assert r.start <= r.offset <= r.end


def take_apart(message: bytes) -> None:
    """Decode everything in a message, down to the binary representations."""
    _, submessages = unpack(message)
    for kind, flags, payload in submessages:
        if kind > ids.TIMESTAMP_REPLY:
            continue
        try:
            values = decode(kind, flags, payload)
            if kind == ids.CREATE and values[3] == ids.IN_BINARY:
                decode_binary(values[2], values[4], bool(flags & 1))
        except AssertionError:
            pass  # bytes left over


@settings(deadline=None, max_examples=examples(500))
@given(OCTETS)
def test_any_message(message: bytes) -> None:
    try:
        take_apart(message)
    except DecodeError:
        pass


def test_recorded_messages_truncated_everywhere() -> None:
    for text in DATAGRAMS:
        message = bytes.fromhex(text)
        for size in range(min(len(message), 300)):
            try:
                take_apart(message[:size])
            except DecodeError:
                pass


def test_recorded_payloads_truncated_everywhere() -> None:
    """A payload that lacks its last byte is refused and has no other meaning."""
    refused = 0
    for text in DATAGRAMS:
        for kind, flags, payload in unpack(bytes.fromhex(text))[1]:
            if kind in (ids.FRAGMENT, ids.WRITE_DATA, ids.DATA):
                continue
            for size in range(len(payload)):
                with pytest.raises(DecodeError):
                    decode(kind, flags, payload[:size])
                refused += 1
    assert refused > 4000


@settings(deadline=None, max_examples=examples(1000))
@given(
    text=st.sampled_from(DATAGRAMS),
    changes=st.lists(st.tuples(st.integers(0, 600), st.integers(0, 255)), min_size=1, max_size=4),
)
def test_recorded_messages_with_wrong_bytes(text: str, changes: list[tuple[int, int]]) -> None:
    message = bytearray.fromhex(text)
    for at, octet in changes:
        message[at % len(message)] = octet
    try:
        take_apart(bytes(message))
    except DecodeError:
        pass


@given(octets=OCTETS, offset=st.integers(0, 120))
def test_any_headers(octets: bytes, offset: int) -> None:
    try:
        *_, at = header.pull_header(octets, len(octets))
        assert at <= len(octets) - header.SUBHEADER_SIZE
    except DecodeError:
        pass
    try:
        _, _, start, stop = header.pull_subheader(octets, offset, len(octets))
        assert offset < start <= stop <= len(octets)
    except DecodeError:
        pass


# The length or count at the end is only announced.
GREEDY = {
    "create_client": "58524345 0100 010f aaaabbbb 81 01 0000",
    "status_agent": "0000 58524345 0100 010f 01 00",
    "info": "0001 fffd 00 00 00 01 0d 00 0100",
    "create": "000a 0011 01 02 0000",
    "binary_participant": "01 000000",
    "binary_topic": "",
    "binary_group": "00 01 01 00",
    "binary_writer": "0012 01 00 0100 00 00 00 01 0000",
    "binary_reader": "0012 01 00 0100 00 00 00 00 00 01",
    "binary_service": "",
    "read_data": "0010 0016 80 00 01 00",
}


@pytest.mark.parametrize("name", GREEDY)
@pytest.mark.parametrize("length", [MAX_STRING, MAX_STRING + 1, 0xFFFFFFFF])
def test_nothing_is_allocated_for_a_length_that_is_only_announced(name: str, length: int) -> None:
    octets = bytes.fromhex(GREEDY[name])
    octets += bytes(-len(octets) & 3) + length.to_bytes(4, "little")
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError) as caught:
            PULLS[name](Reader(octets, 0, len(octets)))
        assert tracemalloc.get_traced_memory()[1] < 20_000
    finally:
        tracemalloc.stop()
    assert length == MAX_STRING or caught.type is LimitError


def test_fragments_take_no_more_memory_than_their_bytes() -> None:
    fragments = streams.Fragments()
    tracemalloc.start()
    try:
        for _ in range(50_000):
            fragments.add(b"", False)
            fragments.add(b"x", False)
        assert fragments.pending == 50_000
        assert tracemalloc.get_traced_memory()[1] < 200_000
    finally:
        tracemalloc.stop()


def test_fragments_are_dropped_at_the_limit() -> None:
    fragments = streams.Fragments()
    part = bytes(60_000)
    with pytest.raises(LimitError):
        while True:
            assert fragments.add(part, False) is None
            assert fragments.pending <= streams.MAX_MESSAGE
    assert fragments.pending == 0


def test_early_messages_take_no_more_memory_than_a_window() -> None:
    stream = streams.ReliableIn()
    for number in range(1, 65536):
        stream.receive(number, b"x" * 100)
    assert len(stream.waiting) == streams.WINDOW - 1
