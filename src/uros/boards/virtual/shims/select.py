# mypy: disable-error-code="no-any-return"
"""MicroPython's ``select`` for streams with ``ioctl``, such as a CDCInterface or a socket.

It waits in the virtual board until the USB line, or the socket that was registered first, has an
event. MicroPython polls each stream in a loop instead, to the same effect.
"""

import struct

import _board  # type: ignore[import-not-found]
import _irq  # type: ignore[import-not-found]

try:
    from collections.abc import Iterator
    from typing import Any
except ImportError:
    pass

POLLIN = 1
POLLOUT = 4
POLLERR = 8
POLLHUP = 16
_STREAM_POLL = 3
_LONGEST_US = 1000000
_STATES = (
    (POLLIN, _board.USB_READABLE),
    (POLLOUT, _board.USB_WRITABLE),
    (POLLHUP, _board.USB_CLOSED),
)


class poll:
    """Waits for events of streams."""

    def __init__(self) -> None:
        self._streams: list[list[Any]] = []  # [stream, events]

    def register(self, stream: object, events: int = POLLIN | POLLOUT) -> None:
        """Add a stream, or change its events."""
        for entry in self._streams:
            if entry[0] is stream:
                entry[1] = events
                return
        self._streams.append([stream, events])

    def modify(self, stream: object, events: int) -> None:
        """Change the events of a stream; raise OSError where it is not registered."""
        for entry in self._streams:
            if entry[0] is stream:
                entry[1] = events
                return
        raise OSError(2)

    def unregister(self, stream: object) -> None:
        """Remove a stream."""
        self._streams = [entry for entry in self._streams if entry[0] is not stream]

    def poll(self, timeout: int = -1) -> "list[tuple[Any, int]]":
        """Return (stream, events) of each ready stream, after ``timeout`` ms at the latest."""
        wanted = 0
        for _, events in self._streams:
            for event, state in _STATES:
                if events & event:
                    wanted |= state
        start = -1
        while True:
            if _irq.handlers:
                _irq.run()
            ready = []
            for stream, events in self._streams:
                happened = stream.ioctl(_STREAM_POLL, events)
                if happened:
                    ready.append((stream, happened))
            if ready or timeout == 0:
                return ready
            left = _LONGEST_US
            if timeout > 0:
                now = _board.number(_board.TICKS_US)
                if start < 0:
                    start = now
                left = timeout * 1000 - ((now - start) & 0x3FFFFFFF)
                if left <= 0:
                    return ready
            left = min(left, _LONGEST_US)
            for stream, events in self._streams:
                if hasattr(stream, "net_wait"):  # a socket
                    stream.net_wait(left, events)
                    break
            else:
                _board.number(_board.USB_WAIT, struct.pack("<IB", left, wanted))

    def ipoll(self, timeout: int = -1, flags: int = 0) -> "Iterator[tuple[Any, int]]":
        """Return an iterator over the result of :meth:`poll`."""
        return iter(self.poll(timeout))
