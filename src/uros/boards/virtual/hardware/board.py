"""A virtual board: its hardware without a program, and what can be done to it.

A board has a clock, parts (`uros.boards.virtual.hardware.parts`), pins, buses and a USB socket. An
engine runs
firmware on it. What happens to it is said by name, while it runs::

    board.happen("sht3x:nack")       a fault; "sht3x:off" heals it, "all:off" everything
    board.happen("button:press")     what a hand does
    board.happen("battery:level=20")
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from ..world.room import Room
from .clock import BoardClock
from .i2c import I2CBus
from .parts import Part, Parts
from .peripherals import Radio, Spi, Uart, plug
from .pins import Led, Pin
from .usb import CONFIGURATION_DESCRIPTOR, DEVICE_DESCRIPTOR, STRINGS, UsbCdc

if TYPE_CHECKING:
    from ..devices.camera import Camera

_ID_OCTETS: Final = 11


class Model(Protocol):
    """What a virtual board is made from; `uros.boards.virtual.models.catalog` has them."""

    @property
    def name(self) -> str:
        """The board's name."""

    @property
    def plugs(self) -> tuple[str, ...]:
        """The peripherals that are plugged in from the start."""

    @property
    def agent(self) -> str:
        """The address at which its program expects the agent, "" on a serial line."""

    def wire(self, board: VirtualBoard) -> None:
        """Add the board's own parts, pins and buses."""


class FaultError(ValueError):
    """There is nothing of that name to happen; the text lists what there is."""


@dataclass(frozen=True)
class Happening:
    """One thing that can be made to happen: a fault, or what a hand can do."""

    spec: str
    text: str
    active: bool = False


class _Wires(Part):
    """The wires of all I2C buses."""

    FAULTS: ClassVar = {"stuck": "the data line is shorted to ground"}

    def __init__(self, buses: dict[int, I2CBus]) -> None:
        super().__init__("bus")
        self._buses = buses

    def fault(self, kind: str) -> None:
        super().fault(kind)
        for bus in self._buses.values():
            bus.fault(kind)

    def heal(self) -> None:
        super().heal()
        for bus in self._buses.values():
            bus.heal()


class _Cable(Part):
    """The USB cable, and the host at its other end."""

    FAULTS: ClassVar = {
        "unplug": "the cable is pulled",
        "suspend": "the host lets the device sleep: data waits",
    }
    ACTS: ClassVar = {
        "plug": "put the cable in again",
        "resume": "the host wakes the device",
    }

    def __init__(self, usb: UsbCdc) -> None:
        super().__init__("usb")
        self._usb = usb

    def fault(self, kind: str) -> None:
        if kind == "unplug":
            self._usb.unplug()
        else:
            self._usb.suspend()

    def active(self, kind: str) -> bool:
        return self._usb.suspended if kind == "suspend" else not self._usb.plugged

    def act(self, kind: str, value: str = "") -> None:
        if kind == "plug":
            self._usb.plug()
        else:
            self._usb.resume()

    def heal(self) -> None:
        self._usb.resume()
        self._usb.plug()

    def close(self) -> None:
        self._usb.close()


class Interrupts:
    """Those of one core: what is ``due``, by time, pin and level, and whether its firmware asked
    for any (``wanted``).
    """

    def __init__(self) -> None:
        self.due: deque[tuple[int, Pin, int]] = deque()
        self._pins: set[str] = set()

    @property
    def wanted(self) -> bool:
        return bool(self._pins)

    def watch(self, pin: Pin, edges: int) -> None:
        """The firmware wants an interrupt at these edges; 0: none any more."""
        pin.edges = edges
        pin.on_edge = lambda t_us, it, level: self.due.append((t_us, it, level))
        if edges:
            self._pins.add(pin.name)
        else:
            self._pins.discard(pin.name)

    def clear(self) -> None:
        """The core was reset."""
        self.due.clear()
        self._pins.clear()


class Bridge:
    """A chip that makes a UART of the USB socket, as most boards have one: the board's end. What
    is sent while no program on the host listens is lost, as with a real one.
    """

    def __init__(self, usb: UsbCdc) -> None:
        self._usb = usb
        usb.enable(DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR, STRINGS)

    def read(self, size: int) -> bytes | None:
        return self._usb.read(size) or None

    def write(self, data: bytes) -> int:
        self._usb.write(data)
        return len(data)


