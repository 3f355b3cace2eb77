r"""Runs code on a board by MicroPython's raw REPL on its console line.

::

    repl = RawRepl(device_port("/dev/ttyACM0"))
    repl.enter()
    repl.run("import os; print(os.getcwd())")       -> '/\r\n'
    repl.leave()

MicroPython's documentation describes the protocol under "The MicroPython Interactive Interpreter
Mode (aka REPL)": Ctrl-C interrupts a program, Ctrl-A enters raw mode, Ctrl-D runs the code sent
(or, without code, does a soft reset), Ctrl-B returns to the friendly REPL. Code is sent in
raw-paste mode, which has flow control; where a board has no such mode, in small pieces.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from ...transport.serial_host import OpenPort

_INTERRUPT: Final = b"\r\x03"
_RAW: Final = b"\r\x01"
_FRIENDLY: Final = b"\r\x02"
_RUN: Final = b"\x04"
_PASTE: Final = b"\x05A\x01"
_BANNER: Final = b"raw REPL; CTRL-B to exit\r\n>"
_REBOOT: Final = b"soft reboot\r\n"


class Seconds(NamedTuple):
    """Timeouts for a board, in seconds."""

    enter: float = 12.0  # until its prompt comes
    attempt: float = 0.8  # for the answer to each Ctrl-A until then
    answer: float = 5.0  # for a few octets
    run: float = 30.0  # for a piece of code
    long: float = 120.0  # for a piece of code that reads many files
    back: float = 10.0  # until its USB device appears again
    # Attack: a device that takes almost the whole of each timeout, every time.
    whole: float = 1800.0  # for all its answers together


SECONDS: Final = Seconds()
# Attack: endless answers. A board without SHA-256 answers with a file's content in hex.
MAX_ANSWER: Final = 8 * 1024 * 1024
# Attack: endless permission to send, or permission for one octet at a time. Firmware permits at
# most two windows ahead of what it has read; its window is usually 128 octets.
_WINDOWS_AHEAD: Final = 4
_LONGEST_LINE: Final = 200
# Without raw-paste mode there is no flow control; a board's line may have a buffer of this size.
_PIECE: Final = 256
_PIECE_PAUSE: Final = 0.01
_READ: Final = 4096
_TAIL: Final = 4096


class ReplError(RuntimeError):
    """The board did not answer as expected; the text quotes its answer.

    ::

        RuntimeError
        └── ReplError
            ├── NoRepl        no REPL at the other end; `heard` is what was received instead
            ├── LineLost      the board stopped answering or reading
            │   └── LineGone  the device is gone
            ├── WrongAnswer   the answer is not MicroPython's
            └── Raised        the code raised; the text is the board's traceback
    """


class NoRepl(ReplError):
    """There is no REPL at the other end; ``heard`` is what was received instead."""

    def __init__(self, text: str, heard: bytes) -> None:
        super().__init__(text)
        self.heard = heard


class LineLost(ReplError):
    """The board stopped answering or reading before the timeout."""


class LineGone(LineLost):
    """The device is gone: its port reports an error."""


class WrongAnswer(ReplError):
    """The answer is not MicroPython's, or exceeds a limit."""


