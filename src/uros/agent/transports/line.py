"""Byte streams at the agent's end: framing, counters, reconnection.

A :class:`Line` finds frames in a stream among other bytes, such as a board's ``printf``, and counts
errors. A :class:`LineServer` is the transport of one line, which is opened again whenever it is
lost.
"""

from __future__ import annotations

import os
import socket
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Final, Protocol

from ...wire.framing import FLAG, Deframer, frame, frame_size
from .base import ERROR, INFO, WARNING, Host, ServerTransport
from .line_faults import explain, is_text

AGENT_ADDRESS: Final = 0
# The counters of a line.
COUNTERS: Final = ("frames", "crc_errors", "foreign", "skipped", "dropped")
# The time between two tries to open a line, in seconds.
RETRY: Final = 0.5
# Bytes that wait for a line; further messages are lost, as with a full UART.
MAX_UNSENT: Final = 256 * 1024
# Seconds between two warnings about bad frames or lost messages.
QUIET: Final = 10.0
_CHUNK: Final = 4096
# Lines that carry frames have few other bytes; this many in a row are logged, and again after twice
# as many.
_SUSPICIOUS: Final = 512
# Noise on a line that has carried no frame yet is logged so many seconds after its first byte, if
# there are so many bytes; a board that searches for its agent sends no more than that. Text may be
# the start of the board, and is logged as other bytes are.
FIRST_LOOK: Final = 2.0
_FEW: Final = 8
# The most bytes that are kept to tell noise from text.
_SAMPLE: Final = 256


class Stream(Protocol):
    """An open device or socket; no call blocks."""

    def fileno(self) -> int:
        """Return the descriptor to watch for reading and writing."""

    def read(self, size: int) -> bytes:
        """Read bytes; none at the end. Raises BlockingIOError for nothing now, OSError if lost."""

    def write(self, data: bytearray) -> int:
        """Write; return the bytes taken. Raises BlockingIOError for none, OSError if lost."""

    def backlog(self) -> int:
        """Return the bytes taken that wait in this object, besides those in the system."""

    def close(self) -> None:
        """Close it; called once, after the descriptor is unwatched."""


class FileStream:
    """A non-blocking descriptor."""

    __slots__ = ("_fd",)

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self._fd

    def read(self, size: int) -> bytes:
        """Read up to ``size`` bytes."""
        return os.read(self._fd, size)

    def write(self, data: bytearray) -> int:
        """Write; return how many bytes were taken."""
        return os.write(self._fd, data)

    def backlog(self) -> int:
        """Return the bytes that it holds itself: none."""
        return 0

    def close(self) -> None:
        """Close everything; idempotent."""
        os.close(self._fd)


class SocketStream:
    """A connected non-blocking stream socket, TCP or Bluetooth."""

    __slots__ = ("_socket",)

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self._socket.fileno()

    def read(self, size: int) -> bytes:
        """Read up to ``size`` bytes."""
        return self._socket.recv(size)

    def write(self, data: bytearray) -> int:
        """Write; return how many bytes were taken."""
        return self._socket.send(data)

    def backlog(self) -> int:
        """Return the bytes that it holds itself: none."""
        return 0

    def close(self) -> None:
        """Close everything; idempotent."""
        self._socket.close()


