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

# Lines that end answers and nobody has looked at yet. More come from noise only.
_MOST_ANSWERS: Final = 8
# Text of a modem's line that is looked at; what is longer is cut.
_LINE: Final = 96
# Most reads after the timeout: a modem that never stops must not block the program.
_CHUNKS: Final = 16
# A modem that works on something says so, and is asked again after this time.
_BUSY_MS: Final = 20
# Who waits for it to be silent does so no longer than this: noise may never end.
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
        self._steps: "Iterator[None] | None" = None  # the dialogue, until something breaks it off
        self._gone = ""  # what the modem has said of its own accord
        self._answers: "list[bytes]" = []
        self._said = b""  # the last line that ends no answer
        self._line = bytearray(_LINE)
        self._length = 0  # of the line so far
        # The datagram that comes in.
        self._in = bytearray(mtu)
        self._size = 0
        self._left = 0
        self._messages: "list[bytes]" = []
        # What waits to be sent, each message behind its length, in _out[:_to].
        self._out = bytearray(max(room, mtu + 2))
        self._to = 0
        self._quiet = True  # nothing has come in this turn

    # --- what a modem does in its own way -----------------------------------------------------

    def _open(self) -> None:
        """Make the line to the modem ready. Raises OSError."""

    def _close(self) -> None:
        """The end of a link, in a word and without waiting."""

    def _read(self) -> bool:
        """Take what has come; whether anything has."""
        raise NotImplementedError

    def _wait(self, ms: int) -> None:
        """Until something comes, or so long."""
        sleep_ms(1)

    def _put(self, data: "Buffer") -> "Any":
        """Give bytes to the modem. False: it did not take them in time."""
        raise NotImplementedError

    def _event(self, line: bytes) -> bool:
        """Whether a line tells of something that nobody has asked for."""
        raise NotImplementedError

    def _ends(self, line: bytes) -> bool:
        """Whether a line ends an answer."""
        raise NotImplementedError

    def _join(self) -> "Iterator[None]":
        """The way to the agent. Raises OSError."""
        raise NotImplementedError

    def _send_first(self, size: int) -> "Iterator[None]":
        """Send the first message of the queue. Raises OSError."""
        raise NotImplementedError

    # --- the transport ------------------------------------------------------------------------

    def open(self) -> None:
        """Begin to join. Raises OSError where there is no line to the modem."""
        self.close()
        self._gone = ""
        self._awake = False
        self._said = b""
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
        """See :class:`uros.client.protocols.Transport`. Without ``size``, all of the message."""
        if size < 0:
            size = len(message)
        if not self.linked and self._to:  # a question of half a second ago
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
            self._quiet = False  # which says that no time is up: nobody has looked
            self._step()

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`. This takes the dialogue on."""
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
        self._steps = steps  # it goes on; after whatever it may have raised, it cannot

    def _talk(self) -> "Iterator[None]":
        """All that is ever said to the modem."""
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
        """Drop the first message, and move up the others.

        They are moved here and not when space is needed for another one: then the modem may be
        taking a message out of the queue.
        """
        view = memoryview(self._out)
        self._to -= taken
        view[: self._to] = view[taken : taken + self._to]

    def _first(self, size: int) -> "memoryview":
        """The first message of the queue."""
        return memoryview(self._out)[2 : 2 + size]

    # --- commands and answers -----------------------------------------------------------------

    def _ask(self, command: str, timeout_ms: int, good: bytes = OK) -> "Any":
        """Send a command; return whether its final answer is ``good``, None if there was none.

        ``_said`` is the last line before the answer.
        """
        end = ticks_add(ticks_ms(), timeout_ms)
        while True:
            self._answers.clear()
            self._said = b""
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
        """The next line that ends an answer; none when the time is up and all is read."""
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
        """Until the modem has said nothing for so long."""
        end = ticks_add(ticks_ms(), ms)
        last = ticks_add(end, _SETTLES_MS)
        while ticks_diff(end, ticks_ms()) > 0 and ticks_diff(last, ticks_ms()) > 0:
            yield
            if not self._quiet:
                end = ticks_add(ticks_ms(), ms)

    # --- what comes ---------------------------------------------------------------------------

    def _text(self, char: int) -> None:
        """One byte of a line."""
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
            self._said = line

    def _ended(self, line: bytes) -> None:
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.append(line)

    def _datagram(self, size: int) -> None:
        """One of so many bytes follows."""
        self._size = self._left = size

    def _data(self, chunk: bytes, at: int) -> int:
        """Bytes of a datagram from ``at`` on; where they end."""
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
