"""Log lines in the columns of the C++ agent or as JSON, and limits on how many.

A line::

    [1763750000.123456] info     | ProxyClient        | create_topic             | topic created                  | client_key: 0x4B0CBE99, topic_id: 0x000(2), participant_id: 0x000(1)

Time, level, part, function, event, and what it concerns. The levels of
``-v``: 0 off, 1 critical, 2 error, 3 warning, 4 info, 5 debug (every message's
length), 6 trace (its bytes).

As JSON, a line is an object with these members as texts; ``client_key`` is there if the line
concerns one client::

    {"time": "2025-11-21T18:33:20.123456Z", "level": "info", "part": "ProxyClient", "function": "create_topic", "event": "topic created", "client_key": "0x4B0CBE99", "about": "client_key: …"}
"""  # noqa: E501

from __future__ import annotations

import errno
import json
import os
import queue
import re
import select
import sys
import threading
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Final, TextIO

from ..printable import printable, printable_ascii, unguarded
from ..token_bucket import KeyedTokenBuckets, TokenBucket
from .clock import Clock

# The name of the whole package: uros.
_PACKAGE: Final = __name__.partition(".")[0]

CRITICAL: Final = 1
ERROR: Final = 2
WARNING: Final = 3
INFO: Final = 4
DEBUG: Final = 5
TRACE: Final = 6

_NAMES = ("off", "critical", "error", "warning", "info", "debug", "trace")
_COLOURS = ("", "\033[1;41m", "\033[1;31m", "\033[1;33m", "\033[32m", "\033[36m", "\033[37m")


# A line concerns a client if its text begins so: elsewhere a name of a client could look like it.
_CLIENT: Final = re.compile(r"client_key: (0x[0-9A-F]{8})(?![0-9A-Za-z])")

# Lines of faults in a second, of all kinds together.
MAX_LINES: Final = 50
# Lines that may wait for a terminal or pipe that takes none; further lines are lost.
_MAX_WAITING: Final = 10_000
_MAX_CHARACTERS: Final = 16 * 1024 * 1024
# The most lines of level info at once, and in a second, because clients may connect and leave, or
# create and delete objects, as fast as they can. -v 5 logs all lines.
_INFO_BURST: Final = 5000
_INFO_RATE: Final = 500
# The longest ``about`` of a line in characters, because names may have 64 kB. The bytes of messages
# (-v 6) are not cut.
_MAX_ABOUT: Final = 2000
# Errors of a file that may be temporary: the disk is full, or the quota or file size is exceeded.
_TEMPORARY: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BLOCKED_SECONDS: Final = 0.1
# After so many seconds without a line, a full disk is tried with the notice of the lost lines.
_RETRY_SECONDS: Final = 5.0
_NEWLINE: Final = 0x0A
# The most kinds of faults whose throttled lines are counted, because a client may cause ever new
# kinds.
_MAX_KINDS: Final = 512


