# mypy: disable-error-code="no-any-return"
"""MicroPython's ``machine``, for the hardware that virtual boards have."""

import struct
import time

import _board  # type: ignore[import-not-found]
import _irq  # type: ignore[import-not-found]

try:
    from collections.abc import Callable
except ImportError:
    pass

PWRON_RESET = 1
HARD_RESET = 2
WDT_RESET = 3
DEEPSLEEP_RESET = 4
SOFT_RESET = 5

_RTC_BYTES = 2048
_TICKS = 0x3FFFFFFF  # the largest number of ticks
_EMPTY_US = 500  # of a UART: see there
_WAITED_US = 2000
_WAIT_OCTETS = 256
_IDLE_US = 1000  # the period of the tick, which wakes a board at the latest


def _missing(text: str, operation: int, name: object) -> ValueError:
    """Return MicroPython's error, and what this virtual board has."""
    octets = bytes((operation,)) + str(name).encode()
    return ValueError(text + ": " + _board.call(_board.ADVICE, octets).decode())


def unique_id() -> bytes:
    """Return the board's unique identifier."""
    return _board.call(_board.UNIQUE_ID)


def freq() -> int:
    """Return the core's clock in Hz. It cannot be changed here."""
    return _board.number(_board.FREQUENCY)


def reset() -> None:
    """Reset the board. Does not return."""
    _board.call(_board.RESET, b"\1")


def soft_reset() -> None:
    """Restart the program. Does not return."""
    _board.call(_board.RESET, b"\0")


def idle() -> None:
    """Wait for an interrupt: USB, a pin, or the next tick a millisecond from now at the latest."""
    if _board.number(_board.USB_STATE) & _board.USB_READABLE:
        _board.number(_board.SLEEP, struct.pack("<I", _IDLE_US))
    else:
        _board.number(_board.USB_WAIT, struct.pack("<IB", _IDLE_US, _board.USB_READABLE))
    if _irq.handlers:
        _irq.run()


def lightsleep(ms: int) -> None:
    """Sleep for ``ms`` milliseconds."""
    left = ms * 1000
    while left > 0:
        wait = min(left, 500000000)
        left -= wait - _board.number(_board.SLEEP, struct.pack("<I", wait))
        if _irq.handlers:
            _irq.run()


def deepsleep(ms: int = 0) -> None:
    """Sleep for ``ms`` milliseconds, 0 for ever, and start anew. Does not return.

    Only the real-time clock and its memory keep running.
    """
    _board.call(_board.DEEPSLEEP, struct.pack("<I", ms))


def reset_cause() -> int:
    """Return why the program was started: one of the constants ``..._RESET``."""
    return _board.number(_board.RESET_CAUSE)


def disable_irq() -> int:
    """Disable interrupts; does nothing here, where none interrupts the firmware."""
    return 1


def enable_irq(state: int = 1) -> None:
    """Enable interrupts; does nothing here."""


