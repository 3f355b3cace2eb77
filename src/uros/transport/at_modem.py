"""Base class of transports over AT modems: a non-blocking dialogue, and a send queue.

A modem answers a command after milliseconds, or after seconds while it joins a network. Therefore
the dialogue is a generator: it is resumed whenever the node asks for messages, and yields wherever
it has to wait. Runs on MicroPython.
"""

import errno

from ..ticks import sleep_ms, ticks_add, ticks_diff, ticks_ms

try:
    from typing import Any, Final, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

OK: Final = b"OK"
ERROR: Final = b"ERROR"

# Most final answers that are queued. Only noise on the line causes more.
_MOST_ANSWERS: Final = 8
# Most bytes of a modem's line that are parsed; the rest of a longer line is cut off.
_LINE: Final = 96
# Most reads after the timeout: a modem that never stops must not block the program.
_CHUNKS: Final = 16
# A modem that answers "busy" gets the command again after this time.
_BUSY_MS: Final = 20
# Longest wait for the modem to be silent: noise may never end.
_SETTLES_MS: Final = 1000


class ModemTransport:
    """Base of :class:`~.esp8266.Esp8266Transport` and :class:`~.gs2200.Gs2200Transport`.

    ``open`` begins to join the network and returns; ``linked`` tells whether the link to the agent
    is up. Of the messages sent before, all but the last are lost, as are those for which the send
    queue has no space; ``dropped`` counts both. ``malformed`` counts datagrams that the modem
    passed incompletely, ``mute`` answers that are missing. On a permanent failure ``receive`` and
    ``send`` raise OSError with the remedy, and the next ``open`` tries again.

    Args:
        mtu: The largest message in bytes.
        room: Bytes of the send queue.
    """

    def __init__(self, mtu: int, room: int) -> None:
        self.mtu = mtu
        self.linked = False
        self.dropped = 0
        self.malformed = 0
        self.mute = 0
        self._awake = False  # it has answered since it was opened
        self._is_open = False
        self._steps: "Iterator[None] | None" = None  # the dialogue; None after a failure
        self._gone = ""  # why the link is lost, as an unsolicited line of the modem reported
        self._answers: "list[bytes]" = []
        self._info = b""  # the last line of an answer before the final one
        self._line = bytearray(_LINE)
        self._length = 0  # of the line received so far
        # The datagram that is being received, its size, and the bytes still missing.
        self._in = bytearray(mtu)
        self._size = 0
        self._left = 0
        self._messages: "list[bytes]" = []
        # The send queue is _out[:_to]: messages, each behind its length of two bytes.
        self._out = bytearray(max(room, mtu + 2))
        self._to = 0
        self._quiet = True  # the last read returned nothing

    # --- methods of the subclass of a modem ---------------------------------------------------

    def _open(self) -> None:
        """Make the line to the modem ready.

        Raises:
            OSError: The line is not available.
        """

    def _close(self) -> None:
        """Close the link with one command; do not wait for its answer."""

    def _read(self) -> bool:
        """Process the bytes received; return whether there were any."""
        raise NotImplementedError

    def _wait(self, ms: int) -> None:
        """Wait until the modem sends something, at most ``ms``."""
        sleep_ms(1)

    def _put(self, data: "Buffer") -> "Any":
        """Send bytes to the modem; return False if it did not accept them in time."""
        raise NotImplementedError

    def _event(self, line: bytes) -> bool:
        """Return whether a line is unsolicited, and handle it."""
        raise NotImplementedError

    def _ends(self, line: bytes) -> bool:
        """Return whether a line is the final one of an answer."""
        raise NotImplementedError

    def _join(self) -> "Iterator[None]":
        """Join the network and open the link to the agent.

        Raises:
            OSError: A permanent failure; the message has the remedy.
        """
        raise NotImplementedError

    def _send_first(self, size: int) -> "Iterator[None]":
        """Send the first message of the queue.

        Raises:
            OSError: The link is lost, or too many messages have failed.
        """
        raise NotImplementedError

    # --- the transport ------------------------------------------------------------------------

    def open(self) -> None:
        """Begin to join the network.

        Raises:
            OSError: The line to the modem is not available.
        """
        self.close()
        self._gone = ""
        self._awake = False
        self._info = b""
        self._length = self._left = self._to = 0
        self._answers.clear()
        self._messages.clear()
        self._open()
        self._is_open = True
        self._steps = self._talk()

    def close(self) -> None:
        """Close the transport; idempotent. The modem stays in its network, to reopen quickly."""
        self._steps = None
        if self._is_open:
            self._is_open = False
            self._close()
        self.linked = False

    def send(self, message: "Buffer", size: int = -1) -> None:
        """Queue a message, see :class:`uros.client.protocols.Transport`; by default all of it."""
        if size < 0:
            size = len(message)
        if not self.linked and self._to:  # a ping of half a second ago
            self._to = 0
            self.dropped += 1
        if size > self.mtu or self._to + size + 2 > len(self._out):
            self.dropped += 1
            return
        at = self._to
        self._out[at] = size & 0xFF
        self._out[at + 1] = size >> 8
        self._out[at + 2 : at + 2 + size] = (
            message if len(message) == size else memoryview(message)[:size]
        )
        self._to = at + 2 + size
        if self._steps is None:
            raise OSError(errno.ENOTCONN, "the modem is not open")
        if self.linked:
            self._quiet = False  # no timeout may expire here: the line was not read
            self._step()

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`; this call resumes the dialogue."""
        if self._messages:
            return self._messages.pop(0)
        if self._steps is None:
            raise OSError(errno.ENOTCONN, "the modem is not open")
        end = ticks_add(ticks_ms(), timeout_ms)
        chunks = 0
        while True:
            self._quiet = not self._read()
            self._step()
            if self._messages:
                return self._messages.pop(0)
            chunks += 1
            if not self._quiet and chunks < _CHUNKS:
                continue
            left = ticks_diff(end, ticks_ms())
            if left <= 0:
                return None
            if self._quiet:
                self._wait(left)

    def _step(self) -> None:
        if self._gone:
            raise OSError(errno.ENOTCONN, self._gone)
        steps, self._steps = self._steps, None
        assert steps is not None
        next(steps)
        self._steps = steps  # not after an exception, which ends the generator

    def _talk(self) -> "Iterator[None]":
        """Yield during the whole dialogue with the modem: join, then send the queue for ever."""
        yield from self._join()
        self.linked = True
        while True:
            if not self._to:
                yield
            else:
                size = self._out[0] | self._out[1] << 8
                yield from self._send_first(size)
                self._pop(size + 2)

    def _pop(self, taken: int) -> None:
        """Remove the first message, of ``taken`` bytes, and move the others up.

        They are not moved later, when another message needs the space: at that time the modem may
        be reading a message of the queue.
        """
        view = memoryview(self._out)
        self._to -= taken
        view[: self._to] = view[taken : taken + self._to]

    def _first(self, size: int) -> "memoryview":
        """Return the first message of the queue."""
        return memoryview(self._out)[2 : 2 + size]

    # --- commands and answers -----------------------------------------------------------------

    def _ask(self, command: str, timeout_ms: int, good: bytes = OK) -> "Any":
        """Send a command; return whether its final answer is ``good``, None if there was none.

        ``_info`` is the last line before the answer.
        """
        end = ticks_add(ticks_ms(), timeout_ms)
        while True:
            self._answers.clear()
            self._info = b""
            taken = yield from self._put(command.encode() + b"\r\n")
            while True:
                answer = b""
                if taken is not False:
                    answer = yield from self._answer(end)
                if not answer:
                    self.mute += 1
                    return None
                if answer == good:
                    return True
                if answer.startswith(b"busy"):
                    break
                if answer != OK:
                    return False
            yield from self._pause(_BUSY_MS)

    def _answer(self, end: int) -> "Any":
        """Return the next final line of an answer; empty if there is none until ``end``."""
        while not self._answers:
            if self._quiet and ticks_diff(end, ticks_ms()) <= 0:
                return b""
            yield
        return self._answers.pop(0)

    def _pause(self, ms: int) -> "Iterator[None]":
        end = ticks_add(ticks_ms(), ms)
        while ticks_diff(end, ticks_ms()) > 0:
            yield

    def _settle(self, ms: int) -> "Iterator[None]":
        """Wait until the modem has sent nothing for ``ms``, at most _SETTLES_MS longer."""
        end = ticks_add(ticks_ms(), ms)
        last = ticks_add(end, _SETTLES_MS)
        while ticks_diff(end, ticks_ms()) > 0 and ticks_diff(last, ticks_ms()) > 0:
            yield
            if not self._quiet:
                end = ticks_add(ticks_ms(), ms)

    # --- receiving ----------------------------------------------------------------------------

    def _text(self, char: int) -> None:
        """Process one byte of a line."""
        if char != 10:
            if char != 13 and self._length < _LINE:
                self._line[self._length] = char
                self._length += 1
            return
        line = bytes(self._line[: self._length]).strip()
        self._length = 0
        if not line:
            return
        if self._ends(line):
            self._ended(line)
        elif not self._event(line):
            self._info = line

    def _ended(self, line: bytes) -> None:
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.append(line)

    def _datagram(self, size: int) -> None:
        """Begin to receive a datagram of ``size`` bytes."""
        self._size = self._left = size

    def _data(self, chunk: bytes, at: int) -> int:
        """Process the datagram's bytes in ``chunk[at:]``; return where they end."""
        count = min(self._left, len(chunk) - at)
        if self._size <= self.mtu:
            start = self._size - self._left
            self._in[start : start + count] = chunk[at : at + count]
        self._left -= count
        if not self._left:
            if self._size <= self.mtu:
                self._messages.append(bytes(self._in[: self._size]))
            else:
                self.malformed += 1
        return at + count
