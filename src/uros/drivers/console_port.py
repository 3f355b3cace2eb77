"""The line of the console as the line to the agent, for boards that have no other.

::

    from uros.drivers.console_port import ConsolePort
    from uros.transport.serial import StreamTransport

    node = Node("talker", StreamTransport(ConsolePort()))

Frames contain any octet, so Ctrl-C must not interrupt the program by itself. This port raises
KeyboardInterrupt for a Ctrl-C outside of frames: so ``uros board deploy`` and a terminal end the
program as usual, while it spins. The agent skips what the program prints between its frames.
"""

import select
import sys

import micropython

try:
    from typing import Any, Final
except ImportError:
    pass

_INTERRUPT: Final = 3
_FLAG: Final = 0x7E
_ESCAPE: Final = 0x7D
# Source, destination and length; behind the payload is the checksum.
_HEAD: Final = 4
_TAIL: Final = 2
_AGENT: Final = 0  # the source of an agent's frames; no text begins with it
_LONGEST: Final = 2048  # of a payload: a longer one is no frame


class ConsolePort:
    """A port of `uros.transport.serial.StreamTransport`: read and write on the console's line.

    Args:
        stdin: The console's input, with ``buffer``; by default ``sys.stdin``.
        stdout: The console's output, with ``buffer``; by default ``sys.stdout``.
    """

    def __init__(self, stdin: "Any" = None, stdout: "Any" = None) -> None:
        stdin = stdin or sys.stdin
        self._in: "Any" = stdin.buffer
        self._out: "Any" = (stdout or sys.stdout).buffer
        self._poll = select.poll()
        self._poll.register(stdin, select.POLLIN)
        self._octet = bytearray(1)
        self._reset()

    def _reset(self) -> None:
        self._at = -1  # octets of a frame behind its flag; -1 outside of frames
        self._size = 0
        self._escaped = False

    def open(self) -> None:
        """Take the line: from now on Ctrl-C is found by :meth:`read`."""
        micropython.kbd_intr(-1)
        self._reset()

    def close(self) -> None:
        """Give the line back: Ctrl-C interrupts the program again."""
        micropython.kbd_intr(_INTERRUPT)

    def read(self, size: int) -> "bytes | None":
        """Return at most ``size`` octets; None if there are none.

        Raises:
            KeyboardInterrupt: Ctrl-C came outside of a frame.
        """
        out = bytearray()
        while len(out) < size and self._poll.poll(0):
            if not self._in.readinto(self._octet):
                break
            octet = self._octet[0]
            self._follow(octet)
            out.append(octet)
        return bytes(out) if out else None

    def _follow(self, octet: int) -> None:
        """Follow the frames; raise KeyboardInterrupt for Ctrl-C outside of them."""
        if octet == _FLAG:
            self._reset()
            self._at = 0
            return
        if octet == _ESCAPE:
            self._escaped = True
            return
        if self._at < 0 or (self._at == 0 and octet != _AGENT):
            self._reset()
            if octet == _INTERRUPT:
                self.close()
                raise KeyboardInterrupt
            return
        if self._escaped:
            self._escaped = False
            octet ^= 0x20
        self._at += 1
        if self._at == _HEAD - 1:
            self._size = octet
        elif self._at == _HEAD:
            self._size |= octet << 8
        if self._size > _LONGEST or self._at == _HEAD + self._size + _TAIL:
            self._reset()

    def write(self, data: "Any") -> int:
        """Write octets; return how many were taken."""
        count: int = self._out.write(data)
        return count

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is something to read, or the time is up."""
        self._poll.poll(timeout_ms)
