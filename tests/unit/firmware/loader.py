"""Loads programs of firmware/ on CPython with virtual sensors and a manual clock.

There is no engine and no process; the clock advances while the program waits.

``with load("ra6m5_usb_text") as program:`` gives its main module as ``program.main``.
"""

import contextlib
import importlib
import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace

from support.paths import ROOT

from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import find

FIRMWARE = ROOT / "firmware"
TICKS = (1 << 30) - 1
# Modules that are imported again for each program, because they refer to the board's modules.
RELOADED = ("uros.drivers.bus", "uros.drivers.port", "uros.drivers.usb_cdc")


def ticks_diff(end: int, start: int) -> int:
    return ((end - start + (1 << 29)) & TICKS) - (1 << 29)


class Time(ModuleType):
    """MicroPython's time, on the virtual board's clock."""

    def __init__(self, clock: ManualClock, offset_ms: int) -> None:
        super().__init__("time")
        self.clock = clock
        self.offset = offset_ms
        self.ticks_diff = ticks_diff

    def ticks_ms(self) -> int:
        return (self.clock.ticks_us() // 1000 + self.offset) & TICKS

    def ticks_add(self, ticks: int, delta: int) -> int:
        return (ticks + delta) & TICKS

    def sleep_ms(self, ms: int) -> None:
        self.clock.sleep_us(ms * 1000)

    def sleep_us(self, us: int) -> None:
        self.clock.sleep_us(us)


class Machine(ModuleType):
    """I2C and pins of a virtual board; ``timeout_argument`` says whether I2C() has one."""

    def __init__(self, board: VirtualBoard) -> None:
        super().__init__("machine")
        self.board = board
        self.timeout_argument = True
        self.opened: list[dict] = []  # the arguments of each I2C()
        self.uarts: list[tuple] = []
        machine = self

        class I2C:
            def __init__(self, channel: int, **options: int) -> None:
                if not machine.timeout_argument and "timeout" in options:
                    raise TypeError("extra keyword arguments given")
                if channel not in board.i2c:
                    raise ValueError("no such channel")
                machine.opened.append({"channel": channel, **options})
                self.bus = board.i2c[channel]

            def writeto(self, address: int, buf: bytes) -> int:
                self.bus.transfer(address, bytes(buf), 0)
                return len(buf)

            def readfrom_into(self, address: int, buf: bytearray) -> None:
                buf[:] = self.bus.transfer(address, b"", len(buf))

        class Pin:
            OPEN_DRAIN = 2

            def __init__(self, name: str, mode: int, value: int) -> None:
                self.pin = board.pins[name]
                self.pin.value(value)
                self.pin.mode = "out"

            def value(self, level: int) -> None:
                self.pin.value(level)

        def uart(*arguments: int, **options: int) -> object:
            machine.uarts.append((arguments, options))
            return Port()

        self.I2C = I2C
        self.Pin = Pin
        self.UART = uart


class Port:
    """A serial port such as a UART, without a cable that can be pulled."""

    def __init__(self) -> None:
        self.written = bytearray()
        self.room = 1 << 20  # bytes that a write accepts
        self.incoming = bytearray()

    def read(self, size: int) -> bytes | None:
        data = bytes(self.incoming[:size])
        del self.incoming[:size]
        return data or None

    def write(self, data: bytes) -> int:
        taken = bytes(data[: self.room])
        self.written += taken
        return len(taken)


class CdcInterface:
    """micropython-lib's CDCInterface, without USB."""

    def __init__(self, timeout: int, txbuf: int, rxbuf: int) -> None:
        self.options = {"timeout": timeout, "txbuf": txbuf, "rxbuf": rxbuf}
        self.opened = True
        self.port = Port()

    def is_open(self) -> bool:
        return self.opened

    def read(self, size: int) -> bytes | None:
        return self.port.read(size)

    def write(self, data: bytes) -> int:
        return self.port.write(data)


class UsbDevice:
    """micropython-lib's usb.device.get(); ``configuration`` is the descriptor of its config()."""

    def __init__(self) -> None:
        self.on = False
        self.options: dict = {}
        self.configuration = bytearray()

    def active(self, on: bool) -> None:
        self.on = on

    def config(self, interface: object, **options: object) -> None:
        assert not self.on
        self.options = options
        sizes = Descriptor(None)
        sizes.extend(bytes(9))
        interface.desc_cfg(sizes, 0, 0, [])
        desc = Descriptor(bytearray(sizes.o))
        desc.extend(bytes(9))
        interface.desc_cfg(desc, 0, 1, [])
        powered = 0x80 | (0 if options["max_power_ma"] else 0x40)
        head = (9, 2, len(desc.b) & 255, len(desc.b) >> 8, interface.num_itfs(), 1, 0, powered,
                options["max_power_ma"] // 2)  # fmt: skip
        desc.b[:9] = bytes(head)
        self.configuration = desc.b


class Descriptor:
    def __init__(self, b: bytearray | None) -> None:
        self.b = b
        self.o = 0

    def extend(self, data: bytes) -> None:
        if self.b is not None:
            self.b[self.o : self.o + len(data)] = data
        self.o += len(data)


class Poll:
    """select.poll of one stream: it only lets time pass."""

    clock: ManualClock

    def register(self, stream: object, events: int) -> None:
        pass

    def poll(self, timeout: int) -> list:
        self.clock.sleep_us(timeout * 1000)
        return []


class Program:
    """A loaded program, whose ``main`` is not started."""

    def __init__(self, board: VirtualBoard, clock: ManualClock, offset_ms: int, usb: bool) -> None:
        self.board = board
        self.clock = clock
        self.time = Time(clock, offset_ms)
        self.machine = Machine(board)
        self.usb = UsbDevice()
        poll = type("poll", (Poll,), {"clock": clock})
        cdc = ModuleType("usb.device.cdc")
        cdc.CDCInterface = type("CDCInterface", (CdcInterface,), {"num_itfs": lambda self: 2})
        device = ModuleType("usb.device")
        device.get = lambda: self.usb
        top = ModuleType("usb")
        top.device = device
        self.modules: dict[str, ModuleType | None] = {
            "time": self.time,
            "machine": self.machine,
            "select": SimpleNamespace(poll=poll, POLLIN=1),
            "usb": top if usb else None,  # None: the import fails
            "usb.device": device if usb else None,
            "usb.device.cdc": cdc if usb else None,
        }
        for package in ("sensor_msgs", "std_msgs"):
            real = importlib.import_module(f"uros.interfaces.{package}.msg")
            self.modules[package] = ModuleType(package)
            self.modules[f"{package}.msg"] = real
        self.main: ModuleType


@contextlib.contextmanager
def load(name: str, offset_ms: int = 0, usb: bool = True, seed: int = 0) -> Iterator[Program]:
    """Load the program of a folder of firmware/; ``offset_ms`` is the first value of the ticks."""
    clock = ManualClock()
    board = VirtualBoard(find(name), clock=clock, seed=seed)
    program = Program(board, clock, offset_ms, usb)
    own = [path.stem for path in (FIRMWARE / name).glob("*.py")]
    touched = [*program.modules, *RELOADED, *own]
    before = {module: sys.modules.pop(module) for module in touched if module in sys.modules}
    sys.modules.update(program.modules)
    sys.path.insert(0, str(FIRMWARE / name))
    try:
        importlib.invalidate_caches()
        for module in RELOADED:
            with contextlib.suppress(ImportError):
                importlib.import_module(module)
        program.main = importlib.import_module("main")
        # The program has imported its versions; all other code needs the host's.
        sys.modules.update({module: before.pop(module) for module in ("time", "select")})
        yield program
    finally:
        sys.path.remove(str(FIRMWARE / name))
        for module in touched:
            if module not in ("time", "select"):
                sys.modules.pop(module, None)
        sys.modules.update(before)
        board.close()
