"""Custom transports at the agent's end, written by users: radio modems, message buses, tunnels.

A class with four calls is enough, which may wait and may fail: it is called from threads of its
own, and opened again after whatever it raises. docs/custom_transport.md has an example.
"""

from __future__ import annotations

import errno
import importlib
import importlib.util
import sys
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from ...wire.framing import Deframer, frame, frame_size
from .base import ERROR, INFO, WARNING, Host, ServerTransport, TransportError
from .fault_counter import FaultCounter
from .worker import LEAVE, Worker

AGENT_ADDRESS: Final = 0
# The pause before a failed line is opened again, in seconds; it doubles until something arrives.
RETRY: Final = 0.5
_RETRY_MOST: Final = 8.0
# The longest message there is: lengths of messages have 16 bits on other lines.
MAX_MESSAGE: Final = 0xFFFF
# A stream is handled in pieces of so many bytes, however much was read at once.
_CHUNK: Final = 4096
# The most peers whose incomplete frames are kept, because every piece may have a new peer and a
# frame that never ends. The state of the peer that was silent the longest is dropped.
MAX_PEERS: Final = 256
_CALLS: Final = ("open", "close", "read", "write")


class CustomTransport:
    """Base class of custom transports; any class with these methods works too.

    An exception in a method closes the line, which is opened again a little later. ``read`` and
    ``write`` are called from two threads, so that each may block; the other methods are never
    called concurrently.

    Attributes:
        framed: True if the line is a stream of bytes: messages are sent in serial frames, and
            ``read`` and ``write`` get pieces of the stream.
    """

    framed = False

    def open(self) -> None:
        """Open the line; called first, and again after each failure."""

    def close(self) -> None:
        """Close the line; a ``write`` that blocks should return from then on."""

    def read(self, timeout: float) -> bytes | tuple[bytes, Any] | None:
        """Receive one message, blocking for at most ``timeout`` seconds.

        Returns:
            The message; ``(message, peer)`` if there are several boards, with any hashable
            value that identifies the board; None if nothing was received.
        """
        raise NotImplementedError

    def write(self, data: bytes, peer: Any) -> None:
        """Send one message to a board.

        It may block; further messages wait in a queue, and are lost if that is full.

        Args:
            data: The message.
            peer: The board as ``read`` returned it; None if it returned none.
        """
        raise NotImplementedError


