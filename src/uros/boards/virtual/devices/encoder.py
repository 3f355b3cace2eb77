"""A wheel's photoelectric encoder with one channel: a disc of slots, and a light barrier.

20 slots give 40 edges a turn, one each 9°. It tells how far a wheel has turned and not which way.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

EDGES: Final = 40
_MISSING: Final = 3  # teeth, with the fault "teeth"
_NOISE: Final = 0.01  # pulses a millisecond, with the fault "noise"
_PULSE_US: Final = (20, 200)


class Encoder:
    """``on_edge(t_us, level)`` is called for each edge, in the order of time, with its own time.

    ``level`` is the line's level now. Where the disc stands at power-on comes from ``seed``.
    ``uneven`` is how much wider the teeth are than the slots, as a share of both: 0.1 makes edges
    come after 9.9° and 8.1° in turn.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "dead": "its line never changes",
        "noise": "has about ten short pulses a second too many",
        "teeth": f"{_MISSING} of its disc's {EDGES // 2} teeth are broken off",
    }

    def __init__(self, seed: object = 0, uneven: float = 0.0) -> None:
        if not -0.9 <= uneven <= 0.9:
            raise ValueError(f"teeth may be wider by -0.9 to 0.9, not {uneven}")
        self._random = random.Random(f"{seed}/encoder")
        self._uneven = uneven
        self._phase = self._random.random() * EDGES
        self._broken = set(self._random.sample(range(0, EDGES, 2), _MISSING))
        self.on_edge: Callable[[int, int], None] | None = None
        self.faults: set[str] = set()
        self._cell = self._find(self._phase)
        self.level = self._seen(self._cell)

    def _find(self, at: float) -> int:
        """The tooth (even) or slot (odd) at the barrier, counted through all turns."""
        cell = math.floor(at)
        if self._uneven:
            # The odd edges are those that wide teeth shift.
            if cell & 1 and at - cell < self._uneven:
                cell -= 1
            elif not cell & 1 and at - cell >= 1 + self._uneven:
                cell += 1
        return cell

    def _edge(self, number: int) -> float:
        """Where the edge below this cell is."""
        return number + self._uneven if number & 1 else number

    def _seen(self, cell: int) -> int:
        if cell & 1:
            return 0
        return 0 if "teeth" in self.faults and cell % EDGES in self._broken else 1

    def turn(self, t_us: int, step_us: int, before: float, after: float) -> list[tuple[int, int]]:
        """What the line did while the wheel went from one angle to another, in radians, in the
        ``step_us`` from ``t_us`` on: the time and the new level of each edge. Tells nobody.
        """
        scale = EDGES / math.tau
        begin, end = before * scale + self._phase, after * scale + self._phase
        cell = self._find(end)
        quiet = "noise" not in self.faults
        if cell == self._cell and quiet:
            return []
        found = []
        if cell != self._cell:
            way = 1 if cell > self._cell else -1
            for passed in range(self._cell, cell, way):
                into = passed + way
                level = self._seen(into)
                share = (self._edge(max(passed, into)) - begin) / (end - begin)
                share = min(max(share, 0.0), 1.0)
                if level != self._seen(passed):
                    found.append((t_us + int(share * (step_us - 1)), level))
            self._cell = cell
        if not (quiet or found) and self._random.random() < _NOISE * step_us / 1000:
            at = t_us + self._random.randrange(step_us // 2)
            until = at + min(self._random.randint(*_PULSE_US), step_us // 2)
            found = [(at, 1 - self.level), (until, self.level)]
        return [] if "dead" in self.faults else found

    def tell(self, t_us: int, level: int) -> None:
        """The line changes."""
        self.level = level
        if self.on_edge is not None:
            self.on_edge(t_us, level)
