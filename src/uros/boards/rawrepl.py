"""MicroPython's raw REPL: runs code on a board by the line of its console.

::

    repl = RawRepl(device_port("/dev/ttyACM0"))
    repl.enter()
    repl.run("import os; print(os.getcwd())")       -> '/\\r\\n'
    repl.leave()

What is sent is in MicroPython's documentation under "The MicroPython Interactive Interpreter Mode
(aka REPL)": Ctrl-C ends a program, Ctrl-A begins the raw mode, Ctrl-D runs what was sent (or, of
nothing, is a soft reset), Ctrl-B goes back. Code goes by raw paste, which the board slows down as
it needs, and where it has none in small pieces.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ..transport.device import OpenPort

_INTERRUPT: Final = b"\r\x03"
_RAW: Final = b"\r\x01"
_FRIENDLY: Final = b"\r\x02"
_RUN: Final = b"\x04"
_PASTE: Final = b"\x05A\x01"
_BANNER: Final = b"raw REPL; CTRL-B to exit\r\n>"
_REBOOT: Final = b"soft reboot\r\n"

ENTER_SECONDS: Final = 12.0
RUN_SECONDS: Final = 30.0
_TRY_SECONDS: Final = 0.8
_ANSWER_SECONDS: Final = 5.0
# Without raw paste nothing tells how fast a board reads. Its line may have a buffer of this size.
_PIECE: Final = 256
_PIECE_PAUSE: Final = 0.01
_READ: Final = 4096
_KEPT: Final = 4096
_BACK_SECONDS: Final = 10.0


class ReplError(RuntimeError):
    """The board does not do what it is to do; the text says what it said.

    ::

        RuntimeError
        └── ReplError
            ├── NoRepl      there is no REPL at the other end; `heard` is what came instead
            ├── LineLost    the line ended, or nothing comes any more
            └── Raised      the code raised; the text is the board's traceback
    """


class NoRepl(ReplError):
    def __init__(self, text: str, heard: bytes) -> None:
        super().__init__(text)
        self.heard = heard


class LineLost(ReplError):
    pass


class Raised(ReplError):
    def __init__(self, text: str) -> None:
        super().__init__(text)
        lines = [line for line in text.splitlines() if line.strip()]
        self.last = lines[-1].strip() if lines else ""


class RawRepl:
    """A board's raw REPL on an open port. Waits are bounded; all raise `ReplError`."""

    def __init__(self, port: OpenPort) -> None:
        self.port = port
        self._came = b""
        self._paste = True  # until the board has said that it knows none

    # --- in and out -----------------------------------------------------------------------

    def enter(
        self,
        seconds: float = ENTER_SECONDS,
        fresh: bool = True,
        waiting: Callable[[], object] | None = None,
    ) -> None:
        """End what runs and begin; with ``fresh``, after a soft reset that starts no main.py.

        ``waiting`` is called once where the board does not answer soon. Raises NoRepl.
        """
        begin = time.monotonic()
        heard = b""
        while True:
            # Again and again, since a program may catch it, or not be at the point to hear it.
            self._send(_INTERRUPT + _RAW)
            found, came = self._try_until(_BANNER, _TRY_SECONDS)
            if found:
                break
            heard = (heard + came)[-_KEPT:]
            if time.monotonic() - begin > seconds:
                raise NoRepl(f"no MicroPython prompt in {seconds:g} s", heard)
            if waiting is not None and time.monotonic() - begin > 2 * _TRY_SECONDS:
                waiting()
                waiting = None
        # An answer to each Ctrl-A may still be under way.
        while self._try_until(_BANNER, 0.1)[0] and time.monotonic() - begin < seconds:
            pass
        self._came = b""
        if fresh:
            self._soft_reset(seconds)

    def _soft_reset(self, seconds: float) -> None:
        """Frees the memory of the program that ran."""
        try:
            self._send(_RUN)
            self._until(_REBOOT, "its soft reset", seconds)
            self._until(_BANNER, "its prompt after the soft reset", seconds)
        except OSError:
            # A USB device of the program's own has gone, and the firmware's comes.
            self._reopen()
            self.enter(seconds, fresh=False)
        except LineLost:
            # boot.py may not end by itself.
            self.enter(seconds, fresh=False)

    def _reopen(self) -> None:
        end = time.monotonic() + _BACK_SECONDS
        while True:
            try:
                self.port.open()
                return
            except OSError as error:
                if time.monotonic() > end:
                    raise LineLost(f"it did not come back after its soft reset: {error}") from error
                time.sleep(0.1)

    def leave(self, restart: bool = False) -> None:
        """Back to the prompt for people; with ``restart``, boot.py and main.py start anew."""
        self._say(_FRIENDLY)
        self._wait_for(b">>> ", "the prompt")
        if restart:
            self._say(_RUN)

    # --- code -----------------------------------------------------------------------------

    def run(self, code: str, seconds: float = RUN_SECONDS) -> str:
        """Run it, and return what it printed. Raises Raised where it raises."""
        try:
            self._hand_over(code.encode())
            output = self._until(_RUN, "the end of its output", seconds)
            error = self._until(_RUN, "the end of its errors", _ANSWER_SECONDS)
            self._until(b">", "its prompt", _ANSWER_SECONDS)
        except OSError as gone:
            raise LineLost(f"the line ended: {gone.strerror or gone}") from gone
        if error:
            raise Raised(error.decode("utf-8", "replace"))
        return output.decode("utf-8", "replace")

    def _hand_over(self, code: bytes) -> None:
        if self._paste:
            self._send(_PASTE)
            answer = self._take(2)
            if answer == b"R\x01":
                return self._by_paste(code)
            if answer != b"R\x00":  # it took this for a new beginning, and says so
                self._until(_BANNER[-12:], "its prompt", _ANSWER_SECONDS)
            self._paste = False
        for at in range(0, len(code), _PIECE):
            self._send(code[at : at + _PIECE])
            time.sleep(_PIECE_PAUSE)
        self._send(_RUN)
        answer = self._take(2)
        if answer != b"OK":
            raise LineLost(f"it answered {answer!r} to code, not OK")

    def _by_paste(self, code: bytes) -> None:
        window = int.from_bytes(self._take(2), "little")
        room = window
        at = 0
        while at < len(code):
            while room == 0 or self._came or self._poll():
                flag = self._take(1)
                if flag == b"\x01":
                    room += window
                elif flag == _RUN:  # it will hear no more: a syntax error, or memory
                    self._send(_RUN)
                    return
                else:
                    raise LineLost(f"it answered {flag!r} in the middle of code")
            piece = code[at : at + room]
            self._send(piece)
            room -= len(piece)
            at += len(piece)
        self._send(_RUN)
        while (flag := self._take(1)) != _RUN:
            if flag != b"\x01":
                raise LineLost(f"it answered {flag!r} at the end of code")

    # --- octets ---------------------------------------------------------------------------

    def _say(self, data: bytes) -> None:
        try:
            self._send(data)
        except OSError as gone:
            raise LineLost(f"the line ended: {gone.strerror or gone}") from gone

    def _wait_for(self, ending: bytes, what: str) -> None:
        try:
            self._until(ending, what, _ANSWER_SECONDS)
        except OSError as gone:
            raise LineLost(f"the line ended: {gone.strerror or gone}") from gone

    def _send(self, data: bytes) -> None:
        view = memoryview(data)
        end = time.monotonic() + _ANSWER_SECONDS
        while view:
            done = self.port.write(view)
            view = view[done:]
            if not view:
                return
            if not done:
                if time.monotonic() > end:
                    raise LineLost("it takes nothing more: the line is held (flow control?)")
                time.sleep(0.002)

    def _poll(self) -> bool:
        """Whether something has come."""
        self._came += self.port.read(_READ) or b""
        return bool(self._came)

    def _take(self, count: int) -> bytes:
        end = time.monotonic() + _ANSWER_SECONDS
        while len(self._came) < count:
            if not self._more(end):
                raise LineLost(f"it stopped answering ({self._came!r} was the last)")
        data, self._came = self._came[:count], self._came[count:]
        return data

    def _until(self, ending: bytes, what: str, seconds: float) -> bytes:
        """What comes before ``ending``, which is taken as well."""
        found, data = self._try_until(ending, seconds)
        if not found:
            tail = data[-60:].decode("utf-8", "replace")
            raise LineLost(f"waited {seconds:g} s for {what}; the last was {tail!r}")
        return data

    def _try_until(self, ending: bytes, seconds: float) -> tuple[bool, bytes]:
        end = time.monotonic() + seconds
        while (at := self._came.find(ending)) < 0:
            # A program that prints all the time gives no pause either.
            if not self._more(end) or time.monotonic() > end:
                data, self._came = self._came, b""
                return False, data
        data, self._came = self._came[:at], self._came[at + len(ending) :]
        return True, data

    def _more(self, end: float) -> bool:
        """Wait for octets; False at the end of the time."""
        while not self._poll():
            left = end - time.monotonic()
            if left <= 0:
                return False
            self.port.wait(max(1, int(min(left, 0.5) * 1000)))
        return True
