"""The contract of a transport at the agent's end.

A transport receives messages and identifies their senders; it reads no more of them than the
session id. It keeps the sessions of its peers itself, so that finding the session of a message is
one dictionary look-up. Everything happens in the server's thread; nothing blocks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Protocol

from ..clock import Clock

# Levels of Host.note, as in the agent's log.
ERROR, WARNING, INFO = 2, 3, 4

# The default port of agents, for UDP and TCP.
DEFAULT_PORT = 8888

# A ready socket is drained up to so many messages, then the next: a flood must not starve others.
MAX_BURST = 64
# Attack: the largest messages, full of small requests. Bytes of one burst.
MAX_BURST_BYTES = 64 * 1024


class TransportError(OSError):
    """A transport cannot be opened; the text has the reason and the remedy."""


class Session(Protocol):
    """What a transport uses of a session."""

    key: int
    session_id: int

    def receive(self, buf: bytearray, view: memoryview, length: int, now: int) -> bool:
        """Handle one message; return whether there is something to send."""


class Host(Protocol):
    """What a transport uses of the server.

    Attributes:
        clock: The agent's clock.
    """

    clock: Clock

    def now(self) -> int:
        """Return the time in milliseconds modulo 2^30."""

    def unmatched(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        """A message that names no session of this peer."""

    def received(
        self, transport: ServerTransport, session: Any, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        """A message of a session, where messages are logged or may fail."""

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """Note that the connection of a peer was closed for good."""

    def lost(self, transport: ServerTransport) -> None:
        """Note that the transport lost a line, and with it some peers; see is_away()."""

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        """Return whether a client has this address; called seldom, as it searches all clients."""

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """Call ``ready`` whenever the descriptor is readable; with ``writing`` also writable."""

    def unwatch(self, fileno: int) -> None:
        """Stop watching a descriptor that will be closed."""

    def note(self, level: int, part: str, function: str, event: str, about: str) -> None:
        """Write a line to the log."""

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        """Call ``call`` once, so many seconds from now."""


class ServerTransport(ABC):
    """A transport at the agent's end.

    Attributes:
        name: Its name in the log, such as ``UDPv4Agent``.
        kind: Its name in the arrows of logged messages, such as ``UDP``.
        mtu: The longest message that it carries, in bytes.
        lasting: Whether a peer keeps its address over a restart of the agent, and its session.
        sessions: The sessions with ids from 0x80 on, by peer.
        admits: Whether an IP address is admitted; None for all. Set before :meth:`open`.
        messages: Messages received, those of unknown clients too.
        bytes: Their bytes.
    """

    name = ""
    kind = ""
    mtu = 0xFFFF
    lasting = True

    def __init__(self) -> None:
        self.sessions: dict[Any, Any] = {}
        self.admits: Callable[[str], bool] | None = None
        self.messages = 0
        self.bytes = 0

    def label(self) -> str:
        """Return what it listens on, as text: ``port 8888``, ``/dev/ttyACM0``."""
        return ""

    def counters(self) -> dict[str, int]:
        """Return its counters; further ones than messages and bytes differ by transport."""
        return {"messages": self.messages, "bytes": self.bytes}

    @abstractmethod
    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""

    @abstractmethod
    def send(self, peer: Any, datagram: bytes) -> None:
        """Send one message; it is lost where it cannot be sent, as on a network."""

    @abstractmethod
    def address(self, peer: Any) -> str:
        """Return the peer as text."""

    def host_of(self, peer: Any) -> str | None:
        """Return the peer's numeric IP address; None where the transport does not use IP."""
        return None

    def is_away(self, peer: Any) -> bool:
        """Return whether the line of the peer is gone, as far as that can be known."""
        return False

    def certificate_of(self, peer: Any) -> str | None:
        """Return the SHA-256 of the certificate that the peer showed, in hex.

        None where it showed none; only clients of TLS do.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Close everything; idempotent."""

    def deliver(
        self, host: Host, peer: Any, buf: bytearray, view: memoryview, length: int, now: int
    ) -> None:
        """Pass one message to the session that it names, or to the host as an unmatched message."""
        self.messages += 1
        self.bytes += length
        session = self.sessions.get(peer)
        if session is not None and length > 7 and buf[0] == session.session_id and buf[0] & 0x80:
            host.received(self, session, buf, view, length, now)
        else:
            host.unmatched(self, peer, buf, view, length)
