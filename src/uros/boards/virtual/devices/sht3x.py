"""The SHT3x: temperature and relative humidity, 16-bit commands.

A result is T, CRC, RH, CRC: T = -45 + 175 * raw / 65535 in °C, RH = raw / 65535. It can be read
once. The sensor takes the next command 1 ms after the last, and no command during a single-shot
measurement: until then it does not acknowledge its address.

Left out: alert limits, the sampling of ART (modelled as 4 Hz), the serial number, general call
reset.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS, IDLE, Device

ADDRESS: Final = 0x44

# Repeatability: longest measurement duration in µs, and noise (3 sigma) in °C and of RH (0 to 1).
_HIGH: Final = (15_000, 0.04, 0.0008)
_MEDIUM: Final = (6_000, 0.08, 0.0015)
_LOW: Final = (4_000, 0.15, 0.0021)
_Repeatability = tuple[int, float, float]

_STRETCHED: Final = {0x2C06: _HIGH, 0x2C0D: _MEDIUM, 0x2C10: _LOW}
_POLLED: Final = {0x2400: _HIGH, 0x240B: _MEDIUM, 0x2416: _LOW}
# With the time between two measurements, in µs.
_PERIODIC: Final = {
    0x2032: (_HIGH, 2_000_000), 0x2024: (_MEDIUM, 2_000_000), 0x202F: (_LOW, 2_000_000),
    0x2130: (_HIGH, 1_000_000), 0x2126: (_MEDIUM, 1_000_000), 0x212D: (_LOW, 1_000_000),
    0x2236: (_HIGH, 500_000), 0x2220: (_MEDIUM, 500_000), 0x222B: (_LOW, 500_000),
    0x2334: (_HIGH, 250_000), 0x2322: (_MEDIUM, 250_000), 0x2329: (_LOW, 250_000),
    0x2737: (_HIGH, 100_000), 0x2721: (_MEDIUM, 100_000), 0x272A: (_LOW, 100_000),
    0x2B32: (_HIGH, 250_000),
}  # fmt: skip
_FETCH: Final = 0xE000
_BREAK: Final = 0x3093
_RESET: Final = 0x30A2
_HEATER_ON: Final = 0x306D
_HEATER_OFF: Final = 0x3066
_STATUS: Final = 0xF32D
_CLEAR: Final = 0x3041

# Bits of the status register.
ALERT: Final = 0x8000
HEATER: Final = 0x2000
RESET_SEEN: Final = 0x0010
COMMAND_FAILED: Final = 0x0002

_COMMAND_US: Final = 1_000  # between two commands
_RESET_US: Final = 1_500
_HEATER_CELSIUS: Final = 3.0


def crc8(data: bytes) -> int:
    """Return the CRC-8 of a word: polynomial 0x31, initial value 0xFF."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x31 if crc & 0x80 else crc << 1) & 0xFF
    return crc


def word(value: float) -> bytes:
    """Return a 16-bit big-endian word, limited to its range, and its CRC."""
    data = min(max(round(value), 0), 0xFFFF).to_bytes(2, "big")
    return data + bytes((crc8(data),))


