"""A board's end of a serial line: frames over anything that reads and writes bytes.

Runs on MicroPython: a UART, a USB-CDC interface and a terminal's file all do.
"""

from ..ticks import sleep_ms, ticks_ms
from ..wire.framing import Deframer, frame, frame_size
from ..wire.streams import ticks_add, ticks_diff

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


class StreamTransport:
    """One board on a line. ``address`` is its own, 1 to 255, on a line that boards share.

    What the line takes only in part is kept and goes out first; messages that come meanwhile, and
    those of which it takes nothing, are lost and counted in ``dropped``: reliable ones are sent
    again.
    """

    def __init__(self, port: "Any", address: int = 1, mtu: int = 512) -> None:
        self.port = port
        self.mtu = mtu
        self.dropped = 0
        self._address = address
        self.deframer = Deframer(address)  # its counters tell how good the line is
        self._out = bytearray(frame_size(bytes(mtu)))
        self._from = 0  # _out[_from:_to] is not sent yet
        self._to = 0
        self._messages: "list[bytes]" = []

    def open(self) -> None:
        """Raises OSError where the port has an ``open`` that does."""
        self.deframer = Deframer(self._address)
        self._from = self._to = 0
        self._messages.clear()
        if hasattr(self.port, "open"):
            self.port.open()

    def close(self) -> None:
        """Twice is once."""
        if hasattr(self.port, "close"):
            self.port.close()

    def send(self, message: "Buffer") -> None:
        """See :class:`uros.client.connection.Transport`."""
        self._push()
        if self._from < self._to or len(message) > self.mtu:
            self.dropped += 1
            return
        self._from = 0
        self._to = frame(message, self._address, AGENT_ADDRESS, self._out)
        self._push()

    def _push(self) -> None:
        if self._from < self._to:
            sent = self.port.write(memoryview(self._out)[self._from : self._to])
            if sent:
                self._from += sent
            elif not self._from:  # nobody listens: what was to be said then is old when they do
                self._to = 0
                self.dropped += 1

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.connection.Transport`."""
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