class Raised(ReplError):
    """The code raised; the text is the board's traceback, ``last`` its last line."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        lines = [line for line in text.splitlines() if line.strip()]
        self.last = lines[-1].strip()[:_LONGEST_LINE] if lines else ""


class RawRepl:
    """A board's raw REPL on an open port.

    The other end may be any device: time and size of all answers are limited, and methods raise no
    error but `ReplError`.
    """

    def __init__(self, port: OpenPort, seconds: Seconds | None = None) -> None:
        self.port = port
        self.seconds = seconds or SECONDS
        self._seconds_left = self.seconds.whole
        self._received = b""
        self._paste = True  # False after the board refused raw-paste mode

    # --- entering and leaving -------------------------------------------------------------

    def enter(
        self,
        seconds: float | None = None,
        fresh: bool = True,
        waiting: Callable[[], object] | None = None,
    ) -> None:
        """Interrupt the running program and enter raw mode.

        Args:
            seconds: Timeout, by default `Seconds.enter`.
            fresh: Whether to do a soft reset, which does not start main.py.
            waiting: Called once if the board does not answer soon.

        Raises:
            NoRepl: No prompt came before the timeout.
            ReplError: The line failed.
        """
        seconds = self.seconds.enter if seconds is None else seconds
        attempt = self.seconds.attempt
        begin = time.monotonic()
        heard = b""
        while True:
            # Repeated, since a program may catch the interrupt, or not take it at once.
            self._send(_INTERRUPT + _RAW)
            is_found, received = self._try_until(_BANNER, attempt, _TAIL)
            if is_found:
                break
            heard = (heard + received)[-_TAIL:]
            if time.monotonic() - begin > seconds:
                raise NoRepl(f"no MicroPython prompt in {seconds:g} s", heard)
            if waiting is not None and time.monotonic() - begin > 2 * attempt:
                waiting()
                waiting = None
        # Answers to further Ctrl-A may still be in transit.
        while self._try_until(_BANNER, 0.1, _TAIL)[0] and time.monotonic() - begin < seconds:
            pass
        self._received = b""
        if fresh:
            self._soft_reset(seconds)

    def _soft_reset(self, seconds: float) -> None:
        """Do a soft reset, which frees the memory of the program that ran."""
        try:
            self._send(_RUN)
            self._until(_REBOOT, "its soft reset", seconds)
            self._until(_BANNER, "its prompt after the soft reset", seconds)
        except LineGone:
            # The program had its own USB device; the firmware's device replaces it.
            self._reopen()
            self.enter(seconds, fresh=False)
        except LineLost:
            # boot.py may not return.
            self.enter(seconds, fresh=False)

    def _reopen(self) -> None:
        end = time.monotonic() + self.seconds.back
        while True:
            try:
                self.port.open()
                return
            except OSError as error:
                if time.monotonic() > end:
                    raise LineGone(f"it did not come back after its soft reset: {error}") from error
                time.sleep(0.1)

    def leave(self, restart: bool = False) -> None:
        """Return to the friendly REPL; with ``restart``, run boot.py and main.py again."""
        self._send(_FRIENDLY)
        self._until(b">>> ", "the prompt", self.seconds.answer)
        if restart:
            self._send(_RUN)

    # --- code -----------------------------------------------------------------------------

    def run(self, code: str, seconds: float | None = None) -> str:
        """Run code and return its output; raise Raised if the code raises.

        ``seconds`` is the timeout, by default `Seconds.run`.
        """
        seconds = self.seconds.run if seconds is None else seconds
        answer = self.seconds.answer
        self._hand_over(code.encode())
        output = self._until(_RUN, "the end of its output", seconds)
        error = self._until(_RUN, "the end of its errors", answer)
        self._until(b">", "its prompt", answer)
        if error:
            raise Raised(error.decode("utf-8", "replace"))
        return output.decode("utf-8", "replace")

    def _hand_over(self, code: bytes) -> None:
        if self._paste:
            self._send(_PASTE)
            answer = self._take(2)
            if answer == b"R\x01":
                return self._by_paste(code)
            if answer != b"R\x00":  # it read this as a new Ctrl-A and sends its banner
                self._until(_BANNER[-12:], "its prompt", self.seconds.answer)
            self._paste = False
        for at in range(0, len(code), _PIECE):
            self._send(code[at : at + _PIECE])
            time.sleep(_PIECE_PAUSE)
        self._send(_RUN)
        answer = self._take(2)
        if answer != b"OK":
            raise WrongAnswer(f"it answered {answer!r} to code, not OK")

    def _by_paste(self, code: bytes) -> None:
        """Send code with flow control.

        Each 0x01 from the board permits ``window`` more octets; 0x04 ends the transfer.
        """
        window = int.from_bytes(self._take(2), "little")
        if not window:
            raise WrongAnswer("it gives a window of 0 octets for code")
        permitted = window
        at = 0
        end = time.monotonic() + self.seconds.run
        while at < len(code):
            while permitted == 0 or self._received or self._poll():
                flag = self._take(1)
                if flag == b"\x01":
                    permitted += window
                    self._check_room(permitted, window)
                elif flag == _RUN:  # it reads no more: a syntax error, or no memory
                    self._send(_RUN)
                    return
                else:
                    raise WrongAnswer(f"it answered {flag!r} in the middle of code")
            if time.monotonic() > end:
                raise LineLost(
                    f"it has taken {at} of {len(code)} octets of code in {self.seconds.run:g} s"
                )
            piece = code[at : at + permitted]
            self._send(piece)
            permitted -= len(piece)
            at += len(piece)
        self._send(_RUN)
        while (flag := self._take(1)) != _RUN:
            if flag != b"\x01":
                raise WrongAnswer(f"it answered {flag!r} at the end of code")
            permitted += window
            self._check_room(permitted, window)

    @staticmethod
    def _check_room(permitted: int, window: int) -> None:
        if permitted > _WINDOWS_AHEAD * window:
            raise WrongAnswer("it asks for more and more code, and reads none")

    # --- octets ---------------------------------------------------------------------------

    def _send(self, data: bytes) -> None:
        view = memoryview(data)
        end = time.monotonic() + self.seconds.answer
        while view:
            try:
                done = self.port.write(view)
            except OSError as error:
                raise _gone(error) from error
            view = view[done:]
            if not view:
                return
            if not done:
                if time.monotonic() > end:
                    raise LineLost("it takes nothing more: the line is held (flow control?)")
                time.sleep(0.002)

    def _poll(self) -> bool:
        """Read what is available; return whether octets are buffered."""
        try:
            self._received += self.port.read(_READ) or b""
        except OSError as error:
            raise _gone(error) from error
        return bool(self._received)

    def _take(self, count: int) -> bytes:
        end = time.monotonic() + self.seconds.answer
        while len(self._received) < count:
            if not self._more(end):
                raise LineLost(f"it stopped answering ({self._received!r} was the last)")
        data, self._received = self._received[:count], self._received[count:]
        return data

    def _until(self, ending: bytes, awaited: str, seconds: float) -> bytes:
        """Return what comes before ``ending``, and discard ``ending``; LineLost at the timeout."""
        is_found, data = self._try_until(ending, seconds)
        if not is_found:
            tail = data[-60:].decode("utf-8", "replace")
            raise LineLost(f"waited {seconds:g} s for {awaited}; the last was {tail!r}")
        return data

    def _try_until(self, ending: bytes, seconds: float, keep: int = 0) -> tuple[bool, bytes]:
        """Return whether ``ending`` came, and what came before it.

        With ``keep``, only about the last ``keep`` octets are returned; without it, more than
        `MAX_ANSWER` octets raise WrongAnswer.
        """
        end = time.monotonic() + seconds
        parts: list[bytes] = []
        size = 0
        while (at := self._received.find(ending)) < 0:
            # Octets that may begin the ending stay in the buffer.
            cut = max(0, len(self._received) - len(ending) + 1)
            parts.append(self._received[:cut])
            size += cut
            self._received = self._received[cut:]
            if keep:
                parts, size = [b"".join(parts)[-keep:]], 0
            if size > MAX_ANSWER:
                raise WrongAnswer(f"its answer has more than {MAX_ANSWER} octets")
            # A program that prints all the time must not extend the timeout.
            if not self._more(end) or time.monotonic() > end:
                parts.append(self._received)
                self._received = b""
                return False, b"".join(parts)
        parts.append(self._received[:at])
        self._received = self._received[at + len(ending) :]
        return True, b"".join(parts)

    def _more(self, end: float) -> bool:
        """Wait for more octets; return False at the timeout ``end``."""
        before = len(self._received)
        while not self._poll() or len(self._received) == before:
            now = time.monotonic()
            if end - now <= 0:
                return False
            if self._seconds_left <= 0:
                raise LineLost(f"it has taken over {self.seconds.whole:g} s for its answers")
            try:
                self.port.wait(max(1, int(min(end - now, 0.5) * 1000)))
            except OSError as error:
                raise _gone(error) from error
            self._seconds_left -= time.monotonic() - now
        return True


def _gone(error: OSError) -> LineGone:
    return LineGone(f"the line ended: {error.strerror or error}")
