"""Logs which code the agent's one thread is in when it hangs.

While a library does not return, or a call takes seconds, no board is served. No other thread can
replace that one, but the log can say which code it is in and what to do. The watchdog's thread
reads two fields of the server twice a second; it adds no cost to messages.

A call that also holds the GIL stops the watchdog's thread too, and a suspended machine stops all
threads. Both are logged afterwards.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Final, Protocol

from .clock import Clock
from .log import Log

HANG_SECONDS: Final = 2.0
# How many seconds closing may take after a signal, because a library that does not return blocks
# the exit.
END_SECONDS: Final = 10.0
_CHECK_SECONDS: Final = 0.5

_REMEDIES: Final = (
    ("middleware/ros2/", "rclpy does not return: restart the agent, or give it -m dds"),
    ("middleware/dds/", "DDS does not return: is the network interface gone, or a disk that"
     " CYCLONEDDS_URI writes a trace to? If it stays so, restart the agent"),
    ("agent/transports/", "a device or driver does not return: unplug it, or restart the agent"),
)  # fmt: skip
_OTHER: Final = "if it comes again, please report it as a fault of uros, with this line"


class Watched(Protocol):
    """What the watchdog reads of a server."""

    clock: Clock
    turns: int  # how many turns its loop has had
    asleep: bool  # whether it waits for an event
    thread: int | None  # the ident of its thread, while it runs

    @property
    def stopping(self) -> bool:
        """Whether it was asked to end."""


class Watchdog:
    """Watches a server from :meth:`start` to :meth:`stop`.

    Args:
        server: The server.
        log: Where it logs.
        hang: Seconds without a turn after which the loop hangs.
        end: Seconds that closing may take before the process is ended.
        interval: Seconds between two checks.
        leave: Ends the process with an exit status.
    """

    def __init__(
        self,
        server: Watched,
        log: Log,
        hang: float = HANG_SECONDS,
        end: float = END_SECONDS,
        interval: float = _CHECK_SECONDS,
        leave: Callable[[int], object] = os._exit,
    ) -> None:
        self._server = server
        self._log = log
        self._hang = hang
        self._end = end
        self._interval = interval
        self._leave = leave
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uros-watchdog", daemon=True)
        self._turn = -1
        self._since = 0.0  # when the turn was new
        self._seen = 0.0  # when the last check was
        self._told = False

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop watching; nothing is logged afterwards. Idempotent."""
        self._over.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)

    def _run(self) -> None:
        monotonic = self._server.clock.monotonic
        self._since = self._seen = monotonic()
        while not self._over.wait(self._interval):
            self.check(monotonic())

    def check(self, now: float) -> None:
        """Log if the server hangs, or no longer does; end the process if closing hangs.

        Args:
            now: Seconds of a monotonic clock.
        """
        server = self._server
        if now - self._seen > self._interval + self._hang:
            self._warn(
                "the process stood still",
                f"for {now - self._seen:.1f} s (the machine was suspended, or has no time for the"
                " agent, or a library held Python's lock)",
            )
            self._since = now
        self._seen = now
        turns = server.turns
        if turns != self._turn or server.asleep or server.thread is None:
            if self._told:
                self._told = False
                self._warn("the data plane goes on", f"it hung for {now - self._since:.1f} s")
            self._turn, self._since = turns, now
            return
        if now - self._since < self._hang:
            return
        if not self._told:
            self._told = True
            where, remedy = standing(sys._current_frames().get(server.thread))
            self._warn(
                "the data plane hangs",
                f"since {now - self._since:.1f} s in {where}; no board is served ({remedy})",
            )
        if server.stopping and now - self._since >= self._end:
            self._log.error(
                "Watchdog", "run", "ended by force",
                f"the end took over {self._end:.0f} s (see the line before)",
            )  # fmt: skip
            self._log.close()
            self._over.set()
            self._leave(1)

    def _warn(self, event: str, about: str) -> None:
        self._log.warning("Watchdog", "run", event, about)


def standing(frame: FrameType | None) -> tuple[str, str]:
    """Return the calls that a thread is in, those of uros innermost first, and the remedy."""
    calls = []
    remedy = ""
    innermost = ""
    while frame is not None:
        path = frame.f_code.co_filename.replace("\\", "/")
        place = f"{frame.f_code.co_name} ({path.rpartition('/')[2]}:{frame.f_lineno})"
        innermost = innermost or place
        _, ours, within = path.rpartition("/uros/")
        if ours:
            calls.append(f"{frame.f_code.co_name} ({within}:{frame.f_lineno})")
            for room, text in _REMEDIES:
                if not remedy and within.startswith(room):
                    remedy = text
        frame = frame.f_back
    if innermost and (not calls or innermost.split(" ")[0] != calls[0].split(" ")[0]):
        calls.insert(0, innermost)
    return " < ".join(calls[:4]) or "a thread that has ended", remedy or _OTHER
