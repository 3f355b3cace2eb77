"""A serial line at the agent's end: frames of several boards, noise and a board's printf between
them, in chunks of any size; and a line that takes only some of what is sent.

Records; the operation's low bits say what the bytes are:

====  ====================================================================
0     bytes of the line as they are
1     a message, put into a frame from board ``1 + (op >> 4)``
2     the same, and one byte of the frame is wrong or missing: the first byte says which
3     text of a program, with the line's end
4     how many bytes the line takes at once from now on; 0: none
5     a time, in milliseconds
6     the line is gone, and comes back
7     a message for somebody else than the agent
====  ====================================================================

The bytes arrive in chunks whose length the first byte of the input says.
"""

from collections.abc import Iterator

from uros.agent.transports.line import MAX_UNSENT, LineServer
from uros.wire.framing import Deframer, frame, frame_size

from . import datagrams, records
from .world import BARE_PING, World, must

OPS = tuple(range(0x40))


def framed(message: bytes, source: int, destination: int = 0) -> bytes:
    out = bytearray(frame_size(message))
    return bytes(out[: frame(message, source, destination, out)])


class Stream:
    """An open device: what it reads is given, what it is sent it keeps."""

    def __init__(self) -> None:
        self.given: list[bytes] = []
        self.taken = bytearray()
        self.takes = 1 << 20
        self.closed = False

    def fileno(self) -> int:
        return 99

    def read(self, size: int) -> bytes:
        must(not self.closed, "a closed device is read")
        if not self.given:
            raise BlockingIOError
        chunk = self.given.pop(0)
        must(len(chunk) <= size, "more than was asked for")
        return chunk

    def write(self, data: bytearray) -> int:
        must(not self.closed, "a closed device is written to")
        if not self.takes:
            raise BlockingIOError
        taken = data[: self.takes]
        self.taken += taken
        return len(taken)

    def backlog(self) -> int:
        return 0

    def close(self) -> None:
        must(not self.closed, "closed twice")
        self.closed = True


class Server(LineServer):
    """A line whose device is a :class:`Stream`."""

    def __init__(self) -> None:
        super().__init__("fuzz")
        self.streams: list[Stream] = []

    def _begin(self, host) -> None:  # type: ignore[no-untyped-def]
        self.streams.append(Stream())
        self._opened(self.streams[-1], "dev: fuzz")


def answered(taken: bytes, address: int) -> bool:
    """Whether there is an INFO for a board in what the agent has sent."""
    board = Deframer(address)
    messages = board.feed(taken)
    must(not board.crc_errors, "the agent sends frames with a wrong CRC")
    return any(len(it) > 8 and it[4] == 6 for it in messages)


def one_input(data: bytes) -> None:
    world = World()
    place = Server()
    place.open(world)  # type: ignore[arg-type]
    line = place.line
    chunk = 1 + data[0] if data else 1
    whole = bytearray()
    got: list[bytes] = []
    deliver = place.deliver

    def delivered(host, peer, buf, view, length, now) -> None:  # type: ignore[no-untyped-def]
        got.append(bytes(view[:length]))
        deliver(host, peer, buf, view, length, now)

    place.deliver = delivered  # type: ignore[method-assign]

    def arrive(raw: bytes, size: int) -> None:
        whole.extend(raw)
        stream = place.streams[-1]
        stream.given += [raw[at : at + size] for at in range(0, len(raw), size)]
        while stream.given:
            line._ready()
            world.settle()

    for op, body in records.unpack(data[1:]):
        kind = op & 7
        if kind == 0:
            arrive(body, chunk)
        elif kind == 1:
            arrive(framed(body, 1 + (op >> 4)), chunk)
        elif kind == 2:
            broken = bytearray(framed(body[1:], 1 + (op >> 4)))
            at = body[0] % len(broken) if body else 0
            if op & 8:
                del broken[at]
            else:
                broken[at] ^= 1 + (op >> 4)
            arrive(bytes(broken), chunk)
        elif kind == 3:
            arrive(body + b"\r\n", chunk)
        elif kind == 4:
            place.streams[-1].takes = int.from_bytes(body[:2], "little")
            line._ready()
        elif kind == 5:
            world.step(int.from_bytes(body[:2], "little") % 3000)
        elif kind == 6:
            stream = place.streams[-1]
            stream.given = [b""]
            line._ready()
            must(stream.closed, "a device that is gone is kept")
            world.step(1000)
            must(len(place.streams) > 1 and line.stream is place.streams[-1], "it stays away")
            whole.clear()
            got.clear()
        else:
            arrive(framed(body, 1, 1 + (op >> 4)), chunk)
        world.witness()
        world.check()
        must(len(line._deframer._octets) <= 0xFFFF + 6, "more than one frame is held")
        must(len(line.unsent) <= MAX_UNSENT + frame_size(bytes(0xFFFF)), "unsent bytes")

    # However it was cut into chunks, the same messages are in it.
    again = Deframer(0)
    must(again.feed(bytes(whole)) == got, "chunks change what is found")
    must(again._octets == line._deframer._octets, "chunks change what is held")
    # Whatever came before, the next sound frame is found, and answered.
    stream = place.streams[-1]
    stream.takes = 1 << 20
    line._push()
    stream.taken.clear()
    dropped = line.dropped
    arrive(framed(BARE_PING, 9), 4096)
    must(answered(bytes(stream.taken), 9) or line.dropped > dropped, "the next frame is not found")
    place.close()
    must(stream.closed, "the device is not closed")
    for client in list(world.agent.clients.values()):
        if client.key != 0x5EC0DD17:
            world.agent.delete_client(client.key)
    world.close()


def seeds() -> Iterator[tuple[str, bytes]]:
    noise = (3, b"boot: ESP-ROM v0.1 ~~~~}}")
    for name, said in datagrams.captured():
        if name in ("ping", "publish_reliable", "service", "rclc_int32_subscriber"):
            found: list[records.Record] = [noise]
            for peer, message in said:
                found.append((1 | peer << 4, message))
            found += [(2, b"\x09" + said[0][1]), (5, b"\xff\x04"), (7, said[0][1])]
            yield name, b"\x13" + records.pack(found)
    yield (
        "slow",
        b"\xff"
        + records.pack(
            [(4, b"\x03\0"), (1, BARE_PING), (4, b"\0\0"), (1, BARE_PING), (6, b""), (1, BARE_PING)]
        ),
    )
    yield "raw", b"\0" + records.pack([(0, framed(BARE_PING, 1) + b"\x7e\x7d\x7e\x00\x00\xff\xff")])


_carried = datagrams.Carried(
    OPS,
    (1, 7),
    [
        (3, b"rst:0x1 (POWERON_RESET)"),
        (4, b"\x05\0"),
        (4, b"\0\0"),
        (5, b"\x2c\x01"),
        (6, b""),
        (0, b"\x7e"),
        (0, b"\x7e\x01\x00\xff\xff"),
        (0, b"\x7d"),
    ],
    datagrams.all_said,
)
mutate = _carried.mutate_in_chunks
