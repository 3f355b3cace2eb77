"""Hooks that are called for each message that passes the agent.

``Agent.message_hooks`` is empty most of the time and then costs one truth test a message. A hook
gets every message before the agent handles it, or as it is sent: those of sessions, those of
unknown clients and those that are refused. It is called by the agent's one thread and must not
block.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from ..clock import Clock
from ..log import DEBUG, TRACE, Log, unexpected
from ..objects.kinds import key_label
from ..transports.base import ServerTransport

# Directions: the sender of a message.
CLIENT: Final = "client"
AGENT: Final = "agent"


class MessageEvent(NamedTuple):
    """One message that passes the agent.

    Attributes:
        transport: The transport that carries it.
        peer: The client's address there.
        direction: :data:`CLIENT` or :data:`AGENT`, the sender.
        message: Its bytes.
        now: Microseconds since 1970.
        key: The client key of its session; 0 if it is unknown.
    """

    transport: ServerTransport
    peer: Any
    direction: str
    message: bytes
    now: int
    key: int


MessageHook = Callable[[MessageEvent], None]


class MessageHooks(list[MessageHook]):
    """The hooks of one agent; used as ``if hooks: hooks(...)``.

    At log level 5 or 6 it begins with a hook that logs each message.
    """

    def __init__(self, log: Log, clock: Clock) -> None:
        super().__init__()
        self._log = log
        self._clock = clock
        self.follow_level()

    def follow_level(self) -> None:
        """Log each message from now on if the log has level 5 or 6, and none if it has not."""
        self.discard(self._log_message)
        if self._log.level >= DEBUG:
            self.insert(0, self._log_message)

    def _log_message(self, event: MessageEvent) -> None:
        log_message(self._log, event)

    def __call__(
        self, transport: ServerTransport, peer: Any, direction: str,
        message: bytes | memoryview, length: int, key: int,
    ) -> None:  # fmt: skip
        """Call all hooks with ``message[:length]``; a hook that raises is removed."""
        now = self._clock.time_ns() // 1000
        event = MessageEvent(transport, peer, direction, bytes(message[:length]), now, key)
        for hook in self[:]:  # a hook may remove itself
            try:
                hook(event)
            except Exception as error:  # whatever the hook does, boards are served
                self.discard(hook)
                self._log.error(
                    "Server", "trace", "internal error",
                    unexpected(error, "; this message hook is removed"),
                )  # fmt: skip

    def discard(self, hook: MessageHook) -> None:
        """Remove a hook; idempotent."""
        if hook in self:
            self.remove(hook)


def log_message(log: Log, event: MessageEvent) -> None:
    """Log a message: at level 5 its length, at level 6 its bytes and its meaning too."""
    transport, _, direction, message, _, key = event
    label = transport.kind
    sent = direction == AGENT
    function = "send_message" if sent else "recv_message"
    about = f"client_key: {key_label(key)}, len: {len(message)}"
    if log.level >= TRACE:
        from .format import format_message

        log(TRACE, transport.name, "trace", "sent" if sent else "received", format_message(message))
        about += f", data: {message.hex(' ').upper()}"
    arrow = f"[** <<{label}>> **]" if sent else f"[==>> {label} <<==]"
    log.debug(transport.name, function, arrow, about)
