"""A program of firmware/sprturtlebot*, loaded on CPython with the virtual rover around it, in
virtual time: no engine, no process, no network.
"""

import contextlib
import importlib
import sys
import types
from collections.abc import Iterator

from unit.firmware.loader import FIRMWARE, ticks_diff

from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import find

TICKS = (1 << 30) - 1
# Imported anew for each program: they hold on to the board's modules, or are the program's own.
OWN = ("config", "cores", "mail", "sub", "main", "line", "machine", "time")


class RoverBoard:
    """``t_us`` is the time; ``to(t_us)`` brings the world there. Modules see it as the board's
    ticks, which began with ``begin_us``, and in an interrupt as that of the edge."""

    def __init__(self, name: str, seed: int, begin_us: int) -> None:
        self.board = VirtualBoard(find(name), clock=ManualClock(), seed=seed)
        self.rover = self.board.parts["rover"]
        self.t_us = 0
        self.begin_us = begin_us
        self.held: int | None = None

    def to(self, t_us: int) -> None:
        self.t_us = t_us
        self.board.parts.advance(t_us)

    def ticks_us(self) -> int:
        now = self.t_us if self.held is None else self.held
        return (now + self.begin_us) & TICKS

    def time(self) -> types.ModuleType:
        module = types.ModuleType("time")
        module.ticks_us = self.ticks_us
        module.ticks_ms = lambda: (self.t_us + self.begin_us) // 1000 & TICKS
        module.ticks_add = lambda ticks, delta: (ticks + delta) & TICKS
        module.ticks_diff = ticks_diff
        return module

    def machine(self) -> types.ModuleType:
        """What these programs need of MicroPython's machine."""
        outer = self

        class Pin:
            IN, OUT = 0, 1

            def __init__(self, number: int, mode: int = -1, value: int | None = None) -> None:
                self.pin = outer.board.pins[str(number)]
                if mode == self.OUT:
                    self.pin.mode = "out"
                if value is not None:
                    self.value(value)

            def value(self, level: int | None = None) -> int:
                return self.pin.value(level)

            def irq(self, handler) -> None:
                def edge(t_us, pin, level) -> None:
                    outer.held = t_us
                    handler(self)
                    outer.held = None

                self.pin.edges = 3
                self.pin.on_edge = edge

        class PWM:
            def __init__(self, pin: Pin, freq: int) -> None:
                assert 1000 <= freq <= 250_000  # what the driver follows
                self.pin = pin.pin

            def duty_u16(self, duty: int) -> None:
                assert 0 <= duty <= 65535
                self.pin.pwm(duty)

        module = types.ModuleType("machine")
        module.Pin, module.PWM = Pin, PWM
        return module


@contextlib.contextmanager
def rover_board(name: str, *modules: str, seed: int = 0, begin_us: int = 0) -> Iterator[RoverBoard]:
    """The board of a folder, with these modules of the folder as its attributes."""
    running = RoverBoard(name, seed, begin_us)
    before = {it: sys.modules.pop(it) for it in OWN if it in sys.modules}
    folder = str(FIRMWARE / name)
    sys.path.insert(0, folder)
    sys.modules.update(time=running.time(), machine=running.machine())
    try:
        importlib.invalidate_caches()
        try:
            for module in modules:
                setattr(running, module, importlib.import_module(module))
        finally:
            sys.modules["time"] = before.pop("time")  # everybody else needs the host's
        yield running
    finally:
        sys.path.remove(folder)
        for it in OWN:
            if it != "time":
                sys.modules.pop(it, None)
        sys.modules.update(before)
        running.board.close()
