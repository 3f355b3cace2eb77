"""Serial lines by pyserial: where there is no termios, and for its URLs.

pyserial waits when it opens, reads and writes, so a thread opens and reads and
another one writes; the agent's thread hears of it by a pair of sockets. The
extra ``serial`` of uros installs it.
"""

from __future__ import annotations

import errno
import re
import socket
import threading
from collections.abc import Callable
from typing import Any, Final

from .base import Host, TransportError
from .remedies import trouble
from .serial import DeviceServer, is_url

# How long the reading thread waits where nothing can wake it, in seconds.
_SLICE: Final = 0.2
# A write that takes longer has met a line that takes nothing.
_WRITE_SECONDS: Final = 2.0
# How long the end waits for the thread, which closes the port, in seconds.
_FAREWELL: Final = 1.0
_CHUNK: Final = 4096
# What a board's program waits for a line to take a frame, in seconds.
_PORT_WRITE_SECONDS: Final = 0.02
# What is read and not yet handled; more stays in the system, as on a descriptor.
_MAX_INBOX: Final = 256 * 1024


def check_pyserial(device: str, baud: int) -> None:
    """Raises TransportError where ``device`` will never open: no pyserial, no such scheme."""
    _made(device, baud, None, None)


def _made(
    device: str, baud: int, dtr: bool | None, rts: bool | None,
    write_seconds: float = _WRITE_SECONDS,
) -> Any:  # fmt: skip
    """A port of pyserial's that is not open yet."""
    try:
        import serial
    except ImportError:
        serial = None
    if not hasattr(serial, "serial_for_url"):  # there is another package of that name
        raise TransportError(
            errno.ENOSYS, f"{device} needs pyserial: python -m pip install pyserial"
        )
    assert serial is not None
    if baud <= 0:
        raise TransportError(
            errno.EINVAL, f"baud rate {baud} does not exist; such as 115200 or 921600"
        )
    try:
        port = serial.serial_for_url(
            device, baud, do_not_open=True, timeout=_SLICE,
            # Its socket has a timeout of its own, and it refuses to open with this one.
            write_timeout=None if device.lower().startswith("rfc2217:") else write_seconds,
        )  # fmt: skip
    except (ValueError, re.error) as error:  # the latter of hwgrep://
        raise TransportError(
            errno.EINVAL, f"{device}: {error}; pyserial has socket://, rfc2217://, loop://, hwgrep://"
        ) from error  # fmt: skip
    # Before it is opened: then the port opens with them so, where the system can do that.
    if dtr is not None:
        port.dtr = dtr
    if rts is not None:
        port.rts = rts
    if not is_url(device):
        port.exclusive = True
    return port


def reason(device: str, error: Exception) -> tuple[int, str]:
    """The errno of what pyserial raised, 0 where there is none to be had; and what to do."""
    if isinstance(error, TransportError):
        return 0, str(error.strerror)
    number = getattr(error, "errno", None)
    text = " ".join(str(error).split())
    if not number and "FileNotFoundError" in text:  # Windows: pyserial keeps only the text
        number = errno.ENOENT
    if not number and ("PermissionError" in text or "Access is denied" in text):
        number = errno.EACCES
    if number:
        return number, trouble(device, number)
    return 0, f"{text or type(error).__name__} (see that what offers the line runs)"


