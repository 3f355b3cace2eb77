"""The contract of a transport at the agent's end.

A transport finds the messages and tells from whom they are; it does not look
into them beyond the session id. It keeps the sessions of its peers itself, so
that the way from socket to session is one dictionary look-up. Everything
happens in the server's thread; nothing blocks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Protocol

# Levels of Host.note, as in the agent's log.
ERROR, WARNING, INFO = 2, 3, 4

# Where boards look for an agent, by UDP and TCP, if nobody says another.
DEFAULT_PORT = 8888

# Drain a ready socket up to so many messages, then the next: a flood must not
# starve others.
MAX_BURST = 64
# Attack: as large messages as there are, full of small requests.
MAX_BURST_BYTES = 64 * 1024


class TransportError(OSError):
    """A transport cannot be opened; the text says why and what to do."""


class Session(Protocol):
    """What a transport knows of a session."""

    key: int
    session_id: int

    def receive(self, buf: bytearray, view: memoryview, length: int, now: int) -> bool: ...


class Host(Protocol):
    """What a transport needs of the server it works for."""

    def now(self) -> int:
        """Milliseconds modulo 2^30."""

    def stray(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        """A message that names no session of this peer."""

    def received(
        self, transport: ServerTransport, session: Any, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        """A message of a session, where messages are logged or may fail."""

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """The peer's connection is closed for good."""

    def lost(self, transport: ServerTransport) -> None:
        """A line of the transport is gone, and with it some peers; see is_away()."""

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        """Whether a client talks from there; seldom asked, as all are looked at."""

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """Call ``ready`` when the descriptor is readable (or writable too)."""

    def unwatch(self, fileno: int) -> None:
        """The descriptor is about to be closed."""

    def note(self, level: int, part: str, function: str, what: str, about: str) -> None:
        """A line for the log."""

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        """Call once, so many seconds from now."""


class ServerTransport(ABC):
    """See the module."""

    name = ""  # as the log knows it: UDPv4Agent
    kind = ""  # in arrows of messages: UDP
    mtu = 0xFFFF  # the longest message it carries
    # Whether a peer has the same address after a restart of the agent, and goes on there.
    lasting = True

    def __init__(self) -> None:
        self.sessions: dict[Any, Any] = {}
        # Whether an IP address may talk to the agent, where not all may. Set before open().
        self.admits: Callable[[str], bool] | None = None
        self.messages = 0  # that came, whosever they are, and their bytes
        self.bytes = 0

    def label(self) -> str:
        """What it listens on, as a person reads it: port 8888, /dev/ttyACM0."""
        return ""

    def counters(self) -> dict[str, int]:
        """What it has counted since it was made; what else than messages, kinds of transport
        differ in.
        """
        return {"messages": self.messages, "bytes": self.bytes}

    @abstractmethod
    def open(self, host: Host) -> None:
        """Open and start watching. Raises TransportError."""

    @abstractmethod
    def send(self, peer: Any, datagram: bytes) -> None:
        """Send one message; what cannot be sent is lost, as on a network."""

    @abstractmethod
    def address(self, peer: Any) -> str:
        """The peer as a person reads it."""

    def host_of(self, peer: Any) -> str | None:
        """The IP address that the peer talks from, in numbers; None: it does not talk over IP."""
        return None

    def is_away(self, peer: Any) -> bool:
        """Whether the line that the peer is on is not there now, as far as that can be known."""
        return False

    def certificate_of(self, peer: Any) -> str | None:
        """What tells the certificate that the peer has shown from all others (its SHA-256, in hex);
        None: it has shown none, as nobody does but clients of TLS.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Close everything. Twice is once."""

    def deliver(
        self, host: Host, peer: Any, buf: bytearray, view: memoryview, length: int, now: int
    ) -> None:
        """Pass one message on to the session it names, or as a stray."""
        self.messages += 1
        self.bytes += length
        session = self.sessions.get(peer)
        if session is not None and length > 7 and buf[0] == session.session_id and buf[0] & 0x80:
            host.received(self, session, buf, view, length, now)
        else:
            host.stray(self, peer, buf, view, length)