class Log:
    """Writes log lines to a stream.

    A thread writes to a stream that can block (a file, a pipe, a terminal that was stopped with
    Ctrl-S): boards must not wait for readers of logs. Lines are lost while the disk is full; when
    there is room again, a line says how many.

    Args:
        level: The highest level that is written.
        stream: By default standard output.
        clock: The time of the lines.
        as_json: Whether a line is a JSON object instead of columns.
    """

    def __init__(
        self, level: int = INFO, stream: TextIO | None = None, clock: Clock | None = None,
        as_json: bool = False,
    ) -> None:  # fmt: skip
        self.level = level
        self._as_json = as_json
        self._clock = clock or Clock()
        self._stream = unguarded(stream or sys.stdout)
        self._colour = self._stream.isatty()
        self._waiting: queue.Queue[str | None] = queue.Queue(_MAX_WAITING)
        self._thread: threading.Thread | None = None
        self._lost = 0
        self._info_limit = TokenBucket(_INFO_BURST, _INFO_RATE)
        self._left_out = 0
        self._put = 0  # characters queued, counted by the logging thread
        self._taken = 0  # characters written, counted by the writing thread
        self._fd = -1
        self._torn = False  # whether the last byte written is not the end of a line
        self._untaken = 0  # lines that the stream has not taken since the last one
        self._why = ""  # why the last line was not written
        try:
            self._stream.flush()
            self._fd = self._stream.fileno()
        except (OSError, ValueError):
            return
        self._thread = threading.Thread(target=self._drain, name="uros-log", daemon=True)
        self._thread.start()

    def __call__(self, level: int, part: str, function: str, event: str, about: str = "") -> None:
        """Write a line if its level is enabled.

        Args:
            level: The level of the line.
            part: The class or module, as in the C++ agent.
            function: What it was doing.
            event: The event, as in the C++ agent.
            about: What it concerns.
        """
        if level > self.level:
            return
        if level == INFO == self.level and not self._admit_info():
            return
        if level < DEBUG and len(about) > _MAX_ABOUT:
            about = f"{about[:_MAX_ABOUT]}... ({len(about)} characters)"
        clock = self._clock
        if self._left_out and (level != INFO or self._info_limit.available(clock.monotonic()) > 1):
            about += f" ({self._left_out} lines of info were left out before: too many at once)"
            self._left_out = 0
        line = self._line(level, part, function, event, about)
        if self._thread is None:
            self._write(line)
            return
        try:
            if self._put - self._taken > _MAX_CHARACTERS:
                raise queue.Full
            self._waiting.put_nowait(line)
            self._put += len(line)
        except queue.Full:
            self._lost += 1

    def _line(self, level: int, part: str, function: str, event: str, about: str) -> str:
        """Return a line with its end, in ASCII, without effect on a terminal."""
        seconds, micros = divmod(self._clock.time_ns() // 1000, 1_000_000)
        if self._as_json:
            moment = datetime.fromtimestamp(seconds, timezone.utc)
            content = {
                "time": f"{moment:%Y-%m-%dT%H:%M:%S}.{micros:06d}Z", "level": _NAMES[level],
                "part": part, "function": function, "event": printable(event),
            }  # fmt: skip
            if client := _CLIENT.match(about):
                content["client_key"] = client[1]
            return json.dumps({**content, "about": printable(about)}) + "\n"
        name = f"{_NAMES[level]:<8}"
        if self._colour:
            name = f"{_COLOURS[level]}{name}\033[0m"
        return (
            f"[{seconds}.{micros:06d}] {name} | {part:<18} | {function:<24} |"
            f" {printable_ascii(event):<30} | {printable_ascii(about)}".rstrip()
            + "\n"
        )

    def _lost_lines(self, count: int, why: str) -> str:
        """Return a line that tells how many were lost."""
        text = f"{count} lines of the log were lost: {why}"
        return (
            self._line(WARNING, "Log", "write", "lines lost", text)
            if self._as_json
            else f"({text})\n"
        )

    def _admit_info(self) -> bool:
        if self._info_limit.take(self._clock.monotonic()):
            return True
        self._left_out += 1
        return False

    def trouble(self) -> str:
        """Return why lines of the log are lost now; "" if they are written."""
        why = self._why or ("nobody is reading" if self._lost else "")
        return f"lines of the log are lost: {why}" if why else ""

    def _drain(self) -> None:
        while True:
            try:
                line = self._waiting.get(timeout=_RETRY_SECONDS if self._untaken else None)
            except queue.Empty:
                line = ""
            if line is None:
                return
            self._write(line)
            self._taken += len(line)
            if self._lost and self._waiting.empty():
                lost, self._lost = self._lost, 0
                self._write(self._lost_lines(lost, "nobody was reading"))

    def _write(self, line: str) -> None:
        try:
            if self._fd < 0:
                self._stream.write(line)
                self._stream.flush()
                self._why = ""
                return
            head = "\n" if self._torn else ""
            if self._untaken:
                head += self._lost_lines(self._untaken, self._why)
            self._put_out((head + line).encode("ascii", "backslashreplace"))
            self._untaken = 0
            self._why = ""
        except (OSError, ValueError) as error:
            self._why = getattr(error, "strerror", None) or str(error)
            if isinstance(error, OSError) and error.errno in _TEMPORARY:
                self._untaken += bool(line)
            else:
                self.level = 0  # nobody reads the log any more; the agent continues without it

    def _put_out(self, data: bytes) -> None:
        """Write to the descriptor: the stream's buffer would keep what the disk did not take."""
        view = memoryview(data)
        while view:
            try:
                done = os.write(self._fd, view)
            except BlockingIOError:  # another user of the file has set O_NONBLOCK
                select.select([], [self._fd], [], _BLOCKED_SECONDS)
                continue
            self._torn = view[done - 1] != _NEWLINE
            view = view[done:]

    def close(self) -> None:
        """Write waiting lines for at most a second; nothing is written afterwards."""
        if self._thread is not None:
            self.level = 0
            try:
                self._waiting.put_nowait(None)
            except queue.Full:
                return
            self._thread.join(1.0)

    def info(self, part: str, function: str, event: str, about: str = "") -> None:
        """Log a line of the level info."""
        self(INFO, part, function, event, about)

    def warning(self, part: str, function: str, event: str, about: str = "") -> None:
        """Log a line of the level warning."""
        self(WARNING, part, function, event, about)

    def error(self, part: str, function: str, event: str, about: str = "") -> None:
        """Log a line of the level error."""
        self(ERROR, part, function, event, about)

    def debug(self, part: str, function: str, event: str, about: str = "") -> None:
        """Log a line of the level debug."""
        self(DEBUG, part, function, event, about)


def unexpected(error: Exception, where: str = "") -> str:
    """Return the text for an unexpected error; ``where``, with a leading space, follows it."""
    advice = "this is a fault of uros: please report it"
    if isinstance(error, ModuleNotFoundError) and (error.name or "").startswith(f"{_PACKAGE}."):
        # Some modules are loaded when they are first needed.
        advice = "uros was removed or replaced while this agent runs: install it, restart the agent"
    return f"{type(error).__name__}: {error}{where} ({advice})"


class RateLimit:
    """Limits repeated log lines: a flood of bad packets must not become a flood of lines.

    A kind of line is logged ``burst`` times at once and then once in ``seconds``. Of all kinds
    together, :data:`MAX_LINES` are logged in ``seconds``, even if many peers send the packets.

    Args:
        seconds: The time from one line of a kind to the next.
        burst: How many lines of a kind may come at once.
        clock: Seconds of a monotonic clock; by default :func:`time.monotonic`.
    """

    def __init__(
        self, seconds: float = 1.0, burst: int = 1, clock: Callable[[], float] | None = None
    ) -> None:
        self._monotonic = clock or Clock().monotonic
        self._lines = KeyedTokenBuckets((burst, 1 / seconds), (MAX_LINES, MAX_LINES / seconds))
        self._held: dict[str, int] = {}

    def admit(self, kind: str) -> int:
        """Count a line; return the number of lines to report, 0 while throttled."""
        now = self._monotonic()
        if self._lines.take(kind, now):
            return self._held.pop(kind, 0) + 1
        if kind in self._lines:
            self._held[kind] = self._held.get(kind, 0) + 1
            if len(self._held) > _MAX_KINDS:
                self._held.clear()
        return 0

    def times(self, kind: str) -> str | None:
        """Count a line; return the text " (n times)" to add to it, None while throttled."""
        count = self.admit(kind)
        if not count:
            return None
        return f" ({count} times)" if count > 1 else ""