class Sht3x(Device):
    """An SHT3x.

    Attributes:
        status: The status register.

    Args:
        ambient: Returns the temperature in °C and the relative humidity (0 to 1) at a time in
            seconds since power-on.
        address: The I2C address.
        seed: The seed of the noise.
        noise: Whether there is noise; without, results are only rounded.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "crc": "the checksum after each word is wrong",
    }

    def __init__(
        self,
        ambient: Callable[[float], tuple[float, float]],
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("sht3x", address)
        self._ambient = ambient
        self._random = random.Random(f"{seed}/sht3x")
        self._noise = noise
        self._command = bytearray()
        self._busy_until = 0  # no command is acknowledged before
        self._power_up()

    def _power_up(self) -> None:
        self.status = ALERT | RESET_SEEN
        self._out = b""  # what a read returns
        self._at = 0
        self._hold = 0
        # The measurement under way: its end, its repeatability, and whether a read is stretched.
        self._ends: int | None = None
        self._repeatability: _Repeatability = _HIGH
        self._stretches = False
        self._period = 0  # of periodic mode, in µs; 0: single-shot mode
        self._began = 0
        self._fetched = 0  # the number of the last periodic measurement that was fetched

    def start(self, read: bool) -> bool:
        """Acknowledge unless a measurement or command is under way."""
        now = self.now_us()
        self.stop()
        self._command.clear()
        self._hold = 0
        if not read:
            measures = self._ends is not None and now < self._ends and not self._period
            return not measures and now >= self._busy_until
        if self._ends is not None and not self._period:
            if now < self._ends:
                if not self._stretches:
                    return False
                self._hold = self._ends - now
            self._out = self._measure(self._ends)
            self._ends = None
        return bool(self._out)

    def hold_us(self) -> int:
        """Return for how long the clock is stretched, in µs."""
        held, self._hold = self._hold, 0
        return held

    def write(self, byte: int) -> bool:
        """Take a byte of a command; return False for an unknown command."""
        if len(self._command) >= 2:
            return False  # the alert limits would follow here
        self._command.append(byte)
        if len(self._command) < 2:
            return True
        known = self._run(int.from_bytes(self._command, "big"))
        if known:
            self.status &= ~COMMAND_FAILED
        else:
            self.status |= COMMAND_FAILED
        return known

    def read(self) -> int:
        """Return the next byte for the controller."""
        if self._at >= len(self._out):
            return IDLE
        byte = self._out[self._at]
        self._at += 1
        if "crc" in self.faults and self._at % 3 == 0:
            byte ^= 0xFF
        return byte

    def stop(self) -> None:
        """Discard the rest of a result that was read in part."""
        if self._at:
            self._out = b""
            self._at = 0

    def _run(self, command: int) -> bool:
        """Run a command; return whether there is such a command in this mode."""
        now = self.now_us()
        self._busy_until = now + _COMMAND_US
        self._out = b""
        single = _STRETCHED.get(command) or _POLLED.get(command)
        if self._period and (single or command in _PERIODIC):
            return False  # periodic mode allows it only after the break command
        if single:
            self._ends = now + single[0]
            self._repeatability = single
            self._stretches = command in _STRETCHED
        elif command in _PERIODIC:
            self._repeatability, self._period = _PERIODIC[command]
            self._began = now
            self._fetched = 0
        elif command == _FETCH and self._period:
            self._fetch(now)
        elif command == _BREAK:
            self._period = 0
        elif command == _RESET:
            self._power_up()
            self._busy_until = now + _RESET_US
        elif command == _HEATER_ON:
            self.status |= HEATER
        elif command == _HEATER_OFF:
            self.status &= ~HEATER
        elif command == _STATUS:
            self._out = word(self.status)
        elif command == _CLEAR:
            self.status &= HEATER
        else:
            return False
        return True

    def _fetch(self, now: int) -> None:
        """Make the newest measurement of periodic mode readable, unless it was fetched before."""
        duration = self._repeatability[0]
        number = (now - self._began - duration) // self._period + 1
        if number > self._fetched:
            self._fetched = number
            self._out = self._measure(self._began + (number - 1) * self._period + duration)

    def _measure(self, at: int) -> bytes:
        celsius, humidity = self._ambient(at / 1e6)
        if self.status & HEATER:
            # The same absolute humidity in warmer air: about 6 % less relative humidity per °C.
            celsius += _HEATER_CELSIUS
            humidity *= 0.94**_HEATER_CELSIUS
        if self._noise:
            _, of_celsius, of_humidity = self._repeatability
            celsius += self._random.gauss(0, of_celsius / 3)
            humidity += self._random.gauss(0, of_humidity / 3)
        return word((celsius + 45) / 175 * 0xFFFF) + word(humidity * 0xFFFF)
