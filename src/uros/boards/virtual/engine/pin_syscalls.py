"""System calls for pins, PWM, converters, interrupts and the camera."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ..hardware.pins import DOWN, FALLING, IN, OUT, RISING, UP
from ..shims import _ops as ops

if TYPE_CHECKING:
    from ..hardware.board import Interrupts, VirtualBoard
    from ..hardware.pins import Pin

# machine.Pin's IN, OUT and OPEN_DRAIN; none, PULL_UP and PULL_DOWN.
_MODES: Final = {0: IN, 1: OUT, 2: OUT}
_PULLS: Final = {0: "", 1: UP, 2: DOWN}
_PWM: Final = struct.Struct("<IH")
_CAMERA: Final = struct.Struct("<HHB")
_HZ: Final = range(1, 40_000_001)


class PinHost:
    """Carries out the system calls for pins, and what is on them."""

    def __init__(self, board: VirtualBoard, interrupts: Interrupts) -> None:
        self._board = board
        self._interrupts = interrupts
        self._due: tuple[Pin, int] | None = None  # the interrupt that is being handled
        self.operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.PIN_MODE: self._mode,
            ops.PIN_SET: self._set,
            ops.PIN_GET: self._get,
            ops.PIN_IRQ: self._irq,
            ops.IRQ_NEXT: self._next,
            ops.PWM_SET: self._pwm,
            ops.PWM_OFF: self._pwm_off,
            ops.ADC_READ: self._adc,
            ops.CAMERA: self._camera,
        }

    def _pin(self, name: bytes) -> Pin:
        return self._board.pins[name.decode()]

    def _mode(self, data: bytes) -> bytes:
        pin = self._pin(data[2:])
        with self._board.lock:
            pin.pull = _PULLS.get(data[1], pin.pull)
            pin.mode = _MODES.get(data[0], pin.mode)
            pin.tell()
        return b""

    def _set(self, data: bytes) -> bytes:
        with self._board.lock:
            self._pin(data[1:]).value(data[0])
        return b""

    def _get(self, data: bytes) -> int:
        pin = self._pin(data)
        if self._board.clock.held and self._due is not None and self._due[0] is pin:
            return self._due[1]  # the level at the edge
        return pin.value()

    def _irq(self, data: bytes) -> int:
        if data[0] & ~(RISING | FALLING):
            raise ValueError("there are rising and falling edges")
        pin = self._pin(data[1:])
        with self._board.lock:
            self._interrupts.watch(pin, data[0])
        return 1 + list(self._board.pins).index(pin.name)

    def _next(self, data: bytes) -> int:
        board = self._board
        due = self._interrupts.due
        board.clock.hold(None)
        if not due:
            board.advance()
            if not due:
                return 0
        t_us, pin, level = due.popleft()
        with board.lock:
            board.clock.hold(t_us)
        self._due = (pin, level)
        return 2 * (1 + list(board.pins).index(pin.name)) + level

    def _pwm(self, data: bytes) -> bytes:
        frequency, duty = _PWM.unpack_from(data)
        if frequency not in _HZ:
            raise ValueError("no timer counts so fast, or so slowly")
        with self._board.lock:
            self._pin(data[_PWM.size :]).pwm(duty)
        return b""

    def _pwm_off(self, data: bytes) -> bytes:
        with self._board.lock:
            self._pin(data).pwm(None)
        return b""

    def _adc(self, data: bytes) -> int:
        analog = self._pin(data).analog
        if analog is None:
            raise ValueError("this pin has no converter")
        with self._board.lock:
            return round(min(1.0, max(0.0, analog())) * 65535)

    def _camera(self, data: bytes) -> bytes:
        capture = self._board.capture
        if capture is None:
            raise OSError(errno.ENODEV, "this board has no camera")
        # Without the lock: a capture takes time, and a second core continues meanwhile.
        return capture(*_CAMERA.unpack(data))
