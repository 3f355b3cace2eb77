"""Serial lines at the agent's end: devices, and a pseudo-terminal of our own.

Frames are found in the stream whatever else is on it, a board's ``printf``
for one. A device that is missing, not permitted or unplugged is waited for:
a board that is plugged in again goes on where it was.
"""

from __future__ import annotations

import errno
import fcntl
import os
import termios
import tty
from pathlib import Path
from typing import Any, Final

from ..wire.framing import FLAG, Deframer, frame, frame_size
from .base import ERROR, INFO, WARNING, Host, ServerTransport, TransportError

AGENT_ADDRESS: Final = 0
# How often a device that is away is looked for, in seconds.
RETRY: Final = 0.5
# A line that takes nothing for so long loses messages, as a full UART does.
MAX_UNSENT: Final = 256 * 1024
_CHUNK: Final = 4096
# Lines that carry frames have few bad bytes; this many in a row say something, twice as
# many say it again.
_SUSPICIOUS: Final = 512

BAUD_RATES: Final = {
    int(name[1:]): getattr(termios, name)
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit() and name != "B0"
}


def check_baud_rate(rate: int) -> int:
    """The termios constant. Raises TransportError naming the rates there are."""
    if rate not in BAUD_RATES:
        known = ", ".join(str(it) for it in sorted(BAUD_RATES))
        raise TransportError(
            errno.EINVAL, f"baud rate {rate} does not exist here; there are {known}"
        )
    return int(BAUD_RATES[rate])


