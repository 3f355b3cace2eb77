"""Lines of bytes at the agent's end, whatever carries them: frames, counters, coming back.

A :class:`Line` finds frames in a stream whatever else is on it, a board's
``printf`` for one, and counts what is wrong with them. A :class:`LineServer` is
the transport of one line, which is opened again whenever it is lost.
"""

from __future__ import annotations

import os
import socket
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Final, Protocol

from ...wire.framing import FLAG, Deframer, frame, frame_size
from .base import ERROR, INFO, WARNING, Host, ServerTransport

AGENT_ADDRESS: Final = 0
# What a line counts.
COUNTERS: Final = ("frames", "crc_errors", "foreign", "skipped", "dropped")
# How often a line that is away is looked for, in seconds.
RETRY: Final = 0.5
# A line that takes nothing for so long loses messages, as a full UART does.
MAX_UNSENT: Final = 256 * 1024
# After a warning about bad frames or lost messages, seconds until the next.
QUIET: Final = 10.0
_CHUNK: Final = 4096
# Lines that carry frames have few bad bytes; this many in a row say something, twice as
# many say it again.
_SUSPICIOUS: Final = 512


class Stream(Protocol):
    """What a line needs of an open device or socket. No call waits."""

    def fileno(self) -> int:
        """The descriptor that becomes readable (or writable) when there is something to do."""

    def read(self, size: int) -> bytes:
        """Some bytes; none: it has ended. BlockingIOError: nothing now; OSError: it is gone."""

    def write(self, data: bytearray) -> int:
        """How many it took, from the first on. BlockingIOError: none; OSError: it is gone."""

    def backlog(self) -> int:
        """Bytes that it took and keeps itself, besides what the system keeps."""

    def close(self) -> None:
        """Once, after the descriptor has been unwatched."""


class FileStream:
    """A descriptor that does not block."""

    __slots__ = ("_fd",)

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def fileno(self) -> int:
        return self._fd

    def read(self, size: int) -> bytes:
        return os.read(self._fd, size)

    def write(self, data: bytearray) -> int:
        return os.write(self._fd, data)

    def backlog(self) -> int:
        return 0

    def close(self) -> None:
        os.close(self._fd)


class SocketStream:
    """A connected stream socket, TCP or Bluetooth, that does not block."""

    __slots__ = ("_socket",)

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self, size: int) -> bytes:
        return self._socket.recv(size)

    def write(self, data: bytearray) -> int:
        return self._socket.send(data)

    def backlog(self) -> int:
        return 0

    def close(self) -> None:
        self._socket.close()