class Line:
    """Frames over a stream; the counters continue when the stream is replaced.

    Attributes:
        label: Its name in the log.
        stream: The open stream, if any.
        frames: Valid frames for the agent.
        crc_errors: Complete frames with a wrong CRC.
        foreign: Valid frames for other addresses.
        skipped: Bytes outside of valid frames.
        dropped: Messages not sent because the line took nothing.
        unsent: Bytes that wait to be sent.
        baud: The rate of a serial device; None for other lines.

    Args:
        server: The transport that the line belongs to.
        label: See above.
        peer: Makes a peer of a frame's source address.
        lost: Called with a reason when the stream has ended.
    """

    def __init__(
        self, server: ServerTransport, label: str, peer: Callable[[int], Any],
        lost: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.label = label
        self.stream: Stream | None = None
        self.frames = 0
        self.crc_errors = 0
        self.foreign = 0
        self.skipped = 0
        self.dropped = 0
        self.unsent = bytearray()
        self.baud: int | None = None
        self._server = server
        self._peer = peer
        self._on_lost = lost
        self._host: Host | None = None
        self._deframer = Deframer(AGENT_ADDRESS)
        self._suspected = 0
        self._patience = _SUSPICIOUS
        # The first bytes of the stream while it has carried no frame, then None.
        self._sample: bytearray | None = bytearray()
        # The counters at the last warning, and whether it is too early for another.
        self._reported = (0, 0, 0)
        self._throttled = False

    def open(self, host: Host, stream: Stream) -> None:
        """Use this stream from now on; the one before is closed."""
        self.close()
        self._host = host
        self.stream = stream
        self._deframer = Deframer(AGENT_ADDRESS)
        self._suspected = self.skipped
        self._patience = _SUSPICIOUS
        self._sample = bytearray()
        host.watch(stream.fileno(), self._ready)

    def close(self) -> None:
        """Close the stream; idempotent."""
        stream, self.stream = self.stream, None
        if stream is not None:
            if self._host is not None:
                self._host.unwatch(stream.fileno())
            stream.close()
        self.unsent.clear()

    # --- in ---------------------------------------------------------------------

    def _ready(self) -> None:
        if self.unsent:
            self._push()
        stream, host = self.stream, self._host
        if stream is None or host is None:
            return
        try:
            chunk = stream.read(_CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            self._end(error.strerror or str(error))
            return
        if not chunk:
            self._end("end of file")
            return
        now = host.now()
        deframer = self._deframer
        at = 0
        while at < len(chunk):  # a frame at a time, because each has a source
            stop = chunk.find(FLAG, at + 1)
            stop = stop if stop >= 0 else len(chunk)
            for message in deframer.feed(chunk[at:stop]):
                self._count(deframer)
                self.frames += 1
                self._suspected = self.skipped
                self._patience = _SUSPICIOUS
                self._sample = None
                buf = bytearray(message)
                peer = self._peer(deframer.source)
                self._server.deliver(host, peer, buf, memoryview(buf), len(buf), now)
            at = stop
        self._count(deframer)
        if self.crc_errors > self._reported[1] and not self._throttled:
            self._warn()
        if self._sample is not None:
            self._keep(self._sample, chunk, host)
        if self.skipped - self._suspected > self._patience:
            self._patience *= 2
            self._warn_of_bytes(bytes(self._sample or chunk))

    def _keep(self, sample: bytearray, chunk: bytes, host: Host) -> None:
        """Keep the first bytes of a stream, and look at them soon."""
        if not sample:
            host.wake_at(FIRST_LOOK, lambda: self._look(sample))
        sample += chunk[: _SAMPLE - len(sample)]

    def _look(self, sample: bytearray) -> None:
        """Log noise that is all that a stream has carried."""
        if sample is not self._sample or self.stream is None or is_text(bytes(sample)):
            return
        if len(sample) < _FEW:
            sample.clear()  # look again after the next byte
        else:
            self._warn_of_bytes(bytes(sample))

    def _warn_of_bytes(self, sample: bytes) -> None:
        self._suspected = self.skipped
        if self._host is not None:
            self._host.note(
                WARNING, self._server.name, "receive", "no frames among the bytes",
                f"device: {self.label}, skipped: {self.skipped}, crc_errors: {self.crc_errors}"
                f" ({explain(sample, self.label, self.baud)})",
            )  # fmt: skip

    def _count(self, deframer: Deframer) -> None:
        """Move the deframer's counts here, as it is replaced with each stream."""
        self.crc_errors += deframer.crc_errors
        self.foreign += deframer.foreign
        self.skipped += deframer.skipped
        deframer.crc_errors = deframer.foreign = deframer.skipped = 0

    def _warn(self) -> None:
        """Log errors since the last warning, and again each QUIET seconds while there are more."""
        host = self._host
        frames, crc_errors, dropped = (
            now - before
            for now, before in zip(
                (self.frames, self.crc_errors, self.dropped), self._reported, strict=True
            )
        )
        self._throttled = bool(crc_errors or dropped)
        if not self._throttled or host is None:
            return
        self._reported = self.frames, self.crc_errors, self.dropped
        host.wake_at(QUIET, self._warn)
        if crc_errors:
            host.note(
                WARNING, self._server.name, "receive", "bad frames",
                f"device: {self.label}, CRC errors: {crc_errors} of {frames + crc_errors} frames"
                " (noise, or a wrong baud rate?)",
            )  # fmt: skip
        if dropped:
            host.note(
                WARNING, self._server.name, "send", "messages lost",
                f"device: {self.label}, the line did not take {dropped} messages"
                " (no program reads there, or the line is too slow)",
            )  # fmt: skip

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        return {name: getattr(self, name) for name in COUNTERS}

    # --- out --------------------------------------------------------------------

    def send(self, address: int, datagram: bytes) -> None:
        """Send one message in a frame to ``address``; it is lost if the line takes no more."""
        stream = self.stream
        if stream is None:
            return
        if len(self.unsent) + stream.backlog() > MAX_UNSENT:
            self.dropped += 1
            if not self._throttled:
                self._warn()
            return
        out = bytearray(frame_size(datagram))
        size = frame(datagram, AGENT_ADDRESS, address, out)
        waiting = bool(self.unsent)
        self.unsent += memoryview(out)[:size]
        if not waiting:
            self._push()

    def _push(self) -> None:
        stream = self.stream
        if stream is None:
            return
        try:
            sent = stream.write(self.unsent)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._end(error.strerror or str(error))
            return
        del self.unsent[:sent]
        if self._host is not None:
            self._host.watch(stream.fileno(), self._ready, bool(self.unsent))

    def _end(self, why: str) -> None:
        self.close()
        self._on_lost(why)


class LineServer(ServerTransport):
    """The transport of one line; a line that cannot be opened or is lost is opened again and again.

    A peer is the source address of its frames: boards are 1 and up. Boards that were not reset
    continue their sessions when the line comes back.
    """

    name = "SerialAgent"
    kind = "SERIAL"

    def __init__(self, device: str) -> None:
        super().__init__()
        self.device = device
        self.line = Line(self, device, lambda source: source, self._lost)
        self._host: Host | None = None
        self._closed = False
        self._said = ""

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        self._host = host
        self._try()

    def _try(self) -> None:
        if not self._closed and self._host is not None:
            try:
                self._begin(self._host)
            except Exception as error:  # such as no descriptor left: a later try may succeed
                self._failed(ERROR, "open device error", str(error))

    @abstractmethod
    def _begin(self, host: Host) -> None:
        """Start to open the line; calls :meth:`_opened` or :meth:`_failed`, now or later."""

    def _opened(self, stream: Stream, about: str) -> None:
        """Note that the line is open."""
        host = self._host
        if self._closed or host is None:
            stream.close()
            return
        self._said = ""
        self.line.open(host, stream)
        host.note(INFO, self.name, "init", "running...", about)

    def _failed(self, level: int, event: str, why: str) -> None:
        """Log a new reason once, and try again."""
        host = self._host
        if self._closed or host is None:
            return
        if why != self._said:
            self._said = why
            host.note(level, self.name, "init", event, f"device: {self.device}, {why}")
        host.wake_at(RETRY, self._try)

    def _lost(self, why: str) -> None:
        """Note that the line was lost, and try to open it again."""
        host = self._host
        if self._closed or host is None:
            return
        host.note(
            WARNING, self.name, "receive", "device lost",
            f"device: {self.device}, {why}; waiting for it to come back",
        )  # fmt: skip
        host.wake_at(RETRY, self._try)
        host.lost(self)

    def send(self, peer: int, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        self.line.send(peer, datagram)

    def label(self) -> str:
        """Return what it listens on, as text."""
        return self.device

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        return {**super().counters(), **self.line.counters()}

    def address(self, peer: int) -> str:
        """Return the peer as text."""
        return f"{self.device} ({peer})"

    def is_waiting(self) -> bool:
        """Return whether the line is not open."""
        return self.line.stream is None

    def is_away(self, peer: int) -> bool:
        """Return whether the line of the peer is gone."""
        return self.line.stream is None

    def close(self) -> None:
        """Close everything; idempotent."""
        self._closed = True
        self.line.close()
