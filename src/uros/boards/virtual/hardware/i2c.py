"""An I2C bus: one controller, and devices that receive every byte.

A transfer runs byte by byte and takes as long as on a real wire: nine bits per byte and one for
each START and STOP, at the bus frequency, plus clock stretching. Devices see the time of the wire
during the transfer; the caller waits for the total at the end. No transfer lasts longer than
``timeout_us``, whatever fails.

Faults are injected by name in ``device.faults`` and removed again, from any thread; otherwise a bus
belongs to one thread. Random values of faults come from the seed of the bus.
"""

from __future__ import annotations

import errno
import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

from .clock import BoardClock
from .parts import Part

# How long a device with the fault "stretch" holds the clock: over the usual time-out of 100 ms.
STRETCH_US: Final = 150_000
# What a controller reads while no device drives the line.
IDLE: Final = 0xFF
_NOISE: Final = 0.25  # of all bytes, with the fault "noise"

FAULTS: Final = {
    "absent": "is not there: its address is not acknowledged",
    "nack": "acknowledges its address, and no byte written to it",
    "stretch": f"holds the clock for {STRETCH_US // 1000} ms in each read",
    "stuck": "holds the data line after it was addressed, until the bus is recovered",
    "noise": f"one bit wrong in each {round(1 / _NOISE)}th byte read from it, on average",
    "rubbish": "every byte read from it is random",
}


class BusError(OSError):
    """A transfer that failed.

    ``errno`` is ENODEV: the address was not acknowledged; EIO: a byte was not acknowledged;
    ETIMEDOUT: the bus is stuck, or a device held the clock too long.
    """


class Device(Part):
    """A device at one address; subclasses define what it does with bytes."""

    FAULTS: ClassVar[dict[str, str]] = FAULTS

    def __init__(self, name: str, address: int) -> None:
        super().__init__(name)
        self.address = address
        self._bus: I2CBus | None = None

    def now_us(self) -> int:
        """Return the true time since power-on at this point of the transfer; 0 without a bus."""
        return self._bus.now_us() if self._bus is not None else 0

    def start(self, read: bool) -> bool:
        """Handle a START or repeated START with this address; return whether to acknowledge."""
        return True

    def write(self, byte: int) -> bool:
        """Handle a byte from the controller; return whether to acknowledge it."""
        return False

    def read(self) -> int:
        """Return the next byte for the controller."""
        return IDLE

    def hold_us(self) -> int:
        """Return how long to hold the clock low after the last acknowledged byte, in µs."""
        return 0

    def stop(self) -> None:
        """Handle STOP, or that another device was addressed."""