class ThreadedPort:
    """A :class:`~uros.agent.transports.line.Stream` of an open pyserial port, and its opening.

    ``opened`` and ``error`` tell how the opening went, once the descriptor is readable.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self.opened = False
        self.error: Exception | None = None
        self._make = make
        self._lock = threading.Condition()
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._shut = False  # by the agent: its descriptor is closed
        self._ended = False  # by itself
        self._port: Any = None
        self._ours, self._theirs = socket.socketpair()
        for end in (self._ours, self._theirs):
            end.setblocking(False)
        self._reader = threading.Thread(target=self._read_all, name="uros-serial", daemon=True)
        self._reader.start()

    # --- the agent's thread -------------------------------------------------------

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self._ours.fileno()

    def read(self, size: int) -> bytes:
        """Read up to ``size`` bytes."""
        with self._lock:
            try:
                self._ours.recv(_CHUNK)
            except BlockingIOError:
                pass
            chunk = bytes(self._inbox[:size])
            del self._inbox[:size]
            if self._inbox or self.error is not None:
                self._wake()
            self._lock.notify_all()
            if chunk:
                return chunk
            if self.error is not None:
                text = " ".join(str(self.error).split()) or type(self.error).__name__
                raise OSError(errno.EIO, text)
        raise BlockingIOError

    def write(self, data: bytearray) -> int:
        """Write; return how many bytes were taken."""
        with self._lock:
            self._outbox += data
            self._lock.notify_all()
        return len(data)

    def backlog(self) -> int:
        """Return the bytes that wait for the writing thread."""
        return len(self._outbox)

    def close(self) -> None:
        """The thread closes the port, soon; :meth:`join` waits for that."""
        with self._lock:
            self._shut = True
            self._lock.notify_all()
            self._ours.close()
            self._theirs.close()
            port = self._port
        for cancel in ("cancel_read", "cancel_write"):
            try:
                getattr(port, cancel)()
            except Exception:  # not every port has these, and it may be closed by now
                pass

    def join(self) -> None:
        """Until the port is closed, but not for long: it may be waiting for a network."""
        self._reader.join(_FAREWELL)

    # --- the other threads --------------------------------------------------------

    def _wake(self) -> None:
        """Make the descriptor readable; with the lock held."""
        if not self._shut:
            try:
                self._theirs.send(b"\0")
            except BlockingIOError:
                pass  # readable already

    def _end(self, error: Exception) -> None:
        with self._lock:
            if self.error is None:
                self.error = error
            self._wake()
            self._lock.notify_all()

    def _read_all(self) -> None:
        try:
            port = self._make()
            port.open()
        except Exception as error:  # pyserial raises what its ports raise, many kinds
            self._end(error)
            return
        writer = threading.Thread(
            target=self._write_all, args=(port,), name="uros-serial-out", daemon=True
        )
        try:
            port.reset_input_buffer()
            with self._lock:
                self._port = port
                self.opened = True
                self._wake()
            writer.start()
            while not self._shut and self.error is None:
                data = port.read(max(1, min(_CHUNK, port.in_waiting)))
                if data:
                    self._took(data)
        except Exception as error:  # likewise
            self._end(error)
        finally:
            with self._lock:
                self._ended = True
                self._lock.notify_all()
            if writer.ident is not None:
                writer.join(_WRITE_SECONDS)
            try:
                port.close()
            except Exception:  # unplugged
                pass

    def _took(self, data: bytes) -> None:
        with self._lock:
            while len(self._inbox) >= _MAX_INBOX and not self._shut:
                self._lock.wait()
            if not self._inbox:
                self._wake()
            self._inbox += data

    def _write_all(self, port: Any) -> None:
        from serial import SerialTimeoutException

        # Half a second's worth, so that no write can be too long for a slow line.
        size = max(16, min(_CHUNK, port.baudrate // 20))
        while True:
            with self._lock:
                while not self._outbox and not self._shut and not self._ended:
                    self._lock.wait()
                if self._shut or self._ended:
                    return
                chunk = bytes(self._outbox[:size])
            try:
                port.write(chunk)
            except SerialTimeoutException:
                pass  # nobody knows how much of it went; the next frame begins anew
            except Exception as error:  # likewise
                self._end(error)
                return
            with self._lock:
                del self._outbox[: len(chunk)]


class PySerialServer(DeviceServer):
    """A device or URL by pyserial, on any system. See :class:`~.serial.DeviceServer`.

    Raises TransportError for what will never work; what is only missing is waited for.
    """

    def __init__(
        self, device: str, baud: int = 115200, is_file: bool = False, dtr: bool | None = None,
        rts: bool | None = None,
    ) -> None:  # fmt: skip
        super().__init__(device, baud, is_file, dtr, rts)
        check_pyserial("loop://" if is_file else device, baud)
        self._port: ThreadedPort | None = None

    def _begin(self, host: Host) -> None:
        try:
            path = self._path()
        except OSError as error:
            self._wait(*reason(self.device, error))
            return
        port = ThreadedPort(lambda: _made(path, self._baud, self._dtr, self._rts))
        self._port = port
        host.watch(port.fileno(), lambda: self._look(host, port, path))

    def _look(self, host: Host, port: ThreadedPort, path: str) -> None:
        """The opening has ended."""
        host.unwatch(port.fileno())
        if port.opened:
            self._opened(port, f"dev: {path}, baudrate: {self._baud}")
            return
        error = port.error or OSError(errno.EIO, "not open")
        self._port = None
        port.close()
        self._wait(*reason(self.device, error))

    def close(self) -> None:
        """Close everything; idempotent."""
        super().close()
        port, self._port = self._port, None
        if port is not None:
            if self._host is not None and port.fileno() >= 0:
                self._host.unwatch(port.fileno())
            port.close()
            port.join()


class PySerialPort:
    """A board's program on a line of pyserial's: as :class:`~.device.DevicePort`.

    Raises TransportError for a port that will never open.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        check_pyserial(path, baud)
        self.path = path
        self._baud = baud
        self._port: Any = None
        self._waited = b""  # what wait() has read

    def open(self) -> None:
        """Raises OSError with a text that says what to do."""
        self.close()
        try:
            port = _made(self.path, self._baud, None, None, _PORT_WRITE_SECONDS)
            port.open()
            port.reset_input_buffer()
        except TransportError:
            raise
        except Exception as error:  # pyserial raises what its ports raise, many kinds
            number, why = reason(self.path, error)
            raise OSError(number or errno.EIO, why) from error
        self._port = port

    def close(self) -> None:
        """Twice is once."""
        port, self._port = self._port, None
        self._waited = b""
        if port is not None:
            port.close()

    def read(self, size: int) -> bytes | None:
        """See :class:`~uros.transport.serial.Port`."""
        data, self._waited = self._waited, b""
        if data:
            return data
        port = self._open_port()
        waiting = min(size, port.in_waiting)
        return bytes(port.read(waiting)) if waiting else None

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See :class:`~uros.transport.serial.Port`; what it does not take soon is lost."""
        from serial import SerialTimeoutException

        try:
            self._open_port().write(bytes(data))
        except SerialTimeoutException:
            pass  # how much of it went nobody knows: a frame cut short is skipped
        return len(data)

    def wait(self, timeout_ms: int) -> None:
        """Until there is something to read, or that long."""
        if not self._waited:
            port = self._open_port()
            port.timeout = timeout_ms / 1000
            self._waited = bytes(port.read(1))

    def _open_port(self) -> Any:
        if self._port is None:
            raise OSError(errno.EBADF, f"{self.path} is not open")
        return self._port