class RTC:
    """The real-time clock, which ``time.time()`` reads. It runs on through a reset."""

    def __init__(self, id: int = 0) -> None:
        if id:
            raise ValueError("RTC(" + str(id) + ") doesn't exist")

    def datetime(self, moment: "tuple[int, ...] | None" = None) -> "tuple[int, ...] | None":
        """Return or set the time.

        It is (year, month, day, weekday, hours, minutes, seconds, microseconds), as on an ESP32;
        the weekday is ignored when the time is set.
        """
        if moment is None:
            ns = time.time_ns()
            at = time.gmtime(ns // 1000000000)
            return at[:3] + (at[6],) + at[3:6] + (ns // 1000 % 1000000,)  # noqa: RUF005
        year, month, day, _, hour, minute, second, us = moment
        seconds = time.mktime((year, month, day, hour, minute, second, 0, 0))  # type: ignore[arg-type]
        _board.call(_board.EPOCH_SET, struct.pack("<q", seconds * 1000000000 + us * 1000))
        return None

    def memory(self, data: "bytes | None" = None) -> "bytes | None":
        """Return or set the memory of an ESP32, 2048 bytes, which resets and deep sleep keep."""
        if data is None:
            return _board.call(_board.RTC_MEMORY)
        if len(data) > _RTC_BYTES:
            raise ValueError("buffer too long")
        _board.call(_board.RTC_MEMORY, b"\1" + bytes(data))
        return None


class WDT:
    """The watchdog: resets the board unless it is fed within ``timeout`` ms. It cannot be stopped.

    Another object changes the timeout, as on an ESP32.
    """

    def __init__(self, id: int = 0, timeout: int = 5000) -> None:
        if id:
            raise ValueError("WDT(" + str(id) + ") doesn't exist")
        if timeout <= 0:
            raise ValueError("WDT timeout too short")
        _board.call(_board.WDT_FEED, struct.pack("<I", timeout))

    def feed(self) -> None:
        """Restart the timeout."""
        _board.number(_board.WDT_FEED, b"\0\0\0\0")


class Pin:
    """A pin by its name on the board, such as "P414", or its number."""

    IN = 0
    OUT = 1
    OPEN_DRAIN = 2
    PULL_UP = 1
    PULL_DOWN = 2
    IRQ_RISING = 1
    IRQ_FALLING = 2

    def __init__(
        self, id: "str | int | Pin", mode: int = -1, pull: "int | None" = -1, *,
        value: "int | None" = None,
    ) -> None:  # fmt: skip
        self._name: str = id._name if isinstance(id, Pin) else str(id)
        self._octets = self._name.encode()
        self._irq = 0
        self.init(mode, pull, value=value)

    def init(self, mode: int = -1, pull: "int | None" = -1, *, value: "int | None" = None) -> None:
        """Set mode, pull and level; -1 leaves mode or pull unchanged."""
        try:
            if value is not None:
                self.value(value)
            # Called without a mode too: it checks that the board has the pin.
            how = bytes((mode & 255, (0 if pull is None else pull) & 255))
            _board.call(_board.PIN_MODE, how + self._octets)
        except OSError:
            raise _missing("invalid pin", _board.PIN_MODE, self._name)  # noqa: B904

    def value(self, level: int | None = None) -> int | None:
        """Return the level of the pin, or set it."""
        if level is None:
            if _irq.handlers:
                _irq.run()
            return _board.number(_board.PIN_GET, self._octets)
        _board.call(_board.PIN_SET, bytes((1 if level else 0,)) + self._octets)
        return None

    def __call__(self, level: int | None = None) -> int | None:
        """Return the level of the pin, or set it."""
        return self.value(level)

    def on(self) -> None:
        """Set the pin high."""
        self.value(1)

    def off(self) -> None:
        """Set the pin low."""
        self.value(0)

    high = on
    low = off

    def toggle(self) -> None:
        """Invert the level of the pin."""
        self.value(not self.value())

    def irq(
        self, handler: "Callable[[Pin], object] | None" = None, trigger: int = 3,
        *, hard: bool = False,
    ) -> "Pin":  # fmt: skip
        """Call ``handler(pin)`` at edges; None removes the handler."""
        edges = bytes((trigger if handler is not None else 0,))
        number = _board.number(_board.PIN_IRQ, edges + self._octets)
        if handler is None:
            _irq.handlers.pop(number, None)
        else:
            _irq.handlers[number] = (handler, self)
        return self

    def name(self) -> str:
        """Return the name of the pin."""
        return self._name

    def __repr__(self) -> str:
        return "Pin(" + self._name + ")"


class PWM:
    """Pulse-width modulation on a pin."""

    def __init__(
        self, dest: "Pin | int | str", freq: int = 5000, *, duty_u16: int = -1, duty: int = -1,
        duty_ns: int = -1,
    ) -> None:  # fmt: skip
        self._octets = (dest if isinstance(dest, Pin) else Pin(dest))._octets
        self._freq = freq
        self._duty = 0
        self.init(freq=freq, duty_u16=duty_u16, duty=duty, duty_ns=duty_ns)

    def init(
        self, *, freq: int = -1, duty_u16: int = -1, duty: int = -1, duty_ns: int = -1
    ) -> None:
        """Set frequency and duty cycle, those that are given."""
        if freq != -1:
            self._freq = freq
        if duty_u16 != -1:
            self._duty = duty_u16
        elif duty != -1:
            self._duty = 65535 if duty == 1023 else duty * 64
        elif duty_ns != -1:
            self._duty = min(65535, duty_ns * self._freq * 65536 // 1000000000)
        if not 0 <= self._duty <= 65535:
            raise ValueError("duty must be from 0 to 65535")
        try:
            _board.call(_board.PWM_SET, struct.pack("<IH", self._freq, self._duty) + self._octets)
        except OSError:
            raise ValueError("freq must be from 1Hz to 40MHz")  # noqa: B904

    def deinit(self) -> None:
        """Switch the PWM off."""
        _board.call(_board.PWM_OFF, self._octets)

    def freq(self, value: int | None = None) -> int | None:
        """Return the frequency in Hz, or set it."""
        if value is None:
            return self._freq
        self.init(freq=value)
        return None

    def duty_u16(self, value: int | None = None) -> int | None:
        """Return the duty cycle, 0 to 65535, or set it."""
        if value is None:
            return self._duty
        self.init(duty_u16=value)
        return None

    def duty(self, value: int | None = None) -> int | None:
        """Return the duty cycle, 0 to 1023, or set it, as in older programs for the ESP32."""
        if value is None:
            return self._duty // 64
        self.init(duty=value)
        return None

    def duty_ns(self, value: int | None = None) -> int | None:
        """Return the pulse width in ns, or set it."""
        if value is None:
            return self._duty * 1000000000 // 65536 // self._freq
        self.init(duty_ns=value)
        return None


class ADC:
    """The analog-to-digital converter of a pin."""

    ATTN_0DB = 0
    ATTN_2_5DB = 1
    ATTN_6DB = 2
    ATTN_11DB = 3

    def __init__(self, id: "Pin | int | str", *, atten: int = ATTN_11DB) -> None:
        self._octets = (id if isinstance(id, Pin) else Pin(id))._octets
        try:
            self.read_u16()
        except OSError:
            text = "Pin doesn't have ADC capabilities"
            raise _missing(text, _board.ADC_READ, "")  # noqa: B904

    def atten(self, value: int) -> None:
        """Set the attenuation; does nothing here."""

    def read_u16(self) -> int:
        """Return the measurement, 0 to 65535."""
        return _board.number(_board.ADC_READ, self._octets)

    def read_uv(self) -> int:
        """Return the voltage in microvolts; full scale is 3.3 V."""
        return self.read_u16() * 3300000 // 65535


class I2C:
    """An I2C controller by its channel. Its pins are fixed: ``scl`` and ``sda`` are ignored.

    Transfers raise OSError: ENODEV where the address is not acknowledged, EIO where data is not
    acknowledged, ETIMEDOUT where the bus is held longer than ``timeout`` microseconds.
    """

    def __init__(
        self,
        id: int,
        *,
        scl: Pin | None = None,
        sda: Pin | None = None,
        freq: int = 400000,
        timeout: int = 50000,
    ) -> None:
        self._id = id
        self.init(scl=scl, sda=sda, freq=freq, timeout=timeout)

    def init(
        self,
        *,
        scl: Pin | None = None,
        sda: Pin | None = None,
        freq: int = 400000,
        timeout: int = 50000,
    ) -> None:
        """Configure the bus: frequency in Hz, timeout in microseconds."""
        try:
            _board.call(_board.I2C_INIT, struct.pack("<BII", self._id, freq, timeout))
        except OSError:
            text = "I2C(" + str(self._id) + ") doesn't exist"
            raise _missing(text, _board.I2C_INIT, self._id)  # noqa: B904
        self._freq = freq

    def __repr__(self) -> str:
        return "I2C(" + str(self._id) + ", freq=" + str(self._freq) + ")"

    def _transfer(self, addr: int, write: bytes, read: int, stop: bool) -> bytes:
        if not 0 <= addr < 128:
            addr = 255  # no device has it; MicroPython's pack would truncate other values
        head = struct.pack("<BBBH", self._id, addr, 1 if stop else 0, read)
        return _board.call(_board.I2C_TRANSFER, head + write)

    def scan(self) -> "list[int]":
        """Return the addresses that are acknowledged."""
        return list(_board.call(_board.I2C_SCAN, bytes((self._id,))))

    def readfrom(self, addr: int, nbytes: int, stop: bool = True) -> bytes:
        """Return ``nbytes`` octets read from a device."""
        return self._transfer(addr, b"", nbytes, stop)

    def readfrom_into(self, addr: int, buf: bytearray, stop: bool = True) -> None:
        """Fill a buffer with octets read from a device."""
        buf[:] = self._transfer(addr, b"", len(buf), stop)

    def writeto(self, addr: int, buf: bytes, stop: bool = True) -> int:
        """Write octets to a device; return how many were acknowledged."""
        self._transfer(addr, bytes(buf), 0, stop)
        return len(buf)

    def writevto(self, addr: int, vector: "list[bytes]", stop: bool = True) -> int:
        """Write the buffers in one transfer; return how many octets were acknowledged."""
        octets = b"".join([bytes(buf) for buf in vector])
        self._transfer(addr, octets, 0, stop)
        return len(octets)

    def readfrom_mem(self, addr: int, memaddr: int, nbytes: int, *, addrsize: int = 8) -> bytes:
        """Return ``nbytes`` octets read from a register."""
        return self._transfer(addr, _register(memaddr, addrsize), nbytes, True)

    def readfrom_mem_into(
        self, addr: int, memaddr: int, buf: bytearray, *, addrsize: int = 8
    ) -> None:
        """Fill a buffer with octets read from a register."""
        buf[:] = self._transfer(addr, _register(memaddr, addrsize), len(buf), True)

    def writeto_mem(self, addr: int, memaddr: int, buf: bytes, *, addrsize: int = 8) -> None:
        """Write octets to a register."""
        self._transfer(addr, _register(memaddr, addrsize) + bytes(buf), 0, True)


def _register(memaddr: int, addrsize: int) -> bytes:
    """Return a register's number as it is sent on the bus: big-endian, whole octets."""
    return memaddr.to_bytes((addrsize + 7) // 8, "big")


class UART:
    """A UART by its number; only those with a device connected exist.

    Where ``tx`` and ``rx`` are not the device's pins, nothing arrives, and the console says so.
    No call but :meth:`wait` waits: ``timeout`` is 0. It buffers ``rxbuf`` received octets. Where
    nothing was received, the next half a millisecond brings nothing either, 2 ms after a wait:
    programs read often, and each read costs the host more than a board.
    """

    def __init__(
        self, id: int, baudrate: int = 9600, bits: int = 8, parity: int | None = None,
        stop: int = 1, *, tx: "Pin | int | str | None" = None,
        rx: "Pin | int | str | None" = None, txbuf: int = 256, rxbuf: int = 256, timeout: int = 0,
        timeout_char: int = 0,
    ) -> None:  # fmt: skip
        self._id = id
        self._empty = -1  # the ticks when there was nothing more to read
        self._quiet_us = 0  # how long after that the board is not asked
        self._waited = b""  # received in wait() and not read yet
        pins = b"\0".join([b"" if pin is None else Pin(pin)._octets for pin in (tx, rx)])
        try:
            _board.call(_board.UART_INIT, struct.pack("<BII", self._id, baudrate, rxbuf) + pins)
        except OSError:
            text = "UART(" + str(id) + ") doesn't exist"
            raise _missing(text, _board.UART_INIT, id)  # noqa: B904

    def deinit(self) -> None:
        """Switch the UART off; does nothing here."""

    def any(self) -> int:
        """Return how many octets there are to read."""
        return len(self._waited) + _board.number(_board.UART_ANY, bytes((self._id,)))

    def read(self, nbytes: int = 65535) -> bytes | None:
        """Return at most ``nbytes`` octets received, None when there are none."""
        if _irq.handlers:
            _irq.run()
        if self._waited:
            data, self._waited = self._waited[:nbytes], self._waited[nbytes:]
            return data
        now = _board.number(_board.TICKS_US)
        if self._empty >= 0 and ((now - self._empty) & _TICKS) < self._quiet_us:
            return None
        data = _board.call(_board.UART_READ, struct.pack("<BH", self._id, nbytes))
        self._empty, self._quiet_us = -1 if data else now, _EMPTY_US
        return data if data else None

    def write(self, buf: bytes) -> int:
        """Send octets; return how many were taken."""
        return _board.number(_board.UART_WRITE, bytes((self._id,)) + bytes(buf))

    def wait(self, timeout_ms: int) -> None:
        """Wait until there are octets to read, for ``timeout_ms`` at most.

        MicroPython's UART does not have this method. The client's ``StreamTransport`` uses it where
        a port has it, and polls elsewhere, which would take much of the host's time.
        """
        if self._waited:
            return
        wait = struct.pack("<BHI", self._id, _WAIT_OCTETS, timeout_ms * 1000)
        self._waited = _board.call(_board.UART_WAIT, wait)
        emptied = len(self._waited) < _WAIT_OCTETS
        self._empty = _board.number(_board.TICKS_US) if emptied else -1
        self._quiet_us = _WAITED_US
        if _irq.handlers:
            _irq.run()


class SPI:
    """An SPI bus by its number; only those with a device connected exist."""

    MSB = 0
    LSB = 1

    def __init__(
        self, id: int, baudrate: int = 1000000, *, polarity: int = 0, phase: int = 0,
        bits: int = 8, firstbit: int = MSB, sck: object = None, mosi: object = None,
        miso: object = None,
    ) -> None:  # fmt: skip
        self._id = id
        try:
            _board.call(_board.SPI_INIT, bytes((id, polarity << 1 | phase)))
        except OSError:
            text = "SPI(" + str(id) + ") doesn't exist"
            raise _missing(text, _board.SPI_INIT, id)  # noqa: B904

    def deinit(self) -> None:
        """Switch the bus off; does nothing here."""

    def write(self, buf: bytes) -> None:
        """Write octets."""
        _board.call(_board.SPI_WRITE, bytes((self._id,)) + bytes(buf))

    def readinto(self, buf: bytearray, write: int = 0) -> None:
        """Fill a buffer with octets read, writing ``write`` meanwhile."""
        buf[:] = self.read(len(buf), write)

    def read(self, nbytes: int, write: int = 0) -> bytes:
        """Return ``nbytes`` octets read, writing ``write`` meanwhile."""
        return _board.call(_board.SPI_READ, struct.pack("<BBH", self._id, write, nbytes))
