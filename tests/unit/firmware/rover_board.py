"""Loads programs of firmware/sprturtlebot* on CPython with the virtual rover, in virtual time.

There is no engine, no process and no network.
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
# Imported again for each program: they refer to the board's modules, or are the program's own.
OWN = ("config", "cores", "mail", "sub", "main", "line", "machine", "time")


class RoverBoard:
    """A board with the virtual rover; ``t_us`` is the time, which ``to(t_us)`` advances.

    The ticks of the board's modules begin with ``begin_us``; in an interrupt they are the time of
    the edge.
    """

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
        """Return the part of MicroPython's machine that these programs use."""
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
                assert 1000 <= freq <= 250_000  # the range of the driver
                self.pin = pin.pin

            def duty_u16(self, duty: int) -> None:
                assert 0 <= duty <= 65535
                self.pin.pwm(duty)

        module = types.ModuleType("machine")
        module.Pin, module.PWM = Pin, PWM
        return module


@contextlib.contextmanager
def rover_board(name: str, *modules: str, seed: int = 0, begin_us: int = 0) -> Iterator[RoverBoard]:
    """Load modules of a folder as attributes of its RoverBoard."""
    running = RoverBoard(name, seed, begin_us)
    before = {
        module_name: sys.modules.pop(module_name)
        for module_name in OWN
        if module_name in sys.modules
    }
    folder = str(FIRMWARE / name)
    sys.path.insert(0, folder)
    sys.modules.update(time=running.time(), machine=running.machine())
    try:
        importlib.invalidate_caches()
        try:
            for module in modules:
                setattr(running, module, importlib.import_module(module))
        finally:
            sys.modules["time"] = before.pop("time")  # all other code needs the host's
        yield running
    finally:
        sys.path.remove(folder)
        for module_name in OWN:
            if module_name != "time":
                sys.modules.pop(module_name, None)
        sys.modules.update(before)
        running.board.close()
