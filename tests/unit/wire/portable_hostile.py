"""Hostile bytes on CPython and MicroPython: DecodeError at most.

MicroPython differs from CPython just here: in how struct, slices and text fail. The bytes are
of a simple generator, so every run has the same; test_hostile.py looks further.
"""

from support.portable import PULLS, reader

from uros.wire import header
from uros.wire.errors import DecodeError
from uros.wire.framing import Deframer, LengthDeframer
from uros.wire.streams import Fragments, ReliableIn, ReliableOut


class Generator:
    """Pseudo-random numbers of a linear congruential generator."""

    def __init__(self, seed):
        self.state = seed

    def below(self, limit):
        self.state = (self.state * 1103515245 + 12345) & 0x3FFFFFFF
        return (self.state >> 8) % limit

    def octets(self):
        """Return up to 60 octets, half of them small, so that lengths and flags are plausible."""
        return bytes(
            [self.below(3) if self.below(2) else self.below(256) for _ in range(self.below(60))]
        )


def test_any_bytes_into_every_decoder() -> None:
    generator = Generator(1)
    refused = 0
    for turn in range(300):
        octets = generator.octets()
        for pull in PULLS.values():
            r = reader(octets, turn & 1 == 0)
            try:
                pull(r)
            except DecodeError:
                refused += 1
            assert 0 <= r.offset <= len(octets)
    assert 1000 < refused < 300 * len(PULLS), refused


def test_any_bytes_as_headers() -> None:
    generator = Generator(2)
    for _ in range(1000):
        octets = generator.octets()
        try:
            at = header.pull_header(octets, len(octets))[4]
            while at < len(octets):
                _, _, start, stop = header.pull_subheader(octets, at, len(octets))
                assert at < start <= stop <= len(octets)
                at = stop + (-stop & 3)
        except DecodeError:
            pass


def test_any_bytes_into_the_deframers() -> None:
    generator = Generator(3)
    serial = Deframer(0)
    for _ in range(500):
        octets = generator.octets()
        serial.feed(octets)
        serial.feed(octets.replace(b"\x02", b"\x7e").replace(b"\x01", b"\x7d"))
        LengthDeframer().feed(octets)
    sound = bytes.fromhex("7e010010008000000002010800000afffd02000000cf12")
    assert len(serial.feed(sound)) == 1


def test_any_numbers_into_the_streams() -> None:
    generator = Generator(4)
    into, out, fragments = ReliableIn(), ReliableOut(limit=30), Fragments(1000)
    for now in range(3000):
        into.receive((into.next + generator.below(20)) & 0xFFFF, b"x")
        into.pop()
        into.heartbeat(generator.below(65536), generator.below(65536), now)
        assert len(into.waiting) < into.depth
        first, missing = into.acknack()
        assert first == into.next and 0 <= missing <= 0xFFFF
        if len(out) < out.limit:
            out.put(b"x")
        out.take(now)
        out.acknack((out.acked + generator.below(40) - 20) & 0xFFFF, generator.below(65536), now)
        out.heartbeat(now)
        assert len(out) == (out.next - out.acked) & 0xFFFF <= out.limit
        try:
            fragments.add(bytes(generator.below(300)), generator.below(9) == 0)
        except DecodeError:
            pass
        assert fragments.pending <= fragments.limit
