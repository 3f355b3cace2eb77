"""A single-channel photoelectric wheel encoder: slotted disc and light barrier.

20 slots give 40 edges a turn, one every 9°. It measures the angle and not the direction.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

EDGES: Final = 40
_MISSING: Final = 3  # missing teeth with the fault "teeth"
_NOISE: Final = 0.01  # pulses a millisecond with the fault "noise"
_PULSE_US: Final = (20, 200)


class Encoder:
    """An encoder.

    Attributes:
        on_edge: Called with the time in µs and the new level at each edge, in the order of time.
        level: The level of the line.
        faults: The faults that are injected.

    Args:
        seed: The seed of the disc's angle at power-on and of the faults.
        uneven: How much wider the teeth are than the slots, as a share of both: with 0.1, edges
            come after 9.9° and 8.1° in turn.

    Raises:
        ValueError: ``uneven`` is not in -0.9 to 0.9.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "dead": "its line never changes",
        "noise": "has about ten short spurious pulses a second",
        "teeth": f"{_MISSING} of its disc's {EDGES // 2} teeth are broken off",
    }

    def __init__(self, seed: object = 0, uneven: float = 0.0) -> None:
        if not -0.9 <= uneven <= 0.9:
            raise ValueError(f"uneven is -0.9 to 0.9, not {uneven}")
        self._random = random.Random(f"{seed}/encoder")
        self._uneven = uneven
        self._phase = self._random.random() * EDGES
        self._broken = set(self._random.sample(range(0, EDGES, 2), _MISSING))
        self.on_edge: Callable[[int, int], None] | None = None
        self.faults: set[str] = set()
        self._cell = self._cell_at(self._phase)
        self.level = self._level_of(self._cell)

    def _cell_at(self, at: float) -> int:
        """Return the tooth (even) or slot (odd) at the barrier, counted through all turns."""
        cell = math.floor(at)
        if self._uneven:
            # Wider teeth shift the odd edges.
            if cell & 1 and at - cell < self._uneven:
                cell -= 1
            elif not cell & 1 and at - cell >= 1 + self._uneven:
                cell += 1
        return cell

    def _edge(self, number: int) -> float:
        """Return where the lower edge of this cell is."""
        return number + self._uneven if number & 1 else number

    def _level_of(self, cell: int) -> int:
        if cell & 1:
            return 0
        return 0 if "teeth" in self.faults and cell % EDGES in self._broken else 1

    def edges(self, t_us: int, step_us: int, before: float, after: float) -> list[tuple[int, int]]:
        """Return the edges of one time step, without changing the level or calling ``on_edge``.

        Args:
            t_us: The start of the step in µs.
            step_us: Its duration in µs.
            before: The wheel's angle at its start, in radians.
            after: The wheel's angle at its end, in radians.

        Returns:
            The time in µs and the new level of each edge.
        """
        scale = EDGES / math.tau
        begin, end = before * scale + self._phase, after * scale + self._phase
        cell = self._cell_at(end)
        no_noise = "noise" not in self.faults
        if cell == self._cell and no_noise:
            return []
        edges = []
        if cell != self._cell:
            step = 1 if cell > self._cell else -1
            for passed in range(self._cell, cell, step):
                entered = passed + step
                level = self._level_of(entered)
                share = (self._edge(max(passed, entered)) - begin) / (end - begin)
                share = min(max(share, 0.0), 1.0)
                if level != self._level_of(passed):
                    edges.append((t_us + int(share * (step_us - 1)), level))
            self._cell = cell
        if not (no_noise or edges) and self._random.random() < _NOISE * step_us / 1000:
            at = t_us + self._random.randrange(step_us // 2)
            until = at + min(self._random.randint(*_PULSE_US), step_us // 2)
            edges = [(at, 1 - self.level), (until, self.level)]
        return [] if "dead" in self.faults else edges

    def set_level(self, t_us: int, level: int) -> None:
        """Change the level of the line and call ``on_edge``."""
        self.level = level
        if self.on_edge is not None:
            self.on_edge(t_us, level)
