"""Frames in noise, in any chunks: intact frames are found, and every byte is accounted for."""

from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.wire.framing import Deframer, LengthDeframer, crc16, frame, frame_size

ADDRESS = st.integers(0, 255)
# Many flags and escapes.
OCTETS = st.lists(
    st.one_of(st.sampled_from([0x7E, 0x7D, 0x5E, 0x5D, 0x20, 0]), st.integers(0, 255)),
    max_size=60,
).map(bytes)
QUIET = OCTETS.map(lambda octets: octets.replace(b"\x7e", b""))
CHUNKS = st.lists(st.integers(1, 40), min_size=1, max_size=8)


def framed(payload: bytes, source: int = 1, destination: int = 0) -> bytes:
    out = bytearray(b"\xee" * (frame_size(payload) + 1))
    size = frame(payload, source, destination, out)
    assert size < len(out) and out[size:] == b"\xee" * (len(out) - size)
    return bytes(out[:size])


def feed(deframer: Deframer | LengthDeframer, stream: bytes, chunks: list[int]) -> list[bytes]:
    """Feed the stream in pieces of these sizes, repeatedly."""
    out = []
    at = turn = 0
    while at < len(stream):
        size = chunks[turn % len(chunks)]
        out += deframer.feed(memoryview(stream)[at : at + size])
        at += size
        turn += 1
    return out


def slow_crc(data: bytes) -> int:
    """Compute CRC-16/ARC by its definition, bit by bit."""
    crc = 0
    for octet in data:
        for bit in range(8):
            crc = crc >> 1 ^ (0xA001 if (crc ^ octet >> bit) & 1 else 0)
    return crc


@given(st.binary(max_size=300))
def test_crc_by_its_definition(data: bytes) -> None:
    assert crc16(data, 0, len(data)) == slow_crc(data)


@given(
    payloads=st.lists(st.one_of(OCTETS, st.binary(max_size=300)), max_size=6),
    source=ADDRESS,
    destination=ADDRESS,
    chunks=CHUNKS,
)
def test_any_payload_through_any_chunking(
    payloads: list[bytes], source: int, destination: int, chunks: list[int]
) -> None:
    deframer = Deframer(destination)
    stream = b"".join(framed(payload, source, destination) for payload in payloads)
    assert feed(deframer, stream, chunks) == payloads
    assert (deframer.skipped, deframer.crc_errors, deframer.foreign) == (0, 0, 0)
    assert deframer.source == (source if payloads else 0)


NOISE = st.one_of(
    st.tuples(st.just("text"), QUIET),
    st.tuples(st.just("foreign"), OCTETS),
    st.tuples(st.just("ours"), OCTETS),
)


@given(parts=st.lists(NOISE, max_size=12), chunks=CHUNKS)
def test_text_without_flags_costs_nothing(
    parts: list[tuple[str, bytes]], chunks: list[int]
) -> None:
    deframer = Deframer(0)
    stream = b""
    for kind, octets in parts:
        stream += octets if kind == "text" else framed(octets, 1, kind == "foreign")
    assert feed(deframer, stream, chunks) == [o for kind, o in parts if kind == "ours"]
    assert deframer.skipped == sum(len(o) for kind, o in parts if kind == "text")
    assert deframer.foreign == sum(kind == "foreign" for kind, _ in parts)
    assert deframer.crc_errors == 0


@settings(max_examples=examples(300))
@given(
    noise=st.lists(st.tuples(OCTETS, st.binary(max_size=20), st.integers(0, 40)), max_size=5),
    payload=OCTETS,
    chunks=CHUNKS,
)
@example([(b"\x7e\x01\x00\xff\xff", b"", 0)], b"x", [1])
@example([(b"\x7e\x7d", b"", 0)], b"x", [1])
def test_the_next_intact_frame_is_found_after_any_noise(
    noise: list[tuple[bytes, bytes, int]], payload: bytes, chunks: list[int]
) -> None:
    """Noise here is garbage with flags in it, and frames that were cut off."""
    deframer = Deframer(0)
    garbage = b"".join(octets + framed(whole)[:cut] for octets, whole, cut in noise)
    feed(deframer, garbage, chunks)
    payloads = feed(deframer, framed(payload), chunks)
    assert payloads == [payload]
    assert deframer._size == 0


@settings(max_examples=examples(300))
@given(pieces=st.lists(st.one_of(OCTETS, OCTETS.map(framed)), max_size=8), chunks=CHUNKS)
def test_every_byte_is_accounted_for(pieces: list[bytes], chunks: list[int]) -> None:
    """fed = in sound frames + skipped + in the frame that is still open, after every byte."""
    stream = b"".join(pieces)
    deframer = Deframer(0)
    out = []
    sound = 0
    for fed, octet in enumerate(stream, 1):
        open_, foreign = deframer._size, deframer.foreign
        messages = deframer.feed(bytes([octet]))
        out += messages
        if messages or deframer.foreign > foreign:
            sound += open_ + 1
        assert sound + deframer.skipped + deframer._size == fed
    whole = Deframer(0)
    assert feed(whole, stream, chunks) == out
    for name in ("skipped", "crc_errors", "foreign", "source", "_size"):
        assert getattr(whole, name) == getattr(deframer, name)


@given(payload=st.binary(min_size=1, max_size=50), at=st.integers(0), flip=st.integers(1, 255))
def test_a_damaged_frame_is_dropped(payload: bytes, at: int, flip: int) -> None:
    """One octet of the payload or of its CRC; a CRC of 16 bits finds every burst up to 16."""
    stream = bytearray(framed(payload))
    stream[len(stream) - 1 - at % (len(payload) + 2)] ^= flip
    deframer = Deframer(0)
    assert payload not in deframer.feed(stream)
    assert deframer.feed(framed(payload)) == [payload]


@given(payloads=st.lists(st.binary(max_size=400), max_size=8), chunks=CHUNKS)
def test_tcp_messages_through_any_chunking(payloads: list[bytes], chunks: list[int]) -> None:
    stream = b"".join(len(p).to_bytes(2, "little") + p for p in payloads)
    deframer = LengthDeframer()
    assert feed(deframer, stream, chunks) == [payload for payload in payloads if payload]
    assert len(deframer._buf) == 0


@given(stream=st.binary(max_size=500), chunks=CHUNKS)
def test_tcp_garbage_is_split_into_messages_and_a_rest(stream: bytes, chunks: list[int]) -> None:
    deframer = LengthDeframer()
    out = feed(deframer, stream, chunks)
    assert LengthDeframer().feed(stream) == out
    assert sum(len(message) + 2 for message in out) + len(deframer._buf) <= len(stream)
    assert all(out)