class VirtualBoard:
    """One board, plugged in and switched on.

    ``path`` is where its USB line is to be found. ``plugs`` are plugged into it besides what it
    comes with (see `uros.boards.virtual.hardware.peripherals`); one of the same kind takes its
    place. ``agent`` is where
    the agent really is that its program looks for in its network, ``address`` the board's own on
    this host, where it is to have one. ``changed`` is told of parts that
    show something else than before.

    Raises PlugError for what cannot be plugged in.
    """

    def __init__(
        self,
        model: Model,
        clock: BoardClock | None = None,
        path: str | Path | None = None,
        seed: int = 0,
        room: Room | None = None,
        plugs: Sequence[str] = (),
        agent: tuple[str, int] = ("127.0.0.1", 8888),
        address: str = "",
        changed: Callable[[Part], None] = lambda _: None,
    ) -> None:
        self.name = model.name
        self.seed = seed
        self.clock = clock if clock is not None else BoardClock()
        self.room = room if room is not None else Room(seed)
        self.lock = threading.RLock()  # of all parts
        self.parts = Parts()
        self.pins: dict[str, Pin] = {}
        self.i2c: dict[int, I2CBus] = {}
        self.uarts: dict[int, Uart] = {}
        self.spis: dict[int, Spi] = {}
        self.radio: Radio | None = None
        self.capture: Callable[[int, int, int], bytes] | None = None
        self.unique_id = b""
        self.usb_inside = False
        self.changed = changed
        self.address = address
        self.routes: dict[str, tuple[str, int]] = {}
        if model.agent:
            self.routes[model.agent] = agent
        self.usb = UsbCdc(self.clock, path, self.name)
        try:
            model.wire(self)
            if self.i2c:
                self.parts.add(_Wires(self.i2c))
            self.parts.add(_Cable(self.usb))
            replaced = {spec.partition(":")[0] for spec in plugs}
            own = [spec for spec in model.plugs if spec.partition(":")[0] not in replaced]
            for spec in (*own, *plugs):
                self.parts.add(plug(self, spec))
        except BaseException:
            self.close()
            raise

    # --- for the module that wires it -------------------------------------------------

    def number(self, octets: int = _ID_OCTETS) -> bytes:
        """The board's own number, made of its seed."""
        return (self.seed & (1 << 8 * octets) - 1).to_bytes(octets, "big")

    def own_usb(self) -> None:
        """The microcontroller is at the USB socket itself; the firmware switches it on."""
        self.usb_inside = True

    def bridge(self, uart: int, baud: int = 115_200) -> None:
        """The USB socket is a UART of the board."""
        self.uarts[uart] = Uart(Bridge(self.usb), baud, self.clock)

    def add_pin(self, pin: Pin) -> Pin:
        self.pins[pin.name] = pin
        return pin

    def add_led(self, pin: str, led: Led, function: str = "") -> None:
        self.parts.add(led)
        self.add_pin(Pin(pin, function or led.name, on_duty=led.drive))

    def add_camera(self, camera: Camera) -> None:
        """A picture without a size is what a driver asks for when it looks whether there is a
        camera.
        """
        self.parts.add(camera)
        self.capture = lambda width, height, quality: (
            camera.capture(width, height, quality) if width else self._start(camera)
        )

    def _start(self, camera: Camera) -> bytes:
        self.clock.sleep_world_us(camera.start_us)
        return b""

    def add_bus(self, channel: int, bus: I2CBus) -> None:
        self.i2c[channel] = bus

    # --- time -------------------------------------------------------------------------

    def advance(self) -> None:
        """Bring all parts to the time that it is."""
        if self.parts.live:
            with self.lock:
                if not self.clock.held:
                    self.parts.advance(self.clock.world_us())

    # --- what happens to it -----------------------------------------------------------

    def faults(self) -> list[Happening]:
        """What can be planted, and whether it is."""
        return [
            Happening(f"{part.name}:{kind}", text, part.active(kind))
            for part in self.parts
            for kind, text in part.FAULTS.items()
        ]

    def acts(self) -> list[Happening]:
        """What a hand can do."""
        return [
            Happening(f"{part.name}:{kind}", text)
            for part in self.parts
            for kind, text in part.ACTS.items()
        ]

    def happen(self, spec: str) -> None:
        """Plant a fault, like "sht3x:nack", or do what a hand does, like "button:press".

        "sht3x:off" takes all of a part's faults away, "all:off" everybody's. Several of one part
        add up. Raises FaultError.
        """
        name, _, what = spec.partition(":")
        kind, _, value = what.partition("=")
        with self.lock:
            self.advance()
            if name == "all" and what == "off":
                for part in self.parts:
                    part.heal()
                return
            if name not in self.parts:
                names = ", ".join(it.name for it in self.parts)
                raise FaultError(
                    f"there is no {spec}: it is one of {names}, a colon and what is to happen, like"
                    f" {self._example()}; all:off heals everything"
                )
            part = self.parts[name]
            if what == "off" and part.FAULTS:
                part.heal()
            elif what in part.FAULTS:
                part.fault(what)
            elif kind in part.ACTS:
                try:
                    part.act(kind, value)
                except ValueError as error:
                    raise FaultError(f"{spec}: {error}") from None
            else:
                known = [f"{name}:{it}" for it in (*part.FAULTS, *part.ACTS)]
                heal = f", {name}:off" if part.FAULTS else ""
                raise FaultError(f"there is no {spec}; there are {', '.join(known)}{heal}")
            self.advance()

    def _example(self) -> str:
        return next(it.spec for it in (*self.faults(), *self.acts()))

    def reset(self) -> None:
        """What a reset of the microcontroller does: its USB goes away until the firmware switches
        it on, pins become inputs, ticks start at 0. Parts around it and the real-time clock notice
        nothing.
        """
        with self.lock:
            if self.usb_inside:
                self.usb.disable()
            for pin in self.pins.values():
                pin.reset()
            for part in self.parts:
                part.reset()
            self.clock.hold(None)
            self.clock.restart()

    def close(self) -> None:
        """Switch it off: the USB line is gone for good."""
        self.usb.close()
        for part in self.parts:
            part.close()
