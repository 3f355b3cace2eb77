"""A board on a serial device: MicroPython's real REPL behind a pseudo-terminal.

    with ReplBoard() as board:
        RawRepl(device_port(board.path)) ...
        board.unplug()

``repl.mjs`` says which parts of the board are modelled.
"""

import os
import select
import subprocess
import threading
import tty
from pathlib import Path

from mpy.harness import INSTALLED, MODULE


class ReplBoard:
    """A board that ``with`` plugs in and starts; ``path`` is its serial device."""

    def __init__(self, paste: str = "1") -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # open until unplug, so that the line stays when a client closes it
        self.path = os.ttyname(self._slave)
        self.cut_after: int | None = None  # number of octets to the board until the cable is pulled
        self._plugged = True
        self._stop, self._stopped = os.pipe()
        runner = Path(__file__).with_name("repl.mjs")
        line, self._line = os.pipe()
        os.set_blocking(line, False)
        try:
            self._process = subprocess.Popen(
                [INSTALLED / "node", runner, MODULE, paste], stdin=line, stdout=subprocess.PIPE
            )
        finally:
            os.close(line)
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def __enter__(self) -> "ReplBoard":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._stopped)
        self._thread.join()
        self._process.kill()
        self._process.communicate()
        os.close(self._line)
        os.close(self._stop)
        self.unplug()

    def unplug(self) -> None:
        """Remove the serial device; the board keeps its power."""
        if self._plugged:
            self._plugged = False
            os.close(self._slave)
            os.close(self._master)

    def plug(self) -> str:
        """Plug the board in again, on a new serial device; return its path."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._plugged = True
        return self.path

    def say(self, data: bytes) -> None:
        """Send octets from the board."""
        os.write(self._master, data)

    def _carry(self) -> None:
        assert self._process.stdout
        board = self._process.stdout.fileno()
        while True:
            line = [self._master] if self._plugged else []
            ready = select.select([self._stop, board, *line], [], [], 0.05)[0]
            if self._stop in ready:
                return
            if board in ready:
                data = os.read(board, 4096)
                if not data:
                    return
                if self._plugged:
                    os.write(self._master, data)
            if line and line[0] in ready and self._plugged:
                data = os.read(self._master, 4096)
                if self.cut_after is not None:
                    data = data[: self.cut_after]
                    self.cut_after -= len(data)
                try:
                    while data:
                        data = data[os.write(self._line, data) :]
                except BrokenPipeError:
                    return
                if self.cut_after == 0:
                    self.cut_after = None
                    self.unplug()
