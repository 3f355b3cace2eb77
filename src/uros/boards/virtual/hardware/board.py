"""A virtual board: the hardware of a board without its program, and its fault injection.

A board has a clock, parts (`uros.boards.virtual.hardware.parts`), pins, buses and a USB socket. An
engine runs firmware on it. Faults and user actions are triggered by name while the board runs::

    board.happen("sht3x:nack")       a fault; "sht3x:off" clears it, "all:off" clears all faults
    board.happen("button:press")     an action of the user
    board.happen("battery:level=20")
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from ....similar import closest
from ..world.room import Room
from .clock import BoardClock
from .i2c import I2CBus
from .parts import Part, Parts
from .peripherals import Radio, Spi, Uart, UartPins, attach
from .pins import Led, Pin
from .resets import SOFT, Resets
from .usb import CONFIGURATION_DESCRIPTOR, DEVICE_DESCRIPTOR, STRINGS, UsbCdc

if TYPE_CHECKING:
    from ..devices.camera import Camera

_ID_OCTETS: Final = 11


class Model(Protocol):
    """The model of a virtual board; `uros.boards.virtual.models.catalog` lists them."""

    @property
    def name(self) -> str:
        """The board's name."""

    @property
    def plugs(self) -> tuple[str, ...]:
        """The peripherals that are attached from the start."""

    @property
    def agent(self) -> str:
        """The agent's address in the program, "" on a serial line."""

    def wire(self, board: VirtualBoard) -> None:
        """Add the board's own parts, pins and buses."""


class FaultError(ValueError):
    """No fault or action has this name; the text lists the known ones."""


@dataclass(frozen=True)
class Happening:
    """A fault that can be injected, or an action of the user."""

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
    """Pending interrupts of one core.

    ``due`` holds their time, pin and level. ``wanted`` tells whether the firmware enabled any.
    """

    def __init__(self) -> None:
        self.due: deque[tuple[int, Pin, int]] = deque()
        self._pins: set[str] = set()

    @property
    def wanted(self) -> bool:
        """Whether the firmware enabled an interrupt."""
        return bool(self._pins)

    def watch(self, pin: Pin, edges: int) -> None:
        """Enable interrupts of a pin at these edges; 0 disables them."""
        pin.edges = edges
        pin.on_edge = lambda t_us, edge_pin, level: self.due.append((t_us, edge_pin, level))
        if edges:
            self._pins.add(pin.name)
        else:
            self._pins.discard(pin.name)

    def clear(self) -> None:
        """Discard all pending and enabled interrupts: the core was reset."""
        self.due.clear()
        self._pins.clear()


class Bridge:
    """The board's end of a USB-to-UART chip, as most boards have one.

    Data sent while no program on the host has the port open is lost, as with a real chip. The
    program that has it open sets the chip's baud rate.
    """

    def __init__(self, usb: UsbCdc) -> None:
        self._usb = usb
        usb.enable(DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR, STRINGS)

    def read(self, size: int) -> bytes | None:
        """Return at most ``size`` octets from the host; None if there are none."""
        return self._usb.read(size) or None

    def write(self, data: bytes) -> int:
        """Send octets to the host; return their number, also when they are lost."""
        self._usb.write(data)
        return len(data)

    @property
    def baud(self) -> int:
        """The baud rate that the program on the host has set; 0 if the port is not open."""
        return self._usb.baud_rate()

    def any(self) -> int:
        """Return how many octets from the host there are to read."""
        return self._usb.any()

    def wait(self, seconds: float) -> None:
        """Wait until there may be octets to read, for so many seconds of the host at most."""
        self._usb.wait(seconds)


