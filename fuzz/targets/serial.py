"""The agent's end of a serial line: frames of several boards, with noise and a board's printf
between them, in chunks of any size, and a line that accepts only part of the output.

The input is records; the low bits of the operation are the kind:

====  ====================================================================
0     bytes of the line, unchanged
1     a message, in a frame from board ``1 + (op >> 4)``
2     the same with one byte of the frame wrong or missing: the first byte is its position
3     text of a program, with a line end
4     the number of bytes that the line accepts at once from now on; 0: none
5     a time, in milliseconds
6     the line disappears and comes back
7     a message for another address than the agent's
====  ====================================================================

The bytes arrive in chunks; the first byte of the input is their length, less 1.
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
    """An open device: reads return ``given``, writes append to ``taken``."""

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
    """Whether the output of the agent has an INFO for a board."""
    board = Deframer(address)
    messages = board.feed(taken)
    must(not board.crc_errors, "the agent sends frames with a wrong CRC")
    return any(len(message) > 8 and message[4] == 6 for message in messages)


def one_input(data: bytes) -> None:
    world = World()
    place = Server()
    place.open(world)  # type: ignore[arg-type]
    line = place.line
    chunk = 1 + data[0] if data else 1
    whole = bytearray()
    received: list[bytes] = []
    deliver = place.deliver

    def delivered(host, peer, buf, view, length, now) -> None:  # type: ignore[no-untyped-def]
        received.append(bytes(view[:length]))
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
            received.clear()
        else:
            arrive(framed(body, 1, 1 + (op >> 4)), chunk)
        world.witness()
        world.check()
        must(len(line._deframer._octets) <= 0xFFFF + 6, "more than one frame is held")
        must(len(line.unsent) <= MAX_UNSENT + frame_size(bytes(0xFFFF)), "unsent bytes")

    # The chunks do not change the messages.
    again = Deframer(0)
    must(again.feed(bytes(whole)) == received, "chunks change what is found")
    must(again._octets == line._deframer._octets, "chunks change what is held")
    # After any input, the next valid frame is found and answered.
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
    for name, messages in datagrams.captured():
        if name in ("ping", "publish_reliable", "service", "rclc_int32_subscriber"):
            steps: list[records.Record] = [noise]
            for peer, message in messages:
                steps.append((1 | peer << 4, message))
            steps += [(2, b"\x09" + messages[0][1]), (5, b"\xff\x04"), (7, messages[0][1])]
            yield name, b"\x13" + records.pack(steps)
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
    datagrams.all_messages,
)
mutate = _carried.mutate_in_chunks
