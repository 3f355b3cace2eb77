"""The system calls of the firmware, carried out on the virtual board.

This is the host's side of ``shims/_board.py``.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ..hardware.board import Interrupts
from ..hardware.resets import DEEP_SLEEP, HARD, SOFT
from ..hardware.usb import CONFIGURED, DETACHED, SUSPENDED
from ..shims import _ops as ops
from .advice import advice
from .cores import CoreHost, Mail
from .peripheral_syscalls import INTERRUPT_US, PeripheralHost
from .pin_syscalls import PinHost

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard
    from ..hardware.i2c import I2CBus

_TICKS: Final = (1 << 30) - 1  # MicroPython's counters are as wide as its small integers
_RTC_EPOCH_NS: Final = 946_684_800 * 10**9
_CORE_HZ: Final = 200_000_000
_TRANSFER: Final = struct.Struct("<BBBH")
_CONFIGURED: Final = (CONFIGURED, SUSPENDED)
# The period at which a wait polls for changes that do not wake it.
_POLL_NS: Final = 5_000_000


class Reset(BaseException):
    """The board starts anew; a BaseException, so that handlers of the firmware do not catch it.

    Args:
        cause: Why, a constant of `uros.boards.virtual.hardware.resets`.
        sleep_ms: How long it sleeps before, 0 for ever; None: it does not sleep.
    """

    def __init__(self, cause: int = SOFT, sleep_ms: int | None = None) -> None:
        super().__init__()
        self.cause = cause
        self.sleep_ms = sleep_ms


class BoardHost:
    """Carries out the system calls of one core, from one thread.

    Args:
        board: The virtual board.
        console: Called with what the firmware prints.
        ended: Called with the traceback (or "") of a program that has ended.
        heap: Called with the octets in use on the heap, and their peak.
        usb: Called with the state of the USB line when it has changed.
        idle: Called when the firmware is about to wait, for work that is not urgent.
        mail: The mailboxes between the cores; by default new ones.
        start_core: Starts the second core with a module; None if this is the second core.
    """

    def __init__(
        self,
        board: VirtualBoard,
        console: Callable[[str], None],
        ended: Callable[[str], None],
        heap: Callable[[int, int], None],
        usb: Callable[[str], None],
        idle: Callable[[], None] = lambda: None,
        mail: Mail | None = None,
        start_core: Callable[[str], None] | None = None,
    ) -> None:
        self._board = board
        self._mail = mail if mail is not None else Mail()
        interrupts = self._interrupts = Interrupts()
        self._idle = idle
        self._heap = heap
        self._usb = usb
        self._last_usb = DETACHED, ""
        self._reset_asked = 0  # the cause of the reset
        self._within = False  # in a system call or a reset, which another reset must not interrupt
        self.print = console
        self.ended = ended
        self._operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.CONSOLE: self._print,
            ops.TICKS_MS: lambda _: board.clock.ticks_us() // 1000 & _TICKS,
            ops.TICKS_US: lambda _: board.clock.ticks_us() & _TICKS,
            ops.EPOCH: lambda _: struct.pack("<q", board.clock.epoch_ns() - _RTC_EPOCH_NS),
            ops.EPOCH_SET: self._set_epoch,
            ops.SLEEP: self._sleep,
            ops.I2C_INIT: self._i2c_init,
            ops.I2C_TRANSFER: self._i2c_transfer,
            ops.I2C_SCAN: lambda data: bytes(self._bus(data[0]).scan()),
            ops.USB_ENABLE: self._usb_enable,
            ops.USB_DISABLE: self._usb_disable,
            ops.USB_STATE: lambda _: self._usb_flags(),
            ops.USB_WRITE: lambda data: board.usb.write(data),
            ops.USB_READ: lambda data: board.usb.read(int.from_bytes(data, "little")),
            ops.USB_ANY: lambda _: board.usb.any(),
            ops.USB_WAIT: self._usb_wait,
            ops.RESET: self._reset,
            ops.RESET_CAUSE: lambda _: board.resets.cause,
            ops.WDT_FEED: self._feed,
            ops.DEEPSLEEP: self._deep_sleep,
            ops.RTC_MEMORY: self._rtc_memory,
            ops.UNIQUE_ID: lambda _: board.unique_id,
            ops.FREQUENCY: lambda _: _CORE_HZ,
            ops.ENDED: self._end,
            ops.HEAP: self._report_heap,
            ops.ADVICE: lambda data: advice(board, data),
            **PinHost(board, interrupts).operations,
            **PeripheralHost(board, self._before_wait, interrupts, console).operations,
            **CoreHost(self._mail, start_core).operations,
        }

    def call(self, op: int, data: bytes = b"") -> bytes | int:
        """Carry out one operation; return octets, or a number where ``_ops`` defines one.

        Raises:
            OSError: The error for the firmware.
            Reset: The board is to start anew.
        """
        self._within = True
        try:
            self._board.advance()
            answer = self._operations[op](data)
        except (ValueError, KeyError, struct.error) as error:
            raise OSError(errno.EINVAL, str(error)) from error
        finally:
            self._within = False
        if self._reset_asked:
            raise Reset(self._reset_asked)
        return answer

    def ticks_formula(self) -> tuple[int, int, float, int] | None:
        """Return the result of `BoardClock.ticks_formula`."""
        return self._board.clock.ticks_formula()

    def ask_reset(self, cause: int = HARD) -> None:
        """Press the reset button; called in the program's thread, by a signal handler.

        Raises:
            Reset: At once; during a system call, its end raises Reset instead.
        """
        self._reset_asked = cause
        if not self._within:
            raise Reset(cause)

    def stop(self) -> None:
        """End the program of this core: its next system call raises Reset. Thread-safe."""
        self._reset_asked = HARD

    def begin_reset(self) -> None:
        """Keep another reset from interrupting what follows, up to :meth:`reset`."""
        self._within = True

    def reset(self, cause: int = HARD) -> None:
        """Reset the board around the processor: the host loses its USB device."""
        self._board.reset(cause)
        self._interrupts.clear()
        self._mail.clear()
        self.usb_state()
        self._reset_asked = 0
        self._within = False

    def usb_state(self) -> str:
        """Return the state of the USB line; report it if it or the error has changed."""
        with self._board.lock:  # one of several threads reports a change
            state = self._board.usb.state
            now = state, self._board.usb.error
            if now != self._last_usb:
                self._last_usb = now
                self._usb(state)
            return state

    # --- time -------------------------------------------------------------------------

    def _before_wait(self) -> None:
        self._let_reset()
        self._board.clock.hold(None)
        self._idle()

    def _let_reset(self) -> None:
        """From here on a reset interrupts the system call, also one that was asked for before."""
        self._within = False
        if self._reset_asked:
            raise Reset(self._reset_asked)

    def _set_epoch(self, data: bytes) -> bytes:
        (ns,) = struct.unpack("<q", data)
        self._board.clock.set_epoch_ns(_RTC_EPOCH_NS + ns)
        return b""

    def _sleep(self, data: bytes) -> int:
        us = int.from_bytes(data, "little")
        self._before_wait()
        board = self._board
        interrupts = self._interrupts
        if not interrupts.wanted:
            board.clock.sleep_us(us)
            return 0
        end = board.clock.ticks_us() + us
        while not interrupts.due:
            left = end - board.clock.ticks_us()
            if left <= 0:
                return 0
            board.clock.sleep_us(min(left, INTERRUPT_US))
            board.advance()
        return max(0, end - board.clock.ticks_us())

    # --- buses ------------------------------------------------------------------------

    def _bus(self, channel: int) -> I2CBus:
        return self._board.i2c[channel]

    def _i2c_init(self, data: bytes) -> bytes:
        channel, frequency, timeout = struct.unpack("<BII", data)
        bus = self._bus(channel)
        bus.frequency = frequency
        bus.timeout_us = timeout
        return b""

    def _i2c_transfer(self, data: bytes) -> bytes:
        channel, address, stop, count = _TRANSFER.unpack_from(data)
        return self._bus(channel).transfer(address, data[_TRANSFER.size :], count, bool(stop))

    # --- USB --------------------------------------------------------------------------

    def _require_usb(self) -> None:
        if not self._board.usb_inside:
            raise OSError(errno.ENODEV, "the USB socket is not the microcontroller's")

    def _usb_enable(self, data: bytes) -> bytes:
        self._require_usb()
        device, at = _counted(data, 0)
        configuration, at = _counted(data, at)
        strings = [string.decode() for string in data[at:].split(b"\0")]
        self._board.usb.enable(device, configuration, strings)
        self.usb_state()
        return b""

    def _usb_disable(self, data: bytes) -> bytes:
        self._require_usb()
        self._board.usb.disable()
        self.usb_state()
        return b""

    def _usb_flags(self) -> int:
        usb = self._board.usb
        state = self.usb_state()
        if state not in _CONFIGURED or not self._board.usb_inside:
            return ops.USB_CLOSED
        flags = ops.USB_OPEN
        if usb.any():
            flags |= ops.USB_READABLE
        if usb.is_open():
            flags |= ops.USB_DTR
            if state == CONFIGURED:
                flags |= ops.USB_WRITABLE
        return flags

    def _usb_wait(self, data: bytes) -> int:
        us, wanted = struct.unpack("<IB", data)
        self._let_reset()
        self._board.clock.hold(None)
        board = self._board
        clock, usb = board.clock, board.usb
        end = clock.host_ns() + round(clock.host_seconds(us) * 1e9)
        while True:
            flags = self._usb_flags()
            left = end - clock.host_ns()
            if flags & wanted or left <= 0:
                return flags
            self._idle()
            if self._interrupts.wanted:
                board.advance()
                if self._interrupts.due:
                    return flags
                left = min(left, INTERRUPT_US * 1000)
            # Received data and changes of the cable end a wait. A program that opens the port is
            # found by polling.
            if wanted & ~(ops.USB_READABLE | ops.USB_CLOSED):
                left = min(left, _POLL_NS)
            if flags & ops.USB_READABLE or not board.usb_inside:
                clock.sleep_host_ns(left)
            else:
                usb.wait(left / 1e9)

    # --- the program ------------------------------------------------------------------

    def _print(self, data: bytes) -> bytes:
        self.print(data.decode(errors="replace"))
        return b""

    def _reset(self, data: bytes) -> bytes:
        raise Reset(HARD if data[0] else SOFT)

    def _deep_sleep(self, data: bytes) -> bytes:
        raise Reset(DEEP_SLEEP, int.from_bytes(data, "little"))

    def _feed(self, data: bytes) -> bytes:
        self._board.resets.feed(int.from_bytes(data, "little"))
        return b""

    def _rtc_memory(self, data: bytes) -> bytes:
        if data:
            self._board.resets.memory = data[1:]
            return b""
        return self._board.resets.memory

    def _end(self, data: bytes) -> bytes:
        self.ended(data.decode(errors="replace"))
        return b""

    def _report_heap(self, data: bytes) -> bytes:
        in_use, peak = map(int, data.split())
        self._heap(in_use, peak)
        return b""


def _counted(data: bytes, at: int) -> tuple[bytes, int]:
    """Return the data at ``at`` that follows a length of two octets, and the offset of its end."""
    end = at + 2 + int.from_bytes(data[at : at + 2], "little")
    return data[at + 2 : end], end
