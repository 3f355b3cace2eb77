"""Client transport over CAN FD: one message per frame. Runs on MicroPython.

As in eProsima's client, identifiers are extended ones, the same in both directions, and a frame
holds the message's length in one byte, the message, and padding: a CAN FD frame has one of sixteen
lengths.
"""

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms

try:
    from typing import Any, Final, Protocol

    from ..wire.cdr import Buffer

    class Port(Protocol):
        """CAN controller of a :class:`CanTransport`. Neither call waits.

        A port may have ``wait(timeout_ms)``, which returns when there is a frame or the time is
        up, and ``open()`` and ``close()``, which raise OSError.
        """

        def send(self, can_id: int, data: "Buffer") -> "bool | None":
            """Send an extended FD frame; False: no buffer is free. OSError: the bus is gone."""

        def recv(self) -> "tuple[int, Buffer] | None":
            """Return identifier and data of the next extended frame, if any. OSError: gone."""

except ImportError:  # MicroPython
    pass

MTU: Final = 63
MAX_ID: Final = 0x1FFFFFFF
_LENGTHS: Final = (8, 12, 16, 20, 24, 32, 48, 64)
# Most frames read in one call: a busy bus must not block the program.
_FRAMES: Final = 64


def can_frame(message: "Buffer", size: int = -1) -> bytearray:
    """Return a frame's data for a message, or for its first ``size`` bytes; MTU bytes at most."""
    if size < 0:
        size = len(message)
    length = size + 1
    if length > 8:
        for length in _LENGTHS:
            if length > size:
                break
    data = bytearray(length)
    data[0] = size
    data[1 : size + 1] = message if len(message) == size else memoryview(message)[:size]
    return data


class CanTransport:
    """One board on a CAN bus.

    Messages for which the controller has no free buffer, and those longer than a frame, are lost
    and counted in ``dropped``; reliable ones are sent again. Frames whose length byte exceeds
    their data are counted in ``malformed``.

    Args:
        port: See `Port`.
        can_id: The board's identifier, unique on the bus.
    """

    def __init__(self, port: "Any", can_id: int = 1) -> None:
        if not 0 <= can_id <= MAX_ID:
            raise ValueError("a CAN id has 29 bits: 0 to 0x%X" % MAX_ID)
        self.port = port
        self.can_id = can_id
        self.mtu = MTU
        self.dropped = 0
        self.malformed = 0

    def open(self) -> None:
        """Open the port, if it has ``open``. Raises OSError if that does."""
        if hasattr(self.port, "open"):
            self.port.open()

    def close(self) -> None:
        """Close the transport; idempotent."""
        if hasattr(self.port, "close"):
            self.port.close()

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without ``size``, all of the message."""
        if size < 0:
            size = len(message)
        if size > MTU or self.port.send(self.can_id, can_frame(message, size)) is False:
            self.dropped += 1

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`."""
        end = ticks_add(ticks_ms(), timeout_ms)
        frames = 0
        while True:
            frame = self.port.recv()
            if frame is not None:
                if frame[0] == self.can_id:
                    data = frame[1]
                    if len(data) and 0 < data[0] < len(data):
                        return bytes(data[1 : data[0] + 1])
                    self.malformed += 1
                frames += 1
                if frames < _FRAMES:
                    continue
            left = ticks_diff(end, ticks_ms())
            if left <= 0:
                return None
            if frame is not None:
                continue
            if hasattr(self.port, "wait"):
                self.port.wait(left)
            else:
                sleep_ms(1)
