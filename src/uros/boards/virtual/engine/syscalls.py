"""What the firmware asks for, done on the virtual board: the host's side of ``shims/_board.py``."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ..hardware.board import Interrupts
from ..hardware.usb import CONFIGURED, DETACHED, SUSPENDED
from ..shims import _ops as ops
from .cores import CoreHost, Mail
from .peripheral_syscalls import INTERRUPT_US, PlugHost
from .pin_syscalls import PinHost

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard
    from ..hardware.i2c import I2CBus

_TICKS: Final = (1 << 30) - 1  # MicroPython's counters are as wide as its small integers
_RTC_EPOCH_NS: Final = 946_684_800 * 10**9
_CORE_HZ: Final = 200_000_000
_TRANSFER: Final = struct.Struct("<BBBH")
_CONFIGURED: Final = (CONFIGURED, SUSPENDED)
# How often a wait looks for what does not wake it.
_LOOK_NS: Final = 5_000_000


class Reset(BaseException):
    """The board starts anew. No handler of the firmware is to stop that."""


class BoardHost:
    """Carries out operations of one core, from one thread.

    ``console`` takes what the firmware prints, ``ended`` the traceback (or "") of a program that
    is over, ``heap`` the octets in use and their peak, ``usb`` the state of the line when it has
    changed. ``idle`` is called when the firmware is about to wait: the time for what need not be
    done at once. ``mail`` are the mailboxes between the cores, ``start_core`` starts the second
    one, where this is the first.
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
        self._last_usb = DETACHED
        self._reset_asked = False
        self._within = False  # an operation that is not to be cut short
        self.print = console
        self.ended = ended
        self._operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.CONSOLE: self._printed,
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
            ops.UNIQUE_ID: lambda _: board.unique_id,
            ops.FREQUENCY: lambda _: _CORE_HZ,
            ops.ENDED: self._end,
            ops.HEAP: self._measured,
            **PinHost(board, interrupts).operations,
            **PlugHost(board, self._waits, interrupts).operations,
            **CoreHost(self._mail, start_core).operations,
        }

    def call(self, op: int, data: bytes = b"") -> bytes | int:
        """The answer to one operation: octets, or a number where ``_ops`` says so.

        Raises OSError with what the firmware is to see, and Reset.
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
            raise Reset
        return answer

    def ask_reset(self) -> None:
        """The reset button: raises Reset, at once or at the end of an operation. To be called in
        the program's thread, by a signal.
        """
        self._reset_asked = True
        if not self._within:
            raise Reset

    def stop(self) -> None:
        """End the program of this core: its next operation raises Reset. From another thread."""
        self._reset_asked = True

    def reset(self) -> None:
        """What a reset does to the board around the processor: the host loses its USB device."""
        self._reset_asked = False
        self._board.reset()
        self._interrupts.clear()
        self._mail.clear()
        self.usb_state()

    def usb_state(self) -> str:
        """The state of the line, told as a change where it is one."""
        with self._board.lock:  # of several threads, one tells a change
            state = self._board.usb.state
            if state != self._last_usb:
                self._last_usb = state
                self._usb(state)
            return state

    # --- time -------------------------------------------------------------------------

    def _waits(self) -> None:
        self._within = False
        self._board.clock.hold(None)
        self._idle()

    def _set_epoch(self, data: bytes) -> bytes:
        (ns,) = struct.unpack("<q", data)
        self._board.clock.set_epoch_ns(_RTC_EPOCH_NS + ns)
        return b""

    def _sleep(self, data: bytes) -> int:
        us = int.from_bytes(data, "little")
        self._waits()
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

    def _usb_here(self) -> None:
        if not self._board.usb_inside:
            raise OSError(errno.ENODEV, "the USB socket is not the microcontroller's")

    def _usb_enable(self, data: bytes) -> bytes:
        self._usb_here()
        device, at = _counted(data, 0)
        configuration, at = _counted(data, at)
        strings = [it.decode() for it in data[at:].split(b"\0")]
        self._board.usb.enable(device, configuration, strings)
        self.usb_state()
        return b""

    def _usb_disable(self, data: bytes) -> bytes:
        self._usb_here()
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
        self._within = False
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
            # What there is to read, and what happens to the cable, ends a wait. A program that
            # opens the port is noticed by looking again.
            if wanted & ~(ops.USB_READABLE | ops.USB_CLOSED):
                left = min(left, _LOOK_NS)
            if flags & ops.USB_READABLE or not board.usb_inside:
                clock.sleep_host_ns(left)
            else:
                usb.wait(left / 1e9)

    # --- the program ------------------------------------------------------------------

    def _printed(self, data: bytes) -> bytes:
        self.print(data.decode(errors="replace"))
        return b""

    def _reset(self, data: bytes) -> bytes:
        raise Reset

    def _end(self, data: bytes) -> bytes:
        self.ended(data.decode(errors="replace"))
        return b""

    def _measured(self, data: bytes) -> bytes:
        in_use, peak = map(int, data.split())
        self._heap(in_use, peak)
        return b""


def _counted(data: bytes, at: int) -> tuple[bytes, int]:
    """What follows its own length, and where it ends."""
    end = at + 2 + int.from_bytes(data[at : at + 2], "little")
    return data[at + 2 : end], end