class CustomServer(ServerTransport):
    """Serves a custom transport.

    Attributes:
        malformed: Messages that are too long or empty.
        dropped: Messages that the line did not take in time.

    Args:
        line: A :class:`CustomTransport`.
        name: Its name in the log; by default that of its class.
    """

    kind = "CUSTOM"

    def __init__(self, line: Any, name: str = "") -> None:
        super().__init__()
        self.name = name or type(line).__name__
        self._line = line
        self._framed = False
        self._deframers: OrderedDict[Any, Deframer] = OrderedDict()
        self._malformed = FaultCounter()
        self._dropped = FaultCounter()
        self._worker: Worker | None = None
        self._host: Host | None = None
        self._closed = False
        self._pause = 0.0
        try:
            self._framed = bool(getattr(line, "framed", False))
            missing = [call for call in _CALLS if not callable(getattr(line, call, None))]
        except Exception as error:  # others' code
            raise TransportError(errno.EINVAL, f"{self.name} raised {_said(error)}") from error
        if missing:
            raise TransportError(
                errno.EINVAL,
                f"{self.name} has no {missing[0]}(): a transport has open(), close(),"
                " read(timeout) and write(data, peer); derive from"
                " uros.agent.transports.custom.CustomTransport",
            )

    @property
    def malformed(self) -> int:
        """Malformed frames so far."""
        return self._malformed.count

    @property
    def dropped(self) -> int:
        """Messages dropped so far."""
        return self._dropped.count

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        return {**super().counters(), "malformed": self.malformed, "dropped": self.dropped}

    def is_waiting(self) -> bool:
        """Return whether the line is not open."""
        return self._worker is None

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        self._host = host
        self._begin()

    def _begin(self) -> None:
        if self._closed or self._worker is not None:
            return
        assert self._host is not None
        self._deframers.clear()
        self._worker = Worker(
            self._host, self.name, _Checked(self._line, self._framed),
            self._opened, self._received, self._ended,
        )  # fmt: skip

    def _opened(self) -> None:
        assert self._host is not None
        self._host.note(INFO, self.name, "init", "running...", f"framed: {self._framed}")

    def _ended(self, error: BaseException | None) -> None:
        self._worker = None
        assert self._host is not None
        text = "it has ended" if error is None else _said(error)
        self._pause = min(2 * self._pause, _RETRY_MOST) or RETRY
        self._host.note(
            ERROR, self.name, "run", "the transport failed",
            f"{text}; it is opened again in {self._pause:g} s",
        )  # fmt: skip
        self._host.wake_at(self._pause, self._begin)

    def _received(self, item: tuple[bytes, Any]) -> None:
        data, peer = item
        self._pause = 0.0
        host = self._host
        assert host is not None
        if not self._framed:
            if not 0 < len(data) <= MAX_MESSAGE:
                if self._malformed.add():
                    host.note(
                        WARNING, self.name, "receive", "message refused",
                        f"{self._name(peer)}, {len(data)} bytes: a message has 1 to {MAX_MESSAGE}"
                        f" (a stream of bytes? Then framed = True), malformed: {self.malformed}",
                    )  # fmt: skip
                return
            buf = bytearray(data)
            self.deliver(host, peer, buf, memoryview(buf), len(buf), host.now())
            return
        deframer = self._deframers.get(peer)
        if deframer is None:
            deframer = self._deframers[peer] = Deframer(AGENT_ADDRESS)
            if len(self._deframers) > MAX_PEERS:
                self._deframers.popitem(last=False)
        self._deframers.move_to_end(peer)
        now = host.now()
        for piece in _pieces(data):
            for message in deframer.feed(piece):
                buf = bytearray(message)
                board = (peer, deframer.source)
                self.deliver(host, board, buf, memoryview(buf), len(buf), now)

    def send(self, peer: Any, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        worker = self._worker
        if worker is None:
            return
        if self._framed:
            peer, address = peer
            out = bytearray(frame_size(datagram))
            datagram = bytes(memoryview(out)[: frame(datagram, AGENT_ADDRESS, address, out)])
        if not worker.send(datagram, peer) and self._dropped.add():
            assert self._host is not None
            self._host.note(
                WARNING, self.name, "send", "message dropped",
                f"write() is too slow, or the line has failed; dropped: {self.dropped}",
            )  # fmt: skip

    def address(self, peer: Any) -> str:
        """Return the peer as text."""
        if self._framed:
            return f"{self._name(peer[0])} ({peer[1]})"
        return self._name(peer)

    def _name(self, peer: Any) -> str:
        if peer is None:
            return self.name
        try:
            return f"{self.name} {peer}"
        except BaseException:  # a user's code in our thread: the agent continues whatever it raises
            return f"{self.name} {type(peer).__name__}"

    def close(self) -> None:
        """Close everything; idempotent."""
        self._closed = True
        worker, self._worker = self._worker, None
        if worker is not None and not worker.stop():
            assert self._host is not None
            self._host.note(
                WARNING, self.name, "close", "the transport does not end",
                f"a call has not returned for {LEAVE:g} s: read(timeout) must keep its timeout",
            )  # fmt: skip


class _Checked:
    """The line for a Worker, with a uniform result of ``read``, in the line's thread."""

    def __init__(self, line: Any, framed: bool) -> None:
        self._line = line
        self._framed = framed
        self._data = b""
        self._at = 0  # what comes before has been given
        self._peer: Any = None

    def open(self) -> None:
        self._line.open()

    def close(self) -> None:
        self._line.close()

    def write(self, data: bytes, peer: Any) -> None:
        self._line.write(data, peer)

    def read(self, timeout: float) -> tuple[bytes, Any] | None:
        if self._at >= len(self._data):
            item = self._line.read(timeout)
            if item is None:
                return None
            data, peer = item if isinstance(item, tuple) and len(item) == 2 else (item, None)
            if not isinstance(data, (bytes, bytearray, memoryview)):
                raise TypeError(
                    f"read() returned {type(item).__name__}, not bytes, (bytes, peer) or None"
                )
            _ = hash(peer), peer == peer  # noqa: PLR0124  raises here and not in the agent's thread
            self._data, self._peer, self._at = bytes(data), peer, 0
        end = self._at + _CHUNK if self._framed else len(self._data)
        data, self._at = self._data[self._at : end], end
        return (data, self._peer) if data else None


def _pieces(data: bytes) -> Sequence[bytes]:
    """Split before each flag: a frame at a time, because each has a source."""
    first, *rest = data.split(b"\x7e")
    return [first, *(b"\x7e" + part for part in rest)]


def _said(error: BaseException) -> str:
    """Return an exception of the user's code as text, with its place."""
    try:
        text = f"{type(error).__name__}: {error}"
    except BaseException:  # even that is theirs
        text = type(error).__name__
    return text + _where(error)


def _where(error: BaseException) -> str:
    """Return the line of the user's file that raised, for the log."""
    at = error.__traceback__
    if at is None:
        return ""
    while at.tb_next is not None:
        at = at.tb_next
    return f" ({Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno})"


# --- loading by name --------------------------------------------------------------------------


def load(spec: str, arguments: Sequence[str] = ()) -> Any:
    """Make the custom transport that the command line names.

    Args:
        spec: ``MODULE:CLASS`` or ``FILE.py:CLASS``; modules are also searched for in the current
            directory.
        arguments: Arguments of the class, as text.

    Raises:
        TransportError: It cannot be imported or made; the text has the reason.
    """
    module_name, colon, name = spec.rpartition(":")
    if not colon or not module_name or not name.isidentifier():
        raise TransportError(
            errno.EINVAL, f"{spec!r} names no class: write MODULE:CLASS or FILE.py:CLASS"
        )
    module = _module(module_name)
    make = getattr(module, name, None)
    if not callable(make):
        raise TransportError(
            errno.EINVAL, f"{module_name} has no class {name}: it must have open(), close(),"
            " read(timeout) and write(data, peer)",
        )  # fmt: skip
    try:
        return make(*arguments)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # others' code
        raise TransportError(
            errno.EINVAL,
            f"{name}({', '.join(map(repr, arguments))}) raised {_said(error)}"
            " (its arguments are those of --argument)",
        ) from error


def _module(name: str) -> ModuleType:
    try:
        if name.endswith(".py"):
            path = Path(name)
            spec = importlib.util.spec_from_file_location(path.stem, path)
            if spec is None or spec.loader is None:
                raise ImportError("not a Python file")
            module = importlib.util.module_from_spec(spec)
            sys.modules.setdefault(path.stem, module)
            spec.loader.exec_module(module)
            return module
        if "" not in sys.path and str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(error.name + ".")):
            text = f"there is no module {name}: give the file, as in ./{name}.py:CLASS"
        else:
            text = f"{name} needs {error.name}, which is not installed: install it first"
        raise TransportError(errno.ENOENT, text) from error
    except FileNotFoundError as error:
        raise TransportError(errno.ENOENT, f"there is no file {name}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # others' code
        raise TransportError(errno.EINVAL, f"{name} cannot be imported: {_said(error)}") from error
