"""The agent on a CAN bus: frames with any length and any length byte, from any board, frames of
other kinds, and a bus that is full or disappears.

The input is records; the low bits of the operation are the kind:

====  ====================================================================
0     a frame's identifier (4 bytes) and its data, unchanged
1     a message, in a valid frame of board ``op >> 4``
2     the state of the bus for sending: 0 accepts frames, 1 is full, 2 is gone, 3 refuses frames
3     a frame of another kind: the bits of the first byte are the kind
4     a time, in milliseconds
====  ====================================================================
"""

import errno
from collections.abc import Iterator

from uros.agent.transports.can import MAX_UNSENT, CanServer, python_can
from uros.transport.can import MTU, can_frame

from . import datagrams, records
from .world import BARE_PING, World, must

OPS = tuple(range(0x40))
_ERRORS = (None, errno.ENOBUFS, errno.ENETDOWN, errno.EINVAL)


class Message:
    """The message class of python-can."""

    def __init__(self, arbitration_id=0, data=b"", is_extended_id=True, **more) -> None:  # type: ignore
        self.arbitration_id = arbitration_id
        self.data = bytearray(data)
        self.is_extended_id = is_extended_id
        self.is_error_frame = more.get("is_error_frame", False)
        self.is_remote_frame = more.get("is_remote_frame", False)


class _Bus:
    def __init__(self) -> None:
        self.given: list[Message] = []
        self.taken: list[Message] = []
        self.error: int | None = None
        self.shut = False

    def recv(self, timeout: float) -> Message | None:
        must(not self.shut, "a bus that is shut is read")
        return self.given.pop(0) if self.given else None

    def send(self, message: Message, timeout: float) -> None:
        must(not self.shut, "a bus that is shut is written to")
        if self.error is not None:
            raise OSError(self.error, "no")
        self.taken.append(message)

    def fileno(self) -> int:
        return 99

    def shutdown(self) -> None:
        must(not self.shut, "shut twice")
        self.shut = True


class _Library:
    Message = Message


class Server(CanServer):
    def __init__(self) -> None:
        super().__init__("fuzz0")
        self.buses: list[_Bus] = []

    def _make(self) -> _Bus:
        self.buses.append(_Bus())
        return self.buses[-1]


def one_input(data: bytes) -> None:
    python_can()  # raises an error where it is not installed
    world = World()
    server = Server()
    server.open(world)  # type: ignore[arg-type]
    server._can = _Library
    for op, body in records.unpack(data):
        kind = op & 7
        bus = server.buses[-1]
        if bus.shut:
            world.step(1000)  # the server opens it again
            bus = server.buses[-1]
            must(not bus.shut, "the bus stays away")
        if kind == 0:
            bus.given.append(Message(int.from_bytes(body[:4], "little") & 0x1FFFFFFF, body[4:68]))
        elif kind == 1:
            bus.given.append(Message(op >> 4, can_frame(body[:MTU])))
        elif kind == 2:
            bus.error = _ERRORS[body[0] & 3 if body else 0]
        elif kind == 3:
            bits = body[0] if body else 0
            bus.given.append(
                Message(
                    int.from_bytes(body[1:5], "little"),
                    body[5:13],
                    not bits & 1,
                    is_error_frame=bool(bits & 2),
                    is_remote_frame=bool(bits & 4),
                )
            )
        elif kind == 4:
            world.step(int.from_bytes(body[:2], "little") % 3000)
        while server._bus is bus and bus.given:
            server._drain()
            world.settle()
        world.witness()
        world.check()
        must(len(server._unsent) <= MAX_UNSENT, "unsent frames")
        must(server._bus is None or not server._bus.shut, "a bus that is gone is kept")
        for message in bus.taken:
            size = len(message.data)
            must(size in (*range(9), 12, 16, 20, 24, 32, 48, 64), f"no frame has {size} bytes")
            must(0 < message.data[0] < size, "a frame that lies about its length")
        bus.taken.clear()
    # After any input, the agent serves the bus again.
    for bus in server.buses:
        bus.error = None
    world.step(2000)
    bus = server.buses[-1]
    must(server._bus is bus, "the bus stays away")
    bus.taken.clear()
    bus.given.append(Message(0x77, can_frame(BARE_PING)))
    server._drain()
    world.settle()
    must(any(frame.arbitration_id == 0x77 for frame in bus.taken), "a ping is not answered")
    server.close()
    must(all(bus.shut for bus in server.buses), "buses after the end")
    for client in list(world.agent.clients.values()):
        if client.key != 0x5EC0DD17:
            world.agent.delete_client(client.key)
    world.close()


def _short() -> Iterator[tuple[int, bytes]]:
    for name, messages in datagrams.captured():
        if name in ("ping", "binary_entities", "service", "time_sync"):
            yield from (record for record in messages if len(record[1]) <= MTU)


def seeds() -> Iterator[tuple[str, bytes]]:
    messages = list(_short())
    frames: list[records.Record] = [(1 | peer << 4, message) for peer, message in messages]
    yield "talk", records.pack(frames[:30])
    yield (
        "kinds",
        records.pack(
            [
                (0, b"\x05\0\0\0\x3f" + bytes(8)),
                (0, b"\x05\0\0\0"),
                (3, b"\x02\x40\0\0\0"),
                (3, b"\x02\0\x01\0\0"),
                (3, b"\x04"),
                (3, b"\x01"),
                (2, b"\x01"),
                (1, BARE_PING),
                (4, b"\xff\x04"),
                (2, b"\x02"),
                (1, BARE_PING),
                (2, b"\x03"),
                (1, BARE_PING),
            ]
        ),
    )


_material: list[records.Record] = [(2, bytes((error,))) for error in range(4)]
_material += [(4, b"\x2c\x01"), (0, b"\x01\0\0\0\x08\x80\0\0\0\0\0\0\0")]
mutate = datagrams.Carried(OPS, (1,), _material, _short).mutate
