"""Serial lines by pyserial, for systems without termios and for pyserial's URLs.

pyserial blocks when it opens, reads and writes, so one thread opens and reads and another one
writes; the agent's thread is notified through a pair of sockets. The extra ``serial`` of uros
installs pyserial.
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
from .serial_device import DeviceServer, is_url

# How long the reading thread blocks if it cannot be interrupted, in seconds.
_SLICE: Final = 0.2
# Timeout of a write, in seconds.
_WRITE_SECONDS: Final = 2.0
# How long closing waits for the thread, which closes the port, in seconds.
_JOIN_SECONDS: Final = 1.0
_CHUNK: Final = 4096
# Timeout of a write of a board's program, in seconds.
_PORT_WRITE_SECONDS: Final = 0.02
# Bytes read and not handled yet; further ones stay in the system, as with a descriptor.
_MAX_INBOX: Final = 256 * 1024


def check_pyserial(device: str, baud: int) -> None:
    """Raise TransportError if ``device`` can never be opened: no pyserial, unknown scheme."""
    _made(device, baud, None, None)


def _made(
    device: str, baud: int, dtr: bool | None, rts: bool | None,
    write_seconds: float = _WRITE_SECONDS,
) -> Any:  # fmt: skip
    """Make a port of pyserial that is not open yet."""
    try:
        import serial
    except ImportError:
        serial = None
    if not hasattr(serial, "serial_for_url"):  # another package of that name
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
    except (ValueError, re.error) as error:  # re.error: of hwgrep://
        raise TransportError(
            errno.EINVAL, f"{device}: {error}; pyserial has socket://, rfc2217://, loop://, hwgrep://"
        ) from error  # fmt: skip
    # Set before opening, so that the port is opened with these levels if the system supports that.
    if dtr is not None:
        port.dtr = dtr
    if rts is not None:
        port.rts = rts
    if not is_url(device):
        port.exclusive = True
    return port


def reason(device: str, error: Exception) -> tuple[int, str]:
    """Return the errno of an exception of pyserial, 0 if it has none; and the remedy."""
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
    """A :class:`~uros.agent.transports.line.Stream` over a pyserial port, opened in a thread.

    ``opened`` and ``error`` have the result of opening, once the descriptor is readable.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self.opened = False
        self.error: Exception | None = None
        self._make = make
        self._lock = threading.Condition()
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._shut = False  # closed by the agent: its descriptor is closed
        self._ended = False  # closed by an error or the end of the line
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
        """Make the thread close the port soon; :meth:`join` waits for that."""
        with self._lock:
            self._shut = True
            self._lock.notify_all()
            self._ours.close()
            self._theirs.close()
            port = self._port
        for cancel in ("cancel_read", "cancel_write"):
            try:
                getattr(port, cancel)()
            except Exception:  # not every port has these methods, and it may be closed by now
                pass

    def join(self) -> None:
        """Wait until the port is closed, for a limited time: it may block on a network."""
        self._reader.join(_JOIN_SECONDS)

    # --- the other threads --------------------------------------------------------

    def _wake(self) -> None:
        """Make the descriptor readable; called with the lock held."""
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
        except Exception as error:  # pyserial raises many kinds of exceptions
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

        # Half a second of data at a time, so that no write times out on a slow line.
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
                pass  # partly sent; the receiver resynchronises at the next frame
            except Exception as error:  # likewise
                self._end(error)
                return
            with self._lock:
                del self._outbox[: len(chunk)]


class PySerialServer(DeviceServer):
    """A device or URL by pyserial, on any system; see :class:`~.serial_device.DeviceServer`.

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
        """Handle the result of opening."""
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
    """A port of pyserial for a program at the board's end of the line.

    Raises TransportError for a port that can never be opened.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        check_pyserial(path, baud)
        self.path = path
        self._baud = baud
        self._port: Any = None
        self._waited = b""  # bytes that wait() has read

    def open(self) -> None:
        """Open the port; raises OSError with the remedy."""
        self.close()
        try:
            port = _made(self.path, self._baud, None, None, _PORT_WRITE_SECONDS)
            port.open()
            port.reset_input_buffer()
        except TransportError:
            raise
        except Exception as error:  # pyserial raises many kinds of exceptions
            number, why = reason(self.path, error)
            raise OSError(number or errno.EIO, why) from error
        self._port = port

    def close(self) -> None:
        """Close the port; idempotent."""
        port, self._port = self._port, None
        self._waited = b""
        if port is not None:
            port.close()

    def read(self, size: int) -> bytes | None:
        """Read bytes; see :class:`~uros.transport.serial.Port`."""
        data, self._waited = self._waited, b""
        if data:
            return data
        port = self._open_port()
        waiting = min(size, port.in_waiting)
        return bytes(port.read(waiting)) if waiting else None

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Write, see :class:`~uros.transport.serial.Port`; bytes not taken in time are lost."""
        from serial import SerialTimeoutException

        try:
            self._open_port().write(bytes(data))
        except SerialTimeoutException:
            pass  # an unknown part of it was sent: the receiver skips the frame
        return len(data)

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is something to read, or for so many milliseconds."""
        if not self._waited:
            port = self._open_port()
            port.timeout = timeout_ms / 1000
            self._waited = bytes(port.read(1))

    def _open_port(self) -> Any:
        if self._port is None:
            raise OSError(errno.EBADF, f"{self.path} is not open")
        return self._port
