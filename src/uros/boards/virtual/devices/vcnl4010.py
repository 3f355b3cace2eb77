"""The VCNL4010: proximity by its own infrared light, and ambient light.

Registers 0x80 to 0x8F behind a pointer that moves on by itself. A bit in the command register
starts a measurement; when it is complete a ready bit is set there and the result registers change.
Until then they have the old value. Reading a result clears its ready bit.

Ambient light is 0.25 lx per count. A measurement averages 2**n conversions: spread over 100 ms, or
one after another, 0.45 ms each, in continuous conversion mode (bit 7 of the parameter).

Proximity has no unit. It is modelled for a distance in mm and the current of the infrared diode in
mA::

    counts = 2100 + 13750 * current / (distance + 2) ** 2

The door of :mod:`~uros.boards.virtual.world.room` is 3 mm away when closed and 400 mm when open:

======  ========  ==========  =========
mA      closed    15 mm ajar  open
======  ========  ==========  =========
20      13 100    3 052       2 102
200     65 535    11 616      2 117
======  ========  ==========  =========

So 10 000 counts separate open from closed at 20 mA, the setting after power-on. At 200 mA the
closed door saturates, a door ajar is above 10 000 too, and the threshold has to be higher (30 000
is 8 mm).

Left out: the interrupt pin and its persistence count, the timing adjustment in 0x8F, offset
compensation; their registers keep what is written.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Final

from ..hardware.i2c import Device

ADDRESS: Final = 0x13

COMMAND: Final = 0x80
PRODUCT: Final = 0x81
PROXIMITY_RATE: Final = 0x82
LED_CURRENT: Final = 0x83
AMBIENT_PARAMETER: Final = 0x84
AMBIENT: Final = 0x85
PROXIMITY: Final = 0x87
INTERRUPT_CONTROL: Final = 0x89
LOW_THRESHOLD: Final = 0x8A
HIGH_THRESHOLD: Final = 0x8C
INTERRUPT_STATUS: Final = 0x8E
_LAST: Final = 0x8F

# Bits of the command register.
LOCK: Final = 0x80
AMBIENT_READY: Final = 0x40
PROXIMITY_READY: Final = 0x20
AMBIENT_ONCE: Final = 0x10
PROXIMITY_ONCE: Final = 0x08
AMBIENT_ENABLE: Final = 0x04
PROXIMITY_ENABLE: Final = 0x02
SELF_TIMED: Final = 0x01

_IDENTITY: Final = 0x21
_WRITABLE: Final = (
    PROXIMITY_RATE, LED_CURRENT, AMBIENT_PARAMETER, INTERRUPT_CONTROL,
    LOW_THRESHOLD, LOW_THRESHOLD + 1, HIGH_THRESHOLD, HIGH_THRESHOLD + 1, _LAST,
)  # fmt: skip
_PROXIMITY_US: Final = 500
_AMBIENT_US: Final = 100_000
_CONVERSION_US: Final = 450
_LUX: Final = 0.25
_OFFSET: Final = 2100
_REFLECTION: Final = 13_750.0
_AWAY: Final = 2.0
_MAX_CURRENT: Final = 20  # times 10 mA


def proximity_counts(distance_mm: float, milliamperes: float) -> int:
    """Return the proximity measurement without noise, up to 65535.

    Args:
        distance_mm: The distance of the target in mm.
        milliamperes: The current of the infrared diode in mA.
    """
    counts = _OFFSET + _REFLECTION * milliamperes / (max(distance_mm, 0.0) + _AWAY) ** 2
    return min(round(counts), 0xFFFF)


class Vcnl4010(Device):
    """A VCNL4010.

    Args:
        scene: Returns the distance of the target in mm and the illuminance in lux at a time in
            seconds since power-on.
        address: The I2C address.
        seed: The seed of the noise.
        noise: Whether there is noise; without, results are only rounded.
    """

    def __init__(
        self,
        scene: Callable[[float], tuple[float, float]],
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("vcnl4010", address)
        self._scene = scene
        self._random = random.Random(f"{seed}/vcnl4010")
        self._noise = noise
        self._pointer = COMMAND
        self._pointer_set = False
        self._memory = bytearray(_LAST - COMMAND + 1)
        self._put(COMMAND, LOCK)
        self._put(PRODUCT, _IDENTITY)
        self._put(LED_CURRENT, 2)
        self._put(AMBIENT_PARAMETER, 0x1D)
        # When the measurement under way is complete; None: there is none.
        self._ambient_at: int | None = None
        self._proximity_at: int | None = None

    def _get(self, register: int) -> int:
        return self._memory[register - COMMAND]

    def _put(self, register: int, value: int) -> None:
        self._memory[register - COMMAND] = value

    def start(self, read: bool) -> bool:
        """Expect the register pointer next; always acknowledge."""
        self._pointer_set = False
        return True

    def write(self, byte: int) -> bool:
        """Take a byte from the controller; return whether it is acknowledged."""
        self._update()
        if not self._pointer_set:
            self._pointer = byte
            self._pointer_set = True
            return True
        if self._pointer == COMMAND:
            self._write_command(byte)
        elif self._pointer == INTERRUPT_STATUS:
            self._put(INTERRUPT_STATUS, self._get(INTERRUPT_STATUS) & ~byte)
        elif self._pointer in _WRITABLE:
            self._put(self._pointer, byte)
        self._pointer = (self._pointer + 1) & 0xFF
        return True

    def read(self) -> int:
        """Return the next byte for the controller."""
        self._update()
        register = self._pointer
        self._pointer = (register + 1) & 0xFF
        if not COMMAND <= register <= _LAST:
            return 0
        byte = self._get(register)
        if register in (AMBIENT, AMBIENT + 1):
            self._put(COMMAND, self._get(COMMAND) & ~AMBIENT_READY)
        elif register in (PROXIMITY, PROXIMITY + 1):
            self._put(COMMAND, self._get(COMMAND) & ~PROXIMITY_READY)
        return byte

    def _write_command(self, byte: int) -> None:
        """Handle a write to the command register."""
        now = self.now_us()
        ready = self._get(COMMAND) & (AMBIENT_READY | PROXIMITY_READY)
        command = byte & 0x1F
        if command & SELF_TIMED:
            command &= ~(AMBIENT_ONCE | PROXIMITY_ONCE)
        self._put(COMMAND, LOCK | ready | command)
        if command & (AMBIENT_ONCE if not command & SELF_TIMED else AMBIENT_ENABLE):
            if self._ambient_at is None:
                self._ambient_at = now + self._ambient_us()
        elif command & SELF_TIMED or not command:
            self._ambient_at = None
        if command & (PROXIMITY_ONCE if not command & SELF_TIMED else PROXIMITY_ENABLE):
            if self._proximity_at is None:
                self._proximity_at = now + _PROXIMITY_US
        elif command & SELF_TIMED or not command:
            self._proximity_at = None

    def _ambient_us(self) -> int:
        parameter = self._get(AMBIENT_PARAMETER)
        if parameter & 0x80:
            return int(_CONVERSION_US) << (parameter & 7)
        return _AMBIENT_US

    def _update(self) -> None:
        """Store the results of the measurements that are complete."""
        now = self.now_us()
        command = self._get(COMMAND)
        if self._ambient_at is not None and now >= self._ambient_at:
            rate = self._get(AMBIENT_PARAMETER) >> 4 & 7
            period = round(1e6 / (1, 2, 3, 4, 5, 6, 8, 10)[rate])
            at, self._ambient_at = self._done(
                now, self._ambient_at, max(period, self._ambient_us()), AMBIENT_ENABLE
            )
            lux = self._scene(at / 1e6)[1]
            if self._noise:
                lux += self._random.gauss(0, 0.25 + 0.002 * lux)
            self._result(AMBIENT, min(max(round(lux / _LUX), 0), 0xFFFF))
            command = command & ~AMBIENT_ONCE | AMBIENT_READY
        if self._proximity_at is not None and now >= self._proximity_at:
            rate = self._get(PROXIMITY_RATE) & 7
            at, self._proximity_at = self._done(
                now, self._proximity_at, 512_000 >> rate, PROXIMITY_ENABLE
            )
            current = 10 * min(self._get(LED_CURRENT) & 0x3F, _MAX_CURRENT)
            counts = proximity_counts(self._scene(at / 1e6)[0], current)
            if self._noise and counts < 0xFFFF:
                counts = min(round(self._random.gauss(counts, 3 + 0.001 * counts)), 0xFFFF)
            self._result(PROXIMITY, counts)
            command = command & ~PROXIMITY_ONCE | PROXIMITY_READY
        self._put(COMMAND, command)

    def _done(self, now: int, due: int, period: int, enable: int) -> tuple[int, int | None]:
        """Return when the last measurement was complete, and when the next one will be."""
        command = self._get(COMMAND)
        if not (command & SELF_TIMED and command & enable):
            return due, None
        last = now - (now - due) % period
        return last, last + period

    def _result(self, register: int, counts: int) -> None:
        self._put(register, counts >> 8)
        self._put(register + 1, counts & 0xFF)
        control = self._get(INTERRUPT_CONTROL)
        status = self._get(INTERRUPT_STATUS)
        status |= control & (0x08 if register == PROXIMITY else 0x04)
        if control & 2 and (register == AMBIENT) == bool(control & 1):
            if counts > self._word(HIGH_THRESHOLD):
                status |= 1
            if counts < self._word(LOW_THRESHOLD):
                status |= 2
        self._put(INTERRUPT_STATUS, status)

    def _word(self, register: int) -> int:
        return self._get(register) << 8 | self._get(register + 1)
