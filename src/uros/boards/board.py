"""Virtual boards by name, and what can go wrong with them.

A board is its hardware without a program: clock, I2C channels with sensors on them, USB, pins. An
engine runs firmware on it. Faults are planted and healed by name while it runs::

    board.fault("sht3x:nack")
    board.fault("sht3x:off")
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from .clock import BoardClock
from .i2c import Device, I2CBus
from .mcp9600 import Mcp9600
from .plugs import Plug, Radio, Spi, Uart, plug
from .room import Room
from .sht3x import Sht3x
from .usb import UsbCdc
from .vcnl4010 import Vcnl4010

IN: Final = "in"
OUT: Final = "out"
I2C_CHANNEL: Final = 2

_BUS_STUCK: Final = "the data line is shorted to ground"
_USB: Final = {
    "unplug": "the cable is pulled",
    "plug": "the cable is put in again",
    "suspend": "the host lets the device sleep: data waits",
    "resume": "the host wakes the device",
}


class FaultError(ValueError):
    """There is no such fault; the text lists what there is."""


class BoardError(ValueError):
    """There is no such board; the text lists what there is."""


@dataclass(frozen=True)
class BoardSpec:
    """A board that there is: ``firmware`` is the folder of its program, ``ports`` the MicroPython
    ports it is written for."""

    name: str
    text: str
    mcu: str
    firmware: str
    ports: tuple[str, ...]


BOARDS: Final = {
    it.name: it
    for it in (
        BoardSpec(
            "ra6m5_sensor_node",
            "three I2C sensors as a micro-ROS node over USB",
            "EK-RA6M5 (R7FA6M5BH3CFC)",
            "ra6m5_sensor_node",
            ("renesas-ra",),
        ),
        BoardSpec(
            "ra6m5_usb_text",
            "the same sensors as a line of text a second over USB, without ROS",
            "EK-RA6M5 (R7FA6M5BH3CFC)",
            "ra6m5_usb_text",
            ("renesas-ra",),
        ),
    )
}


@dataclass(frozen=True)
class Fault:
    """One thing that can be made to go wrong."""

    spec: str
    text: str
    active: bool


class Pin:
    """A pin with a level. ``function`` is what the board uses it for, "" for nothing.

    One that is an output gives what was written; an input what is on its wire, or its pull-up.
    """

    def __init__(
        self,
        name: str,
        function: str = "",
        wire: Callable[[], int] | None = None,
        driven: Callable[[int], None] | None = None,
    ) -> None:
        self.name = name
        self.function = function
        self.mode = IN
        self._level = 0
        self._wire = wire
        self._driven = driven

    def value(self, level: int | None = None) -> int:
        """The level; given one, set it first (which shows as soon as the pin is an output)."""
        if level is not None:
            level = 1 if level else 0
            changed, self._level = level != self._level, level
            if changed and self.mode == OUT and self._driven is not None:
                self._driven(level)
        if self.mode == OUT and not (self._level and self._wire):
            return self._level
        return self._wire() if self._wire is not None else 1


class VirtualBoard:
    """One board, plugged in and switched on. ``path`` is where its USB line is to be found,
    ``plugs`` what is plugged into it (see `uros.boards.plugs`).

    Raises BoardError for a name that is not in :data:`BOARDS`, PlugError for what cannot be plugged
    in.
    """

    def __init__(
        self,
        name: str,
        clock: BoardClock | None = None,
        path: str | Path | None = None,
        seed: int = 0,
        room: Room | None = None,
        plugs: Sequence[str] = (),
    ) -> None:
        if name not in BOARDS:
            raise BoardError(f"there is no board {name}; there are {', '.join(BOARDS)}")
        self.name = name
        self.spec = BOARDS[name]
        self.clock = clock if clock is not None else BoardClock()
        self.room = room if room is not None else Room(seed)
        self.unique_id = b"RA6M5" + (seed & (1 << 88) - 1).to_bytes(11, "big")
        bus = I2CBus(clock=self.clock, seed=seed)
        bus.attach(Sht3x(self.room.air, seed=seed))
        bus.attach(Mcp9600(self.room.junctions, seed=seed))
        bus.attach(Vcnl4010(self.room.scene, seed=seed))
        self.i2c = {I2C_CHANNEL: bus}
        self.usb = UsbCdc(self.clock, path, name)
        pins = (
            Pin("P414", "I2C2 SDA", lambda: bus.sda),
            # A program that drives the clock itself frees a stuck bus by its rising edges.
            Pin("P415", "I2C2 SCL", lambda: bus.scl, lambda level: bus.pulse() if level else None),
            Pin("P006", "blue LED"),
            Pin("P007", "green LED"),
            Pin("P008", "red LED"),
            Pin("P005", "button S1"),
            Pin("P004", "button S2"),
        )
        self.pins = {pin.name: pin for pin in pins}
        self.uarts: dict[int, Uart] = {}
        self.spis: dict[int, Spi] = {}
        self.radio: Radio | None = None
        self.plugs: dict[str, Plug] = {}
        try:
            for spec in plugs:
                made = plug(self, spec)
                self.plugs[made.name] = made
        except ValueError:
            self.close()
            raise

    def _devices(self) -> dict[str, Device]:
        return {it.name: it for bus in self.i2c.values() for it in bus.devices.values()}

    def faults(self) -> list[Fault]:
        """What can be planted, and whether it is."""
        out = [
            Fault(f"{name}:{kind}", text, kind in device.faults)
            for name, device in self._devices().items()
            for kind, text in device.FAULTS.items()
        ]
        out.append(Fault("bus:stuck", _BUS_STUCK, any(it.shorted for it in self.i2c.values())))
        usb = self.usb
        active = {"unplug": not usb.plugged, "suspend": usb.suspended}
        out += [Fault(f"usb:{kind}", it, active.get(kind, False)) for kind, it in _USB.items()]
        out += [
            Fault(f"{name}:{kind}", text, kind in it.device.faults)
            for name, it in self.plugs.items()
            for kind, text in it.FAULTS[name].items()
        ]
        return out

    def fault(self, spec: str) -> None:
        """Plant a fault, like "sht3x:nack"; "sht3x:off" takes all of the device's away, "all:off"
        everybody's. Several of one device add up. Raises FaultError."""
        what, _, kind = spec.partition(":")
        known = {fault.spec for fault in self.faults()}
        names = [*self._devices(), "bus", "usb", *self.plugs]
        if kind == "off" and what in (*names, "all"):
            for name in names if what == "all" else [what]:
                self._heal(name)
        elif spec not in known:
            self._refuse(spec, what, names)
        elif what == "usb":
            {
                "unplug": self.usb.unplug, "plug": self.usb.plug,
                "suspend": self.usb.suspend, "resume": self.usb.resume,
            }[kind]()  # fmt: skip
        elif what == "bus":
            for bus in self.i2c.values():
                bus.fault(kind)
        elif what in self.plugs:
            self.plugs[what].fault(kind)
        else:
            self._devices()[what].faults.add(kind)

    def _refuse(self, spec: str, what: str, names: list[str]) -> None:
        if what in names:
            kinds = [it.spec for it in self.faults() if it.spec.startswith(what + ":")]
            raise FaultError(f"there is no fault {spec}; there are {', '.join(kinds)}, {what}:off")
        raise FaultError(
            f"there is no fault {spec}: it is one of {', '.join(names)}, a colon and what is to go"
            f" wrong, like {names[0]}:nack; all:off heals everything"
        )

    def _heal(self, name: str) -> None:
        if name == "usb":
            self.usb.resume()
            self.usb.plug()
        elif name == "bus":
            for bus in self.i2c.values():
                bus.heal()
        elif name in self.plugs:
            self.plugs[name].heal()
        else:
            self._devices()[name].faults.clear()

    def reset(self) -> None:
        """What a reset of the microcontroller does: USB goes away until the firmware switches it
        on, pins become inputs, ticks start at 0. Sensors and the real-time clock notice nothing."""
        self.usb.disable()
        for pin in self.pins.values():
            pin.mode = IN
        if self.radio is not None:
            self.radio.reset()
        self.clock.restart()

    def close(self) -> None:
        """Switch it off: the USB line is gone for good."""
        self.usb.close()
        for it in self.plugs.values():
            it.close()
