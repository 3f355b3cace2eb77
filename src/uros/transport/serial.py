"""Client transport over a serial line: frames on anything that reads and writes bytes.

Runs on MicroPython, on a UART, a USB-CDC interface or a terminal's file.
"""

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms
from ..wire.framing import Deframer, frame, frame_size
from ..wire.ids import STREAM_RELIABLE
from ..wire.streams import WINDOW

try:
    from typing import Any, Final, Protocol

    from ..wire.cdr import Buffer

    class Port(Protocol):
        """Line of a :class:`StreamTransport`. Neither call waits.

        A port may have ``wait(timeout_ms)``, which returns when there is something to read or
        the time is up, and ``open()`` and ``close()``, which raise OSError.
        """

        def read(self, size: int) -> "bytes | None":
            """Read at most ``size`` bytes; None or b"": there are none. OSError: it is gone."""

        def write(self, data: "Buffer") -> "int | None":
            """Write the first bytes that fit; return how many. OSError: it is gone."""

except ImportError:  # MicroPython
    pass

AGENT_ADDRESS: Final = 0
_CHUNK: Final = 256
# Most chunks read after the timeout: a line that is never quiet must not block the program.
_CHUNKS: Final = 16
# The longest ACKNACK, HEARTBEAT or TIMESTAMP message.
_SHORT: Final = 32


class StreamTransport:
    """One board on a serial line.

    A frame that the port accepts only in part is kept, and its rest is sent first. Meanwhile
    reliable messages are queued, so that the line stays busy although most UARTs and USB devices
    buffer less than a frame; short ones are sent before them. Other messages, and those of which
    the port accepts nothing, are lost and counted in ``dropped``.

    Args:
        port: See `Port`.
        address: The board's address, 1 to 255, on a line that boards share.
        mtu: The largest message in bytes.
    """

    def __init__(self, port: "Any", address: int = 1, mtu: int = 512) -> None:
        self.port = port
        self.mtu = mtu
        self.dropped = 0
        self._address = address
        self.deframer = Deframer(address)  # its counters show the quality of the line
        self._out = bytearray(frame_size(mtu))
        self._from = 0  # _out[_from:_to] is not sent yet
        self._to = 0
        self._lasting = False  # whether _out holds a reliable message
        # Reliable messages behind it, where the session has them until they are acknowledged.
        self._late: "list[Buffer]" = []
        self._messages: "list[bytes]" = []

    def open(self) -> None:
        """Open the port, if it has ``open``. Raises OSError if that does."""
        self.deframer = Deframer(self._address)
        self._from = self._to = 0
        self._late.clear()
        self._messages.clear()
        if hasattr(self.port, "open"):
            self.port.open()

    def close(self) -> None:
        """Close the transport; idempotent."""
        if hasattr(self.port, "close"):
            self.port.close()

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without ``size``, all of the message.

        A queued reliable message stays in the session's buffer, which is kept until the agent has
        acknowledged the message. A buffer in use again by then is sent with its new content.
        """
        if size < 0:
            size = len(message)
        self._push()
        lasting = (
            size > 8
            and message[1] == STREAM_RELIABLE
            and (message[6] | message[7] << 8) + 8 == size  # one submessage
        )
        at = self._to
        if self._from == at:
            self._load(message, size, 0)
            self._lasting = lasting
        elif lasting and len(self._late) < WINDOW:
            if message not in self._late:  # the agent may ask for it before it has gone
                self._late.append(message)
        elif size <= _SHORT:
            self._load(message, size, at)
        else:
            self.dropped += 1
        self._push()

    def _load(self, message: "Buffer", size: int, at: int) -> None:
        """Write the message as a frame into ``_out[at:]``, if the frame fits; else drop it."""
        out: "Any" = self._out
        if at:
            out = memoryview(out)[at:]
        if size > self.mtu or frame_size(size) > len(out):
            self.dropped += 1
            return
        if not at:
            self._from = 0
        self._to = at + frame(message, self._address, AGENT_ADDRESS, out, size)

    def _push(self) -> None:
        """Send as many bytes as the port accepts now."""
        while True:
            if self._from == self._to:
                if not self._late:
                    return
                message = self._late[0]
                self._load(message, (message[6] | message[7] << 8) + 8, 0)
                self._lasting = True
                self._late.pop(0)
            sent = self.port.write(memoryview(self._out)[self._from : self._to])
            if sent:
                self._from += sent
            elif not self._from and not self._lasting:
                # The line has no reader: the message would be outdated when it has one.
                self._from = self._to
                self.dropped += 1
            if self._from < self._to:
                return

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`."""
        if self._messages:
            return self._messages.pop(0)
        end = ticks_add(ticks_ms(), timeout_ms)
        chunks = 0
        while True:
            self._push()
            data = self.port.read(_CHUNK)
            if data:
                self._messages = self.deframer.feed(data)
                if self._messages:
                    return self._messages.pop(0)
                chunks += 1
                if chunks < _CHUNKS:
                    continue
            left = ticks_diff(end, ticks_ms())
            if left <= 0:
                return None
            if data:
                continue
            if hasattr(self.port, "wait"):
                self.port.wait(left if self._from == self._to else 1)
            else:
                sleep_ms(1)
