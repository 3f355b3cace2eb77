"""An agent as a child process, on a board's line. It ends with its parent, however that ends."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import IO, Any, Final

_END_SECONDS: Final = 5.0


class AgentProcess:
    """``uros agent serial`` on ``device``, in ``domain``. Its log goes to ``log``: by default to
    where ours goes, ``subprocess.PIPE`` makes it :attr:`lines`."""

    def __init__(self, device: Path, domain: int, log: int | None = None) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", "serial", "--dev", str(device),
             "--domain", str(domain), "--stop-at-eof"],
            stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT if log else None,
            text=True, encoding="utf-8",
            start_new_session=True,  # Ctrl-C is for us: the board goes first
        )  # fmt: skip

    @property
    def lines(self) -> IO[Any]:
        """The log, line by line."""
        assert self._process.stdout is not None
        return self._process.stdout

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        """End it, kindly at first. Twice is once."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
