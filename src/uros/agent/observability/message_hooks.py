"""Where the messages of boards can be listened to as they pass the agent.

``Agent.taps`` is empty most of the time, and then costs the look whether it is. A tap gets every
message, before the agent handles it or as it goes out: those of sessions, those of strangers and
those that are refused. It is called by the agent's one thread and must not wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from ..log import DEBUG, TRACE, Log, unexpected
from ..objects.kinds import key_label
from ..transports.base import ServerTransport

# Who says a message.
CLIENT: Final = "client"
AGENT: Final = "agent"


class Passing(NamedTuple):
    """One message as it passes. ``now`` is in microseconds since 1970, ``key`` that of the
    client whose session it is, 0 where nobody knows.
    """

    transport: ServerTransport
    peer: Any
    direction: str
    message: bytes
    now: int
    key: int


Tap = Callable[[Passing], None]


class Taps(list[Tap]):
    """All that listen. ``if taps: taps(...)`` is how a message is passed by."""

    def __init__(self, log: Log) -> None:
        super().__init__()
        self._log = log
        if log.level >= DEBUG:
            self.append(lambda passing: trace(log, passing))

    def __call__(
        self, transport: ServerTransport, peer: Any, direction: str,
        message: bytes | memoryview, length: int, key: int,
    ) -> None:  # fmt: skip
        """Let everybody hear ``message[:length]``. A tap that fails hears no more."""
        now = time.time_ns() // 1000
        passing = Passing(transport, peer, direction, bytes(message[:length]), now, key)
        for tap in self[:]:  # one that has heard enough takes itself out
            try:
                tap(passing)
            except Exception as error:  # whatever it is, boards go on
                self.drop(tap)
                self._log.error(
                    "Server", "trace", "internal error",
                    unexpected(error, "; this listener hears no more"),
                )  # fmt: skip

    def drop(self, tap: Tap) -> None:
        """Take a tap out. Twice is once."""
        if tap in self:
            self.remove(tap)


def trace(log: Log, passing: Passing) -> None:
    """Lines for a message: at level 5 its length, at 6 its bytes and what they mean too."""
    transport, _, direction, message, _, key = passing
    label = transport.kind
    sent = direction == AGENT
    function = "send_message" if sent else "recv_message"
    about = f"client_key: {key_label(key)}, len: {len(message)}"
    if log.level >= TRACE:
        from .format import describe

        log(TRACE, transport.name, "trace", "sent" if sent else "received", describe(message))
        about += f", data: {message.hex(' ').upper()}"
    arrow = f"[** <<{label}>> **]" if sent else f"[==>> {label} <<==]"
    log.debug(transport.name, function, arrow, about)
