"""A board's end of a serial line: frames over anything that reads and writes bytes.

Runs on MicroPython: a UART, a USB-CDC interface and a terminal's file all do.
"""

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms
from ..wire.framing import Deframer, frame, frame_size
from ..wire.ids import STREAM_RELIABLE
from ..wire.streams import WINDOW

try:
    from typing import Any, Final, Protocol

    from ..wire.cdr import Buffer

    class Port(Protocol):
        """What :class:`StreamTransport` needs of a line. Neither call waits.

        A port may have ``wait(timeout_ms)``, which returns when there is something to read or
        the time is up, and ``open()`` and ``close()``, which raise OSError.
        """

        def read(self, size: int) -> "bytes | None":
            """At most ``size`` bytes; None or none: nothing is there. OSError: it is gone."""

        def write(self, data: "Buffer") -> "int | None":
            """How many bytes the line took, from the first on. OSError: it is gone."""

except ImportError:  # MicroPython
    pass

AGENT_ADDRESS: Final = 0
_CHUNK: Final = 256
# What waits in the line is not late, but a line that is never quiet must not hold a program up.
_CHUNKS: Final = 16
# A longest acknowledgement, heartbeat or question about the time.
_SHORT: Final = 32


class StreamTransport:
    """One board on a line. ``address`` is its own, 1 to 255, on a line that boards share.

    What the line takes only in part is kept and goes out first. Of the messages that come
    meanwhile, reliable ones wait their turn, so that a line is kept busy by what has room for less
    than a frame, as most UARTs and USB devices; short ones go before them. Others, and those of
    which the line takes nothing, are lost and counted in ``dropped``.
    """

    def __init__(self, port: "Any", address: int = 1, mtu: int = 512) -> None:
        self.port = port
        self.mtu = mtu
        self.dropped = 0
        self._address = address
        self.deframer = Deframer(address)  # its counters tell how good the line is
        self._out = bytearray(frame_size(mtu))
        self._from = 0  # _out[_from:_to] is not sent yet
        self._to = 0
        self._lasting = False  # what is in _out is a reliable message
        # Reliable messages behind it, where the session has them until they are acknowledged.
        self._late: "list[Buffer]" = []
        self._messages: "list[bytes]" = []

    def open(self) -> None:
        """Raises OSError where the port has an ``open`` that does."""
        self.deframer = Deframer(self._address)
        self._from = self._to = 0
        self._late.clear()
        self._messages.clear()
        if hasattr(self.port, "open"):
            self.port.open()

    def close(self) -> None:
        """Twice is once."""
        if hasattr(self.port, "close"):
            self.port.close()

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without a size, all of it.

        A reliable message is left in its buffer until the line has room; a session keeps that until
        the agent has acknowledged it. One that is in use again by then is sent as it is.
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
        """Frame it into ``_out[at:]``, if it fits."""
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
        """Send what the line takes now."""
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
                # Nobody listens: what was to be said then is old when they do.
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
