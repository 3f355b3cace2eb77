"""A command on a terminal of its own, with keys."""

import fcntl
import os
import re
import select
import subprocess
import sys
import termios
import time

from support.paths import ROOT

SECONDS = 40
COMMAND = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    " from uros.tools.cli import main; sys.exit(main())"
)


class Terminal:
    """A process of ``uros`` whose terminal is a pseudo-terminal; a context manager.

    ``text`` is all that it has printed.
    """

    def __init__(self, *arguments, **variables):
        self._leader, follower = os.openpty()
        self.text = ""

        def own_terminal():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, *map(str, arguments)],
            stdin=follower, stdout=follower, stderr=follower, preexec_fn=own_terminal,
            env=dict(os.environ, PYTHONPATH=str(ROOT / "src"), **variables),
        )  # fmt: skip
        os.close(follower)

    def wait_for(self, pattern):
        """Wait until the pattern is in what was printed since the last call; return its match."""
        deadline = time.monotonic() + SECONDS
        begin = getattr(self, "_seen", 0)
        while not (match := re.compile(pattern).search(self.text, begin)):
            left = deadline - time.monotonic()
            assert left > 0 and self._read(left), f"no {pattern!r} in {self.text!r}"
        self._seen = match.end()
        return match

    def _read(self, seconds):
        if not select.select([self._leader], [], [], seconds)[0]:
            return False
        try:
            data = os.read(self._leader, 65536)
        except OSError:  # the process has ended
            data = b""
        self.text += data.decode("utf-8", "replace")
        return bool(data)

    def press(self, keys):
        """Type keys."""
        os.write(self._leader, keys.encode())

    def end(self, keys="\x03"):
        """Press Ctrl-C, or nothing; return the exit status."""
        if keys:
            self.press(keys)
        deadline = time.monotonic() + SECONDS
        while self._read(max(0.0, deadline - time.monotonic())):
            pass
        return self.process.wait(max(0.1, deadline - time.monotonic()))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self._leader)
