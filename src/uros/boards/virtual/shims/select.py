# mypy: disable-error-code="no-any-return"
"""MicroPython's ``select`` for streams that answer ``ioctl``, such as a CDCInterface or a socket.

It waits in the virtual board, which wakes it when the USB line, or the socket that was registered
first, has something to say. MicroPython asks each stream in a loop instead, to the same effect.
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
    def __init__(self) -> None:
        self._streams: list[list[Any]] = []  # [stream, events]

    def register(self, stream: object, events: int = POLLIN | POLLOUT) -> None:
        for entry in self._streams:
            if entry[0] is stream:
                entry[1] = events
                return
        self._streams.append([stream, events])

    def modify(self, stream: object, events: int) -> None:
        for entry in self._streams:
            if entry[0] is stream:
                entry[1] = events
                return
        raise OSError(2)

    def unregister(self, stream: object) -> None:
        self._streams = [entry for entry in self._streams if entry[0] is not stream]

    def poll(self, timeout: int = -1) -> "list[tuple[Any, int]]":
        """(stream, events) of each that is ready, after ``timeout`` milliseconds at the latest."""
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
                found = stream.ioctl(_STREAM_POLL, events)
                if found:
                    ready.append((stream, found))
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
        return iter(self.poll(timeout))
