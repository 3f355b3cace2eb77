"""An agent in a child process, for virtual boards. It ends with its parent, however that ends."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Final

_END_SECONDS: Final = 5.0


class AgentProcess:
    """Runs ``uros agent`` in a child process.

    Args:
        arguments: Its arguments, such as ``("serial", "--dev", "/dev/ttyACM0")``.
        domain: The ROS domain of its boards.
        on_line: Called from another thread with each line of its log.
    """

    def __init__(
        self, arguments: Sequence[str], domain: int, on_line: Callable[[str], object]
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", *arguments, "--domain", str(domain),
             "--stop-at-eof"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, encoding="utf-8",
            start_new_session=True,  # Ctrl-C must not end it: the boards end first
        )  # fmt: skip
        self._on_line = on_line
        self._reader = threading.Thread(target=self._read, name="agent", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._on_line(line.rstrip())

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether the process has ended."""
        # Not by Popen.poll(): a signal handler that raises in it, as those of `stop_signals` do,
        # can leave the lock of Popen taken, and close() would wait for ever.
        return not self._reader.is_alive()

    def close(self) -> None:
        """End the process and wait for the rest of its log. Idempotent."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        self._process.stdout.close()