class LineServer(ServerTransport):
    """One line. A peer is the source address of its frames: boards are 1 and up."""

    name = "SerialAgent"
    kind = "SERIAL"

    def __init__(self) -> None:
        super().__init__()
        self.fd = -1
        self.deframer = Deframer(AGENT_ADDRESS)
        self._unsent = bytearray()
        self._suspected = 0
        self._patience = _SUSPICIOUS
        self._host: Host | None = None

    def _watch(self) -> None:
        assert self._host is not None
        self._host.watch(self.fd, self._ready, bool(self._unsent))

    def _ready(self) -> None:
        if self._unsent:
            self._push()
        host = self._host
        if self.fd < 0 or host is None:
            return
        try:
            chunk = os.read(self.fd, _CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not chunk:
            self._lost("end of file")
            return
        now = host.now()
        deframer = self.deframer
        at = 0
        while at < len(chunk):  # a frame at a time, because each has a source
            stop = chunk.find(FLAG, at + 1)
            stop = stop if stop >= 0 else len(chunk)
            for message in deframer.feed(chunk[at:stop]):
                self._suspected = deframer.skipped
                self._patience = _SUSPICIOUS
                buf = bytearray(message)
                self.deliver(host, deframer.source, buf, memoryview(buf), len(buf), now)
            at = stop
        if deframer.skipped - self._suspected > self._patience:
            self._suspected = deframer.skipped
            self._patience *= 2
            host.note(
                WARNING, self.name, "receive", "no frames among the bytes",
                f"skipped: {self.deframer.skipped}, crc_errors: {self.deframer.crc_errors}"
                " (wrong baud rate, or a program that does not speak micro-ROS?)",
            )  # fmt: skip

    def _lost(self, why: str) -> None:
        """The line is gone."""
        self._drop_fd()

    def _drop_fd(self) -> None:
        if self.fd >= 0:
            if self._host is not None:
                self._host.unwatch(self.fd)
            os.close(self.fd)
            self.fd = -1
        self._unsent.clear()

    def send(self, peer: int, datagram: bytes) -> None:
        if self.fd < 0 or len(self._unsent) > MAX_UNSENT:
            return
        out = bytearray(frame_size(datagram))
        size = frame(datagram, AGENT_ADDRESS, peer, out)
        waiting = bool(self._unsent)
        self._unsent += memoryview(out)[:size]
        if not waiting:
            self._push()

    def _push(self) -> None:
        try:
            sent = os.write(self.fd, self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        del self._unsent[:sent]
        self._watch()

    def close(self) -> None:
        self._drop_fd()


class SerialServer(LineServer):
    """A device. ``device`` may be a file that holds the device's name (``is_file``)."""

    def __init__(self, device: str, baud: int = 115200, is_file: bool = False) -> None:
        super().__init__()
        self._device = device
        self._speed = check_baud_rate(baud)
        self._baud = baud
        self._is_file = is_file
        self._closed = False
        self._said = ""

    def open(self, host: Host) -> None:
        self._host = host
        self._try()

    def _path(self) -> str:
        if not self._is_file:
            return self._device
        try:
            return Path(self._device).read_text().strip()
        except UnicodeDecodeError:
            raise OSError(errno.EINVAL, "not a text file") from None

    def _try(self) -> None:
        host = self._host
        if self._closed or host is None:
            return
        try:
            path = self._path()
            fd = open_device(path, self._speed)
        except (OSError, termios.error) as error:
            self._wait(error)
            return
        self._said = ""
        self.fd = fd
        self._watch()
        host.note(
            INFO, self.name, "init", "running...", f"dev: {path}, baudrate: {self._baud}"
        )

    def _wait(self, error: Exception) -> None:
        """Say once what is the matter, and try again until it is mended."""
        host = self._host
        assert host is not None
        number = error.args[0] if error.args else 0
        said = trouble(self._device, number)
        if number == errno.ENOENT and self._is_file and not Path(self._device).exists():
            said = "errno: 2, the file that is to name the device is not there"
        if said != self._said:
            self._said = said
            level = INFO if number == errno.ENOENT else ERROR
            what = "waiting for device" if level == INFO else "open device error"
            host.note(level, self.name, "init", what, f"device: {self._device}, {said}")
        host.wake_at(RETRY, self._try)

    def _lost(self, why: str) -> None:
        self._drop_fd()
        self.deframer = Deframer(AGENT_ADDRESS)
        self._suspected = 0
        self._patience = _SUSPICIOUS
        if self._host is not None and not self._closed:
            self._host.note(
                WARNING, self.name, "receive", "device lost",
                f"device: {self._device}, {why}; waiting for it to come back",
            )  # fmt: skip
            self._host.wake_at(RETRY, self._try)

    def address(self, peer: int) -> str:
        return f"{self._device} ({peer})"

    def close(self) -> None:
        self._closed = True
        super().close()


def open_device(path: str, speed: int) -> int:
    """Open a serial device for us alone, raw and not blocking; the descriptor.

    ``speed`` is what check_baud_rate gave. Raises OSError or termios.error.
    """
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(fd)
        attributes: list[Any] = termios.tcgetattr(fd)
        attributes[2] |= termios.CREAD | termios.CLOCAL | termios.CS8
        attributes[2] &= ~(termios.PARENB | termios.CSTOPB | getattr(termios, "CRTSCTS", 0))
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        termios.tcflush(fd, termios.TCIOFLUSH)
    except BaseException:
        os.close(fd)
        raise
    return fd


def trouble(device: str, number: int) -> str:
    """What an errno of opening ``device`` means, and what to do."""
    if number == errno.ENOENT:
        return "errno: 2, it is not there: plug the board in, or see what there is: ls /dev/tty*"
    if number == errno.EACCES:
        return (
            "errno: 13, not permitted: sudo usermod -aG dialout $USER, then log in again;"
            f" or for now: sudo chmod a+rw {device}"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return (
            f"errno: {number}, in use by another program, perhaps a second agent:"
            f" see which with: fuser -v {device}"
        )
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"errno: {number}, this is not a serial device"
    return f"errno: {number}, {os.strerror(number)}"


class PseudoTerminalServer(LineServer):
    """A pseudo-terminal: a program opens the device whose name the log tells."""

    name = "PseudoTtyAgent"

    def __init__(self, baud: int = 115200) -> None:
        super().__init__()
        check_baud_rate(baud)
        self._slave = -1
        self.device = ""

    def open(self, host: Host) -> None:
        self._host = host
        try:
            master, slave = os.openpty()
        except OSError as error:
            raise TransportError(
                error.errno, f"no pseudo-terminal can be had: {error.strerror}"
            ) from error
        tty.setraw(slave)
        os.set_blocking(master, False)
        # Held open, so that the line outlives the programs that come and go.
        self._slave = slave
        self.device = os.ttyname(slave)
        self.fd = master
        self._watch()
        host.note(INFO, self.name, "init", "running...", f"dev: {self.device}")

    def address(self, peer: int) -> str:
        return f"{self.device} ({peer})"

    def close(self) -> None:
        super().close()
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1