class I2CBus:
    """The controller and its two wires.

    ``on_read(address, ns)`` is called at the end of each transfer that read, with the host's
    monotonic time; ``last_read`` holds the same values of the last one.
    """

    def __init__(
        self,
        frequency: int = 100_000,
        timeout_us: int = 100_000,
        clock: BoardClock | None = None,
        seed: int = 0,
    ) -> None:
        self.frequency = frequency
        self.timeout_us = timeout_us
        self.devices: dict[int, Device] = {}
        self.on_read: Callable[[int, int], None] | None = None
        self.last_read: tuple[int, int] | None = None
        self._clock = clock if clock is not None else BoardClock()
        self._seed = seed
        self._random: dict[str, random.Random] = {}
        self._shorted = False
        self._holder: Device | None = None  # holds SDA
        self._clocks_needed = 0  # until it releases SDA
        self._scl_held_until = 0.0
        self._claimed: Device | None = None  # addressed, and no STOP yet
        self._wire: float | None = None  # the time while a transfer runs
        self._deadline = 0.0

    # Devices and faults.

    def attach(self, device: Device) -> None:
        """Add a device; ValueError if its address is taken."""
        if device.address in self.devices:
            taken = self.devices[device.address].name
            raise ValueError(f"address 0x{device.address:02x} is taken by {taken}")
        device._bus = self
        self.devices[device.address] = device
        self._random[device.name] = random.Random(f"{self._seed}/{device.name}")

    def detach(self, address: int) -> None:
        """Remove the device at an address; KeyError if there is none."""
        device = self.devices.pop(address)
        device._bus = None
        if self._holder is device:
            self._holder = None
        if self._claimed is device:
            self._claimed = None

    def fault(self, kind: str) -> None:
        """Inject a fault of the wires: "stuck", SDA shorted to ground; ValueError for any other."""
        if kind != "stuck":
            raise ValueError(f"a bus has no fault {kind}; it has stuck")
        self._shorted = True

    def heal(self) -> None:
        """Remove the short of the wires."""
        self._shorted = False

    @property
    def shorted(self) -> bool:
        """Whether SDA is shorted to ground."""
        return self._shorted

    # The lines.

    def now_us(self) -> int:
        """Return the true time since power-on; during a transfer, at this point of it."""
        return int(self._wire) if self._wire is not None else self._clock.world_us()

    @property
    def sda(self) -> int:
        """The level of the data line, 0 or 1."""
        return 0 if self._shorted or self._held() else 1

    @property
    def scl(self) -> int:
        """The level of the clock line, 0 or 1."""
        return 0 if self._scl_held_until > self.now_us() else 1

    def _held(self) -> bool:
        """Whether a device holds SDA; one that is healed or detached releases it."""
        holder = self._holder
        if holder and ("stuck" not in holder.faults or "absent" in holder.faults):
            self._holder = holder = None
        return holder is not None

    def pulse(self) -> None:
        """Make one clock pulse, as a program does that drives the pins itself."""
        if self.scl and self._held():
            self._clocks_needed -= 1
            if self._clocks_needed <= 0:
                self._holder = None

    def recover(self) -> bool:
        """Send nine clocks and a STOP, so that a device in the middle of a byte releases SDA.

        Returns:
            Whether the bus is free now; it is not while SDA is shorted.
        """
        for _ in range(9):
            self.pulse()
        self._clock.sleep_world_us(math.ceil(10 * 1e6 / self.frequency))
        self._release()
        return bool(self.sda and self.scl)

    def _release(self) -> None:
        if self._claimed is not None:
            self._claimed.stop()
            self._claimed = None

    # Transfers.

    def transfer(self, address: int, write: bytes, read: int, stop: bool = True) -> bytes:
        """Write, then read ``read`` bytes after a repeated START.

        Args:
            address: Address of 7 bits.
            write: Bytes to write, possibly none.
            read: How many bytes to read, possibly 0. With nothing to write or read, the device is
                only addressed.
            stop: False keeps the bus claimed; the next transfer begins with a repeated START.

        Raises:
            BusError: The transfer failed; the bus is no longer claimed.
            ValueError: The address or the size is out of range.
        """
        if not 0 <= address <= 0x7F:
            raise ValueError(f"an I2C address has 7 bits, not {address}")
        if read < 0:
            raise ValueError(f"{read} bytes cannot be read")
        began = self._clock.world_us()
        self._wire = float(began)
        self._deadline = self._wire + self.timeout_us
        try:
            self._wait_until_free()
            if write or not read:
                self._write(self._start(address, False), write)
            out = self._read(self._start(address, True), read) if read else b""
            if stop:
                self._bits(1)
                self._release()
        except BusError:
            if self._holder is None:
                self._release()
            self._claimed = None
            raise
        finally:
            ends = math.ceil(self._wire)
            self._wire = None
            self._clock.sleep_world_us(ends - self._clock.world_us())
        if read:
            self.last_read = (address, self._clock.host_ns())
            if self.on_read is not None:
                self.on_read(*self.last_read)
        return out

    def scan(self) -> list[int]:
        """Return the addresses that are acknowledged, without the reserved ones.

        Raises:
            BusError: The bus is stuck.
        """
        addresses = []
        for address in range(0x08, 0x78):
            try:
                self.transfer(address, b"", 0)
            except BusError as error:
                if error.errno != errno.ENODEV:
                    raise
            else:
                addresses.append(address)
        return addresses

    def _time_out(self, why: str) -> BusError:
        self._wire = self._deadline
        return BusError(errno.ETIMEDOUT, f"I2C: {why} for {self.timeout_us / 1000:g} ms")

    def _bits(self, count: int) -> None:
        self._advance(count * 1e6 / self.frequency, "the transfer lasted")

    def _advance(self, us: float, why: str) -> None:
        assert self._wire is not None
        if self._wire + us > self._deadline:
            raise self._time_out(why)
        self._wire += us

    def _wait_until_free(self) -> None:
        assert self._wire is not None
        if not self.sda:
            raise self._time_out("the data line was low")
        if self._scl_held_until > self._wire:
            self._advance(self._scl_held_until - self._wire, "the clock line was low")

    def _start(self, address: int, read: bool) -> Device:
        self._bits(10)  # START and the address
        device = self.devices.get(address)
        if self._claimed is not None and self._claimed is not device:
            self._release()
        if (
            device is None
            or "absent" in device.faults
            or ("nack" in device.faults and read)
            or not device.start(read)
        ):
            self._bits(1)
            raise BusError(errno.ENODEV, f"I2C: nobody acknowledges address 0x{address:02x}")
        self._claimed = device
        if "stuck" in device.faults:
            self._holder = device
            self._clocks_needed = self._random[device.name].randint(1, 9)
            raise self._time_out(f"{device.name} held the data line")
        self._stretch(device, STRETCH_US if read and "stretch" in device.faults else 0)
        return device

    def _stretch(self, device: Device, extra_us: int = 0) -> None:
        held = device.hold_us() + extra_us
        if held:
            assert self._wire is not None
            self._scl_held_until = self._wire + held
            self._advance(held, f"{device.name} held the clock line")

    def _write(self, device: Device, data: bytes) -> None:
        for number, byte in enumerate(data):
            self._bits(9)
            if "nack" in device.faults or not device.write(byte):
                self._bits(1)
                raise BusError(
                    errno.EIO, f"I2C: {device.name} does not acknowledge byte {number + 1}"
                )
            self._stretch(device)

    def _read(self, device: Device, count: int) -> bytes:
        out = bytearray()
        source = self._random[device.name]
        for _ in range(count):
            self._bits(9)
            byte = device.read()
            if "rubbish" in device.faults:
                byte = source.randrange(256)
            elif "noise" in device.faults and source.random() < _NOISE:
                byte ^= 1 << source.randrange(8)
            out.append(byte)
        return bytes(out)
