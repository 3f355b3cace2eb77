"""The board's USB device, and the host's port that it is connected to.

The line is a real pseudo-terminal under a constant name. As with a real USB serial port, it exists
only while the device is plugged in and configured, unplugging hangs up on programs that have it
open, and the board knows whether a program has it open (DTR). While none has, nothing is sent:
:meth:`UsbCdc.write` accepts 0 bytes, as an endpoint whose packets are not fetched, and data that a
program left unread is discarded when it closes the port. So the next program gets no stale bytes.

Data that the firmware does not read is held back, not lost: first in 2048 bytes on the board, then
on the host, until the program's writes block.

Enumeration takes a few milliseconds. A host that finds errors in the descriptors does not configure
the device and gives the reason (:attr:`UsbCdc.error`).

Only Linux tells whether a program has a pseudo-terminal open. On other systems a configured port
counts as open, and a program that opens it has to flush it.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import tempfile
import termios
import threading
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ....agent.transports.baud import BAUD_RATES, baud_rate, set_baud_rate
from ....agent.transports.terminal import open_pseudo_terminal
from ....middleware.wakeup_fd import WakeupFd
from .clock import BoardClock
from .usb_descriptors import (
    CONFIGURATION_DESCRIPTOR,
    DEVICE_DESCRIPTOR,
    PACKET,
    STRINGS,
    DescriptorError,
    UsbIdentity,
    check_descriptors,
)

__all__ = [
    "ATTACHED",
    "CONFIGURATION_DESCRIPTOR",
    "CONFIGURED",
    "DETACHED",
    "DEVICE_DESCRIPTOR",
    "ENUMERATION_US",
    "RECEIVE_BUFFER",
    "STRINGS",
    "SUSPENDED",
    "TELLS_OPEN",
    "DescriptorError",
    "UsbCdc",
    "UsbIdentity",
    "check_descriptors",
]

RECEIVE_BUFFER: Final = 2048
ENUMERATION_US: Final = 5_000

DETACHED: Final = "detached"
ATTACHED: Final = "attached"
CONFIGURED: Final = "configured"
SUSPENDED: Final = "suspended"

TELLS_OPEN: Final = sys.platform == "linux"
"""Whether this system tells if a program has a pseudo-terminal open."""

_BAUD: Final = 115_200


class _Line:
    """A pseudo-terminal with the board at its master, and a link to its slave."""

    def __init__(self, path: Path, baud: int) -> None:
        self.master, slave = open_pseudo_terminal()
        self._slave = -1
        self._path = path
        try:
            tty.setraw(slave)
            set_baud_rate(slave, baud)
            os.set_blocking(self.master, False)
            self.device = os.ttyname(slave)
            fresh = path.with_name(f"{path.name}.{os.getpid()}")
            with contextlib.suppress(FileNotFoundError):
                fresh.unlink()
            fresh.symlink_to(self.device)
            os.replace(fresh, path)
        except BaseException:
            os.close(self.master)
            os.close(slave)
            raise
        # With the slave closed here, Linux reports at the master whether others have it open.
        if TELLS_OPEN:
            os.close(slave)
        else:
            self._slave = slave
        self._was_open = False
        self._hang_up = select.poll()
        self._hang_up.register(self.master, 0)

    def is_open(self) -> bool:
        return not TELLS_OPEN or not self._hang_up.poll(0)

    def notice(self) -> bool:
        """Return whether the line was opened or closed since the last call.

        Discards data that a program had not read when it closed the line.
        """
        is_open = self.is_open()
        if is_open == self._was_open:
            return False
        self._was_open = is_open
        if not is_open:
            with contextlib.suppress(OSError):
                slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    termios.tcflush(slave, termios.TCIFLUSH)
                finally:
                    os.close(slave)
        return True

    def rate(self) -> int:
        """Return the baud rate that the program at the slave has set, 0 if it is unknown."""
        try:
            return baud_rate(self.master)
        except OSError:  # not Linux
            speed = termios.tcgetattr(self.master)[5]
            return next((rate for rate, code in BAUD_RATES.items() if code == speed), 0)

    def read(self, size: int) -> bytes:
        try:
            return os.read(self.master, size)
        except OSError:  # nothing there, or closed by the program
            return b""

    def write(self, data: bytes | bytearray | memoryview) -> int:
        try:
            return os.write(self.master, data)
        except OSError:
            return 0

    def close(self) -> None:
        """Hang up and remove the link."""
        with contextlib.suppress(OSError):
            if os.readlink(self._path) == self.device:
                self._path.unlink()
        os.close(self.master)
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1


class UsbCdc:
    """A USB serial port, both ends.

    The methods :meth:`enable` to :meth:`wait` are for the firmware. As on a microcontroller
    without a USB task, enumeration ends and bytes are received only when one of them is called.
    Any method may be called from any thread, but only one thread may wait.

    Args:
        clock: The board's clock; by default a new one.
        path: Where the link to the line is created, by default in a temporary folder that
            :meth:`close` removes. An existing link is replaced.
        name: The name of the link in the temporary folder.

    Raises:
        FileExistsError: ``path`` exists and is not a link.
        FileNotFoundError: There is no folder for ``path``.

    Attributes:
        path: The link to the line.
        plugged: Whether the cable is plugged in.
        baud: The baud rate of a new line, until a program on the host sets another one.
        error: Why the host refused the device; "" if it did not.
        identity: What the host read from the descriptors; None unless configured.
    """

    def __init__(
        self,
        clock: BoardClock | None = None,
        path: str | Path | None = None,
        name: str = "board",
    ) -> None:
        self._clock = clock if clock is not None else BoardClock()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if path is None:
            self._folder = tempfile.TemporaryDirectory(prefix="uros-")
            path = Path(self._folder.name) / name
        self.path = Path(path)
        if self.path.exists() and not self.path.is_symlink():
            raise FileExistsError(f"{self.path} is there and no link; it is left alone")
        folder = self.path.parent
        if not folder.is_dir():
            raise FileNotFoundError(f"{self.path}: there is no folder {folder}: create it")
        self.plugged = True
        self.baud = _BAUD
        self.error = ""
        self.identity: UsbIdentity | None = None
        self._lock = threading.RLock()
        self._waiting = 0
        self._wake = WakeupFd()
        # The master of a terminal that is not open is always readable as "hung up", so that only
        # a change may end a wait: edge-triggered.
        self._epoll = select.epoll() if TELLS_OPEN else None
        if self._epoll is not None:
            self._epoll.register(self._wake.fileno(), select.EPOLLIN)
        self._changes = 0  # counts the changes that end a wait()
        self._reported = 0  # those that a wait() has returned for
        self._enabled: tuple[bytes, bytes, tuple[str, ...]] | None = None
        self._ready_at: int | None = None  # when enumeration ends
        self._line: _Line | None = None
        self._suspended = False
        self._received = bytearray()
        self._closed = False

    # The firmware's side.

    def enable(
        self, device_descriptor: bytes, configuration: bytes, strings: Sequence[str]
    ) -> None:
        """Enable the device; ``strings[0]`` has index 1.

        If the device was enabled already, the host sees it disconnect and connect again.
        """
        with self._lock:
            self.disable()
            self._enabled = bytes(device_descriptor), bytes(configuration), tuple(strings)
            self._enumerate()

    def disable(self) -> None:
        """Disable the device; the host sees it disconnect."""
        with self._lock:
            self._enabled = None
            self.error = ""
            self._detach()

    @property
    def state(self) -> str:
        """State of the device: DETACHED, ATTACHED, CONFIGURED or SUSPENDED.

        DETACHED: not plugged in, or disabled. ATTACHED: not configured by the host, yet or at all
        (see :attr:`error`).
        """
        with self._lock:
            self._poll()
            if self._line is not None:
                return SUSPENDED if self._suspended else CONFIGURED
            return ATTACHED if self.plugged and self._enabled is not None else DETACHED

    def is_open(self) -> bool:
        """Return whether a program on the host has the port open, also while suspended."""
        with self._lock:
            self._poll()
            return self._line is not None and self._line.is_open()

    def baud_rate(self) -> int:
        """Return the baud rate that the program on the host has set; 0 if the port is not open."""
        with self._lock:
            if self._line is None or not self._line.is_open():
                return 0
            return self._line.rate()

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Send without waiting; return how many bytes were accepted.

        None are accepted unless the port is configured, not suspended and open.
        """
        with self._lock:
            self._poll()
            if self._line is None or self._suspended or not self._line.is_open() or not data:
                return 0
            return self._line.write(data)

    def read(self, size: int) -> bytes:
        """Return up to ``size`` received bytes, without waiting."""
        with self._lock:
            self._poll()
            out = bytes(memoryview(self._received)[:size])
            del self._received[: len(out)]
            return out

    def any(self) -> int:
        """Return how many bytes can be read, up to the size of the buffer."""
        with self._lock:
            self._poll()
            return len(self._received)

    def wait(self, seconds: float | None) -> bool:
        """Wait until there is data to read, or the line has changed since the last wait.

        A change is: plugged, unplugged, configured, suspended, resumed, closed by a program. A
        program that opens the port ends the wait only with its first byte.

        Args:
            seconds: The longest time to wait; None: no limit.

        Returns:
            Whether there is data or a change, or the port is closed for good.
        """
        clock = self._clock
        deadline = None if seconds is None else clock.host_ns() + round(seconds * 1e9)
        while True:
            with self._lock:
                if self._closed:
                    return True
                self._wake.clear()
                if self._epoll is not None:
                    self._epoll.poll(0)
                self._poll()
                if self._received or self._reported != self._changes:
                    self._reported = self._changes
                    return True
                now = clock.host_ns()
                if deadline is not None and now >= deadline:
                    return False
                until = deadline
                if self._ready_at is not None:
                    ready = now + 1000 * (self._ready_at - clock.world_us())
                    until = ready if until is None else min(until, ready)
                fds = self._watched()
                self._waiting += 1
            try:
                clock.select(fds, None if until is None else max(0, until - now) / 1e9)
            finally:
                with self._lock:
                    self._waiting -= 1
                    self._close_waiting()

    # The host's side.

    def plug(self) -> None:
        """Plug in the cable; the host enumerates the device if it is enabled."""
        with self._lock:
            if not self.plugged and not self._closed:
                self.plugged = True
                self._enumerate()

    def unplug(self) -> None:
        """Unplug the cable; programs that have the port open see it hang up."""
        with self._lock:
            self.plugged = False
            self._detach()

    def suspend(self) -> None:
        """Suspend the device: the port stays, data waits.

        Does nothing without a configured device.
        """
        with self._lock:
            if self._line is not None and not self._suspended:
                self._suspended = True
                self._changed()

    def resume(self) -> None:
        """Resume the device; data continues."""
        with self._lock:
            if self._suspended:
                self._suspended = False
                self._changed()

    @property
    def suspended(self) -> bool:
        """Whether the host has suspended the device."""
        return self._suspended

    def close(self) -> None:
        """Unplug for good; a wait ends."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self.plugged = False
            self._detach()
            self._close_waiting()
        if self._folder is not None:
            self._folder.cleanup()

    # With the lock held.

    def _changed(self) -> None:
        self._changes += 1
        self._wake.set()

    def _watched(self) -> list[int]:
        if self._epoll is not None:
            return [self._epoll.fileno()]
        fds = [self._wake.fileno()]
        if self._line is not None and not self._suspended:
            fds.append(self._line.master)
        return fds

    def _close_waiting(self) -> None:
        """When closed, close the descriptors of waits as the last thread leaves its wait."""
        if self._closed and not self._waiting:
            self._wake.close()
            if self._epoll is not None:
                self._epoll.close()

    def _enumerate(self) -> None:
        if self.plugged and self._enabled is not None:
            self.error = ""
            self._ready_at = self._clock.world_us() + ENUMERATION_US
            self._changed()

    def _detach(self) -> None:
        self._ready_at = None
        self._suspended = False
        self.identity = None
        self._received.clear()
        self._changed()
        if self._line is not None:
            self._line.close()
            self._line = None

    def _poll(self) -> None:
        """End enumeration when it is due, and receive packets."""
        if self._ready_at is not None and self._clock.world_us() >= self._ready_at:
            self._ready_at = None
            self._configure()
        if self._line is None or self._suspended:
            return
        while len(self._received) + PACKET <= RECEIVE_BUFFER:
            chunk = self._line.read(RECEIVE_BUFFER - len(self._received))
            if not chunk:
                break
            self._received += chunk
        if self._line.notice():
            self._changed()

    def _configure(self) -> None:
        assert self._enabled is not None
        try:
            self.identity = check_descriptors(*self._enabled)
            self._line = _Line(self.path, self.baud)
            if self._epoll is not None:
                self._epoll.register(self._line.master, select.EPOLLIN | select.EPOLLET)
        except DescriptorError as error:
            self.error = str(error)
        except OSError as error:
            self.error = f"no line: {error}"
        self._changed()
