"""The agent's end of TCP connections: lengths and messages in chunks of any size, clients that
do not read, and connections that break at any place.

The input is records; the connection is ``op >> 4 & 3``, and the low bits are the kind:

====  ====================================================================
0     bytes, unchanged
1     a message, with its length before it
2     the number of bytes that the socket accepts at once from now on; 0: none
3     the connection ends; the next record opens another
4     the connection is reset while the agent writes
5     a time, in milliseconds
====  ====================================================================
"""

from collections.abc import Iterator

from uros.agent.transports import tcp
from uros.wire.framing import LengthDeframer

from . import datagrams, records
from .world import BARE_PING, World, must

OPS = tuple(range(0x40))


class Socket:
    """A connected socket."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.given: list[bytes] = []
        self.taken = bytearray()
        self.takes = 1 << 20
        self.broken = False
        self.closed = False

    def fileno(self) -> int:
        must(not self.closed, "the descriptor of a closed socket")
        return 1000 + self.number

    def recv(self, size: int) -> bytes:
        must(not self.closed, "a closed socket is read")
        if not self.given:
            raise BlockingIOError
        chunk = self.given.pop(0)
        if len(chunk) > size:
            self.given.insert(0, chunk[size:])
        return chunk[:size]

    def send(self, data: bytearray) -> int:
        must(not self.closed, "a closed socket is written to")
        if self.broken:
            raise ConnectionResetError
        if not self.takes:
            raise BlockingIOError
        taken = data[: self.takes]
        self.taken += taken
        return len(taken)

    def setblocking(self, on: bool) -> None:
        must(not on, "a socket that blocks")

    def setsockopt(self, *_: object) -> None:
        pass

    def close(self) -> None:
        must(not self.closed, "closed twice")
        self.closed = True


class _Listener:
    def __init__(self) -> None:
        self.coming: list[Socket] = []

    def accept(self) -> tuple[Socket, tuple[str, int]]:
        sock = self.coming.pop(0)
        return sock, ("127.0.0.1", 40000 + sock.number)

    def fileno(self) -> int:
        return 99

    def close(self) -> None:
        pass


class _End:
    """One connection, from both sides."""

    def __init__(self, server: tcp.TcpServer, world: World, number: int) -> None:
        self.sock = Socket(number)
        self._world = world
        self._server = server
        before = set(server._connections)
        server._socket.coming.append(self.sock)  # type: ignore[union-attr]
        server._accept()
        (self.connection,) = set(server._connections) - before
        self.whole = bytearray()

    @property
    def open(self) -> bool:
        return self.connection in self._server._connections

    def arrive(self, raw: bytes, size: int) -> None:
        self.whole += raw
        self.sock.given += [raw[at : at + size] for at in range(0, len(raw), size)]
        while self.sock.given and self.open:
            self._server._ready(self.connection)
            self._world.settle()


def one_input(data: bytes) -> None:
    world = World()
    server = tcp.TcpServer(0)
    server._host = world  # type: ignore[assignment]
    server._socket = _Listener()  # type: ignore[assignment]
    received: dict[object, list[bytes]] = {}
    deliver = server.deliver

    def delivered(host, peer, buf, view, length, now) -> None:  # type: ignore[no-untyped-def]
        received.setdefault(peer, []).append(bytes(view[:length]))
        deliver(host, peer, buf, view, length, now)

    server.deliver = delivered  # type: ignore[method-assign]
    chunk = 1 + data[0] if data else 1
    ends: dict[int, _End] = {}
    count = 0
    for op, body in records.unpack(data[1:]):
        number, kind = op >> 4 & 3, op & 7
        end = ends.get(number)
        if end is None or not end.open:
            count += 1
            end = ends[number] = _End(server, world, count)
        if kind == 0:
            end.arrive(body, chunk)
        elif kind == 1:
            end.arrive(len(body).to_bytes(2, "little") + body, chunk)
        elif kind == 2:
            end.sock.takes = int.from_bytes(body[:2], "little")
            server._ready(end.connection)
        elif kind == 3:
            end.sock.given = [b""]
            server._ready(end.connection)
            world.settle()
            must(not end.open and end.sock.closed, "a connection outlives its end")
        elif kind == 4:
            end.sock.broken = True
            end.arrive(len(BARE_PING).to_bytes(2, "little") + BARE_PING, chunk)
        elif kind == 5:
            world.step(int.from_bytes(body[:2], "little") % 3000)
        world.witness()
        world.check()
        for end in ends.values():
            must(end.open != end.sock.closed, "a connection without its socket, or the reverse")
            must(len(end.connection.deframer._buf) <= 0xFFFF + 2, "more than one message is held")
            must(len(end.connection.unsent) <= tcp.MAX_UNSENT + 2, "unsent bytes")
        for peer in server.sessions:
            must(peer in server._connections, "a session without its connection")
    for end in ends.values():
        if end.open:
            again = LengthDeframer().feed(bytes(end.whole))
            must(again == received.get(end.connection, []), "chunks change what is found")
    # After any input, a new connection is served.
    last = _End(server, world, count + 1)
    last.arrive(len(BARE_PING).to_bytes(2, "little") + BARE_PING, 3)
    must(b"\x80" in last.sock.taken and len(last.sock.taken) > 8, "a ping is not answered")
    server.close()
    must(not server.sessions, "sessions after the end")
    must(all(end.sock.closed for end in ends.values()), "sockets after the end")
    world.settle()
    world.close()


def seeds() -> Iterator[tuple[str, bytes]]:
    for name, messages in datagrams.captured():
        if name in ("ping", "publish_reliable", "service", "rclc_int32_subscriber"):
            steps: list[records.Record] = [(1 | peer << 4, message) for peer, message in messages]
            steps.insert(3, (2, b"\x01\0"))
            steps += [(5, b"\xff\x04"), (0, b"\0\0\x05"), (3, b""), (1, BARE_PING), (4, b"")]
            yield name, b"\x06" + records.pack(steps)


_carried = datagrams.Carried(
    OPS,
    (1,),
    [
        (0, b"\xff\xff"),
        (0, b"\0\0"),
        (0, b"\x04"),
        (2, b"\x05\0"),
        (2, b"\0\0"),
        (3, b""),
        (4, b""),
        (5, b"\x2c\x01"),
    ],
    datagrams.all_messages,
)
mutate = _carried.mutate_in_chunks
