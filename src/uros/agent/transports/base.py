"""The contract of a transport at the agent's end.

A transport receives messages and identifies their senders. The only part of a message that it reads
is the session id. It has a dictionary of its peers' sessions, so that it finds the session of a
message with one look-up. All its methods are called in the server's thread, and none blocks.
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

# The most messages that are read from a ready socket before the next socket is read, so that a
# flood from one does not starve the others.
MAX_BURST = 64
# The most bytes of such a burst, because a flood of long messages with many small requests takes
# longer to handle.
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
        """Handle a message of no session of this peer, such as a CREATE_CLIENT or a ping."""

    def received(
        self, transport: ServerTransport, session: Any, buf: bytearray, view: memoryview,
        length: int, now: int,
    ) -> None:  # fmt: skip
        """Handle a message of a known session: call its ``receive`` and log unexpected errors."""

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """Delete the clients of a peer whose connection was closed, which ends their sessions."""

    def lost(self, transport: ServerTransport) -> None:
        """Note that the transport lost a line that may come back.

        The clients for which :meth:`ServerTransport.is_away` is true are deleted unless they send
        a message within some seconds.
        """

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        """Return whether a client has this address; slow, because it searches all clients."""

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """Call ``ready`` whenever the descriptor is readable; with ``writing`` also writable."""

    def unwatch(self, fileno: int) -> None:
        """Stop watching a descriptor that will be closed."""

    def note(self, level: int, part: str, function: str, event: str, about: str) -> None:
        """Write a line to the log."""

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        """Call ``call`` once, ``seconds`` from now."""


class ServerTransport(ABC):
    """A transport at the agent's end.

    Attributes:
        name: Its name in the log, such as ``UDPv4Agent``.
        kind: Its short name in the log lines of messages, such as ``UDP`` in
            ``[==>> UDP <<==]`` (received) and ``[** <<UDP>> **]`` (sent).
        mtu: The longest message that it carries, in bytes.
        lasting: Whether a peer keeps its address when the agent restarts, so that its session can
            be restored.
        sessions: The sessions with ids from 0x80 on, by peer. Messages with lower session ids
            contain the client key, by which the agent finds their session.
        admits: Returns whether an IP address is admitted; None admits all. Set before :meth:`open`.
        on_refused: Called with rule, address and reason for each connection that is refused. Set
            before :meth:`open`.
        messages: The number of messages received, including those of unknown clients.
        bytes: The sum of their lengths.
    """

    name = ""
    kind = ""
    mtu = 0xFFFF
    lasting = True

    def __init__(self) -> None:
        self.sessions: dict[Any, Any] = {}
        self.admits: Callable[[str], bool] | None = None
        self.on_refused: Callable[[str, str, str], None] = lambda rule, address, why: None
        self.messages = 0
        self.bytes = 0

    def label(self) -> str:
        """Return what it listens on, as text: ``port 8888``, ``/dev/ttyACM0``."""
        return ""

    def counters(self) -> dict[str, int]:
        """Return its counters: messages, bytes, and others that differ by transport."""
        return {"messages": self.messages, "bytes": self.bytes}

    @abstractmethod
    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""

    @abstractmethod
    def send(self, peer: Any, datagram: bytes) -> None:
        """Send one message; a message that cannot be sent is lost, as on a network."""

    @abstractmethod
    def address(self, peer: Any) -> str:
        """Return the peer as text."""

    def is_waiting(self) -> bool:
        """Return whether it waits for its device or peer, so that no board can connect by it."""
        return False

    def admits_boards(self, now: float) -> bool:
        """Return whether a board can connect by it.

        Args:
            now: The time in seconds since 1970.
        """
        return not self.is_waiting()

    def troubles(self, now: float) -> list[str]:
        """Return what is wrong with its files now, with the remedies; takes microseconds.

        Args:
            now: The time in seconds since 1970.
        """
        return []

    def not_after(self) -> dict[str, float]:
        """Return when each of its files ends, in seconds since 1970, by the file's option."""
        return {}

    def doubts(self, now: float) -> list[str]:
        """Return what will keep boards from connecting, today or soon, with the remedies.

        Args:
            now: The time in seconds since 1970.
        """
        return []

    def reload(self) -> None:  # noqa: B027  most have no files
        """Use what the transport's files have now; connections stay, and errors are logged."""

    def host_of(self, peer: Any) -> str | None:
        """Return the peer's numeric IP address; None if the transport does not use IP."""
        return None

    def is_away(self, peer: Any) -> bool:
        """Return whether the peer's line is known to be lost, as after unplugging a device.

        It may come back; a closed connection (:meth:`Host.gone`) cannot.
        """
        return False

    def certificate_of(self, peer: Any) -> str | None:
        """Return the SHA-256 of the peer's TLS certificate in hex; None if it has none."""
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
        # 8 bytes: the headers of the message and of its first submessage. From session id 0x80 on
        # a message has no client key.
        if session is not None and length > 7 and buf[0] == session.session_id and buf[0] & 0x80:
            host.received(self, session, buf, view, length, now)
        else:
            host.unmatched(self, peer, buf, view, length)