class VirtualBoard:
    """A board that is connected to the host and switched on.

    Args:
        model: The hardware.
        clock: The board's clock; by default a new `BoardClock`.
        path: Where the link to the USB line is created.
        seed: Seed of all random values of the board, also its unique number.
        room: The simulated environment; by default a new one.
        plugs: Peripherals besides those of the model (see
            `uros.boards.virtual.hardware.peripherals`); one of the same kind replaces the model's.
        agent: The real address of the agent that the program looks for in the board's network.
        address: The board's own address on this host, "" for any.
        changed: Called with each part whose visible state has changed.

    Raises:
        PeripheralError: A peripheral cannot be attached.
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
        self.resets = Resets(self.clock)
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
        self.bridged: Uart | None = None
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
                self.parts.add(attach(self, spec))
        except BaseException:
            self.close()
            raise

    # --- for the model's wire() -------------------------------------------------------

    def number(self, octets: int = _ID_OCTETS) -> bytes:
        """Return the board's unique number, derived from its seed."""
        return (self.seed & (1 << 8 * octets) - 1).to_bytes(octets, "big")

    def own_usb(self) -> None:
        """Connect the USB socket to the microcontroller itself; the firmware enables it."""
        self.usb_inside = True

    def bridge(
        self, uart: int, pins: UartPins, default_pins: UartPins | None = None, baud: int = 115_200
    ) -> None:
        """Connect the USB socket to a UART of the board.

        Args:
            uart: The UART.
            pins: Its pins that the chip is connected to.
            default_pins: The pins of a program that names none; None: ``pins``.
            baud: The baud rate of its program, and of the line until a program sets another.
        """
        self.usb.baud = baud
        chip = Bridge(self.usb)
        self.uarts[uart] = self.bridged = Uart(chip, baud, self.clock, chip, pins, default_pins)

    def add_pin(self, pin: Pin) -> Pin:
        """Add a pin, and return it."""
        self.pins[pin.name] = pin
        return pin

    def add_led(self, pin: str, led: Led, function: str = "") -> None:
        """Add an LED on a pin."""
        self.parts.add(led)
        self.add_pin(Pin(pin, function or led.name, on_duty=led.drive))

    def add_camera(self, camera: Camera) -> None:
        """Add a camera.

        A capture with width 0 starts the camera and returns no picture: drivers use it to probe
        for a camera.
        """
        self.parts.add(camera)
        self.capture = lambda width, height, quality: (
            camera.capture(width, height, quality) if width else self._start(camera)
        )

    def _start(self, camera: Camera) -> bytes:
        self.clock.sleep_world_us(camera.start_us)
        return b""

    def add_bus(self, channel: int, bus: I2CBus) -> None:
        """Add an I2C bus."""
        self.i2c[channel] = bus

    # --- time -------------------------------------------------------------------------

    def advance(self) -> None:
        """Advance all parts to the current time."""
        if self.parts.live:
            with self.lock:
                if not self.clock.held:
                    self.parts.advance(self.clock.world_us())

    # --- faults and actions -----------------------------------------------------------

    def faults(self) -> list[Happening]:
        """Return all faults that can be injected, and whether they are active."""
        return [
            Happening(f"{part.name}:{kind}", text, part.active(kind))
            for part in self.parts
            for kind, text in part.FAULTS.items()
        ]

    def acts(self) -> list[Happening]:
        """Return all actions of the user."""
        return [
            Happening(f"{part.name}:{kind}", text)
            for part in self.parts
            for kind, text in part.ACTS.items()
        ]

    def happen(self, spec: str) -> None:
        """Inject a fault, like "sht3x:nack", or do an action of the user, like "button:press".

        "sht3x:off" clears all faults of a part, "all:off" those of all parts. Several faults of one
        part add up.

        Raises:
            FaultError: There is no such part, fault, action or value.
        """
        name, _, action = spec.partition(":")
        kind, _, value = action.partition("=")
        with self.lock:
            self.advance()
            if name == "all" and action == "off":
                for part in self.parts:
                    part.heal()
                return
            if name not in self.parts:
                if close := self._similar(spec):
                    raise FaultError(f"there is no {spec}; did you mean {' or '.join(close)}?")
                names = ", ".join(part.name for part in self.parts)
                raise FaultError(
                    f"there is no {spec}: write PART:EVENT, such as {self._example()} (parts:"
                    f" {names}); all:off ends all faults"
                )
            part = self.parts[name]
            if action == "off" and part.FAULTS:
                part.heal()
            elif action in part.FAULTS:
                part.fault(action)
            elif kind in part.ACTS:
                try:
                    part.act(kind, value)
                except ValueError as error:
                    raise FaultError(f"{spec}: {error}") from None
            else:
                known = [f"{name}:{known_kind}" for known_kind in (*part.FAULTS, *part.ACTS)]
                heal = f", {name}:off" if part.FAULTS else ""
                raise FaultError(f"there is no {spec}; there are {', '.join(known)}{heal}")
            self.advance()

    def _similar(self, spec: str) -> list[str]:
        """Return what may have been meant by a fault or action of no part, with its value."""
        written, equals, value = spec.partition("=")
        known = [happening.spec for happening in (*self.acts(), *self.faults())]
        known += [f"{part.name}:off" for part in self.parts if part.FAULTS]
        return [each + equals + value for each in closest(written, known)]

    def _example(self) -> str:
        return next(happening.spec for happening in (*self.faults(), *self.acts()))

    def reset(self, cause: int = SOFT) -> None:
        """Reset the microcontroller.

        Its USB device is off until the firmware enables it, pins become inputs, and ticks start at
        0. The parts around the microcontroller and the real-time clock are not affected.

        Args:
            cause: Why, a constant of `uros.boards.virtual.hardware.resets`.
        """
        self.resets.begin(cause)
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
        """Switch the board off and remove its USB line."""
        self.usb.close()
        for part in self.parts:
            part.close()