class Line:
    """Frames over a stream, for the transport ``server``, which it outlives never.

    ``peer`` makes the server's peer of a frame's source address; ``lost`` is called
    with a reason when the stream has ended. The counters go on when the stream is
    replaced by the next one.
    """

    def __init__(
        self, server: ServerTransport, label: str, peer: Callable[[int], Any],
        lost: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.label = label  # how lines of the log name it
        self.stream: Stream | None = None
        self.frames = 0  # sound ones for the agent
        self.crc_errors = 0  # whole frames that are not sound
        self.foreign = 0  # sound ones for somebody else
        self.skipped = 0  # bytes outside of sound frames
        self.dropped = 0  # messages that were not sent, because the line took nothing
        self.unsent = bytearray()
        self._server = server
        self._peer = peer
        self._on_lost = lost
        self._host: Host | None = None
        self._deframer = Deframer(AGENT_ADDRESS)
        self._suspected = 0
        self._patience = _SUSPICIOUS
        # What the last warning knew, and whether it is too early for another.
        self._told = (0, 0, 0)
        self._hushed = False

    def open(self, host: Host, stream: Stream) -> None:
        """Go on with this stream; nothing of the one before is left in it."""
        self.close()
        self._host = host
        self.stream = stream
        self._deframer = Deframer(AGENT_ADDRESS)
        self._suspected = self.skipped
        self._patience = _SUSPICIOUS
        host.watch(stream.fileno(), self._ready)

    def close(self) -> None:
        """Twice is once."""
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
                buf = bytearray(message)
                peer = self._peer(deframer.source)
                self._server.deliver(host, peer, buf, memoryview(buf), len(buf), now)
            at = stop
        self._count(deframer)
        if self.crc_errors > self._told[1] and not self._hushed:
            self._warn()
        if self.skipped - self._suspected > self._patience:
            self._suspected = self.skipped
            self._patience *= 2
            host.note(
                WARNING, self._server.name, "receive", "no frames among the bytes",
                f"device: {self.label}, skipped: {self.skipped}, crc_errors: {self.crc_errors}"
                " (wrong baud rate, or a program that does not speak micro-ROS?)",
            )  # fmt: skip

    def _count(self, deframer: Deframer) -> None:
        """The deframer's counts are ours now: it is replaced, and we are not."""
        self.crc_errors += deframer.crc_errors
        self.foreign += deframer.foreign
        self.skipped += deframer.skipped
        deframer.crc_errors = deframer.foreign = deframer.skipped = 0

    def _warn(self) -> None:
        """Tell what became bad since the last warning, and again later where it goes on."""
        host = self._host
        frames, crc_errors, dropped = (
            now - before
            for now, before in zip(
                (self.frames, self.crc_errors, self.dropped), self._told, strict=True
            )
        )
        self._hushed = bool(crc_errors or dropped)
        if not self._hushed or host is None:
            return
        self._told = self.frames, self.crc_errors, self.dropped
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
                " (nobody reads there, or it is slower than what is sent)",
            )  # fmt: skip

    def counters(self) -> dict[str, int]:
        """What is counted of it."""
        return {name: getattr(self, name) for name in COUNTERS}

    # --- out --------------------------------------------------------------------

    def send(self, address: int, datagram: bytes) -> None:
        """One message in a frame for ``address``; lost where the line has no room."""
        stream = self.stream
        if stream is None:
            return
        if len(self.unsent) + stream.backlog() > MAX_UNSENT:
            self.dropped += 1
            if not self._hushed:
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
    """One line, looked for until it is there, and again when it is gone.

    A peer is the source address of its frames: boards are 1 and up. Boards that
    were not reset go on in their sessions when the line comes back.
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
        self._host = host
        self._try()

    def _try(self) -> None:
        if not self._closed and self._host is not None:
            try:
                self._begin(self._host)
            except Exception as error:  # no descriptor is left, or whatever: it was there before
                self._failed(ERROR, "open device error", str(error))

    @abstractmethod
    def _begin(self, host: Host) -> None:
        """Start to open the line; ends in :meth:`_opened` or :meth:`_failed`, now or later."""

    def _opened(self, stream: Stream, about: str) -> None:
        """The line is there."""
        host = self._host
        if self._closed or host is None:
            stream.close()
            return
        self._said = ""
        self.line.open(host, stream)
        host.note(INFO, self.name, "init", "running...", about)

    def _failed(self, level: int, what: str, why: str) -> None:
        """Say once what is the matter, and try again until it is mended."""
        host = self._host
        if self._closed or host is None:
            return
        if why != self._said:
            self._said = why
            host.note(level, self.name, "init", what, f"device: {self.device}, {why}")
        host.wake_at(RETRY, self._try)

    def _lost(self, why: str) -> None:
        """The line is gone."""
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
        self.line.send(peer, datagram)

    def label(self) -> str:
        return self.device

    def counters(self) -> dict[str, int]:
        return {**super().counters(), **self.line.counters()}

    def address(self, peer: int) -> str:
        return f"{self.device} ({peer})"

    def is_away(self, peer: int) -> bool:
        return self.line.stream is None

    def close(self) -> None:
        self._closed = True
        self.line.close()
