"""How far a wheel has come and how fast it turns, by an encoder that has one channel."""

import math

try:
    from typing import Final
except ImportError:
    pass

_MASK: Final = 0x3FFFFFFF
_HALF: Final = 0x20000000
_FASTEST: Final = 2.0


def _since(now: int, then: int) -> int:
    return ((now - then + _HALF) & _MASK) - _HALF


class Wheel:
    """Call `edge` from the pin's interrupt, for each edge, and `update` regularly.

    ``moved`` is how far the wheel came between the last two updates, ``speed`` how fast it turns,
    both with a sign; ``edges`` counts all edges in their direction. ``pitch`` is the way from one
    edge to the next.

    One channel does not tell which way a wheel turns. It is taken to turn the way that it was last
    driven; where that changes, the old one is kept until the wheel stands, braked for ``still_us``
    without an edge, and ``reversing`` is true until then: brake, and do not drive. After a reversal
    the same edge passes again, which is no way further.

    Between edges the way goes on with the speed, up to the next edge at most. The speed is that of
    the last two intervals (teeth and slots are not equally wide), falls where the next edge is
    late, and is 0 after ``stop_us``. For its first two edges a wheel has to move; ``unsure_us`` is
    for how long it has been driven without that.

    With ``glitch_us``, two edges within that time are a disturbance of the line and count as none.
    Give it only where interrupts are never late: what waits together, behind a collection of
    garbage, comes together.
    """

    def __init__(
        self,
        radius: float = 0.0325,
        edges: int = 40,
        stop_us: int = 300000,
        still_us: int = 80000,
        glitch_us: int = 0,
    ) -> None:
        self.pitch = 2 * math.pi * radius / edges
        self.speed = 0.0
        self.moved = 0.0
        self.edges = 0
        self.direction = 1
        self.reversing = False
        self.resting = True
        self.age_us = 0
        self.unsure_us = 0
        self._stop_us = stop_us
        self._still_us = still_us
        self._glitch_us = glitch_us
        # What the interrupt writes: a count, the times of the last three edges, and how many of
        # them belong to one motion.
        self._count = 0
        self._last = 0
        self._second = 0
        self._third = 0
        self._known = 0
        # The wheel is between two edges; this is how far from the lower one to the upper one.
        # Where it stands nobody knows: in the middle, which is right on average.
        self._part = 0.5
        self._seen = 0
        self._updated = 0
        self._held_us = 0

    def set_radius(self, radius: float, edges: int = 40) -> None:
        """A calibrated radius."""
        self.pitch = 2 * math.pi * radius / edges

    def edge(self, now_us: int) -> None:
        """One edge of the encoder. For interrupts: nothing is allocated."""
        if self._known and (now_us - self._last) & _MASK < self._glitch_us:
            self._count = (self._count - 1) & _MASK
            self._known -= 1
            self._last = self._second
            self._second = self._third
            return
        self._third = self._second
        self._second = self._last
        self._last = now_us
        self._count = (self._count + 1) & _MASK
        if self._known < 3:
            self._known += 1

    def update(self, now_us: int, target: float = 0.0) -> None:
        """Bring ``moved`` and ``speed`` to this time. ``target`` is the speed that the wheel is
        driven for; only its sign counts.
        """
        # The interrupt may come in between: then once more.
        count = self._count - 1
        last = second = third = 0
        while count != self._count or last != self._last:
            count = self._count
            last = self._last
            second = self._second
            third = self._third
        known = self._known
        new = _since(count, self._seen)
        self._seen = count
        age = _since(now_us, last)
        if age < 0:
            age = 0
        dt_us = _since(now_us, self._updated)
        self._updated = now_us
        # It is braked now. Before that, a wheel without edges may have been a slow one.
        if target == 0 or (target > 0) != (self.direction > 0):
            self._held_us += dt_us
            quiet = min(age, self._held_us)
        else:
            self._held_us = 0
            quiet = 0
        rested = self.resting
        if new:
            self.resting = False
        elif not self.resting and (quiet > self._still_us or age > self._stop_us):
            self.resting = True
        part = self._part
        if new:
            # Of the cell that the wheel is in now, it has come in at this end.
            self._part = 0.0 if self.direction > 0 else 1.0
            self.edges += new * self.direction
        if self.resting:
            self._known = 0
            speed = 0.0
            if not rested:
                self._part = 0.5
        else:
            speed = self._measure(known, last, second, third, age)
            if known >= 2:
                self.unsure_us = 0
            ahead = speed * (age if new else dt_us) / (self.pitch * 1000000)
            if self.direction > 0:
                self._part = min(self._part + ahead, 1.0)
            else:
                self._part = max(self._part - ahead, 0.0)
                speed = -speed
        if target == 0:
            self.unsure_us = 0
        elif self.resting or known < 2:
            self.unsure_us += dt_us
        self.speed = speed
        self.age_us = age
        self.moved = (new * self.direction + self._part - part) * self.pitch
        self._turn_round(target, quiet)

    def _measure(self, known: int, last: int, second: int, third: int, age: int) -> float:
        """The speed without its sign."""
        way = self.pitch * 1000000
        if known >= 3:
            took = _since(last, third)
            speed = 2 * way / took if took > 0 else 0.0
        elif known == 2:
            took = _since(last, second)
            speed = way / took if took > 0 else 0.0
        else:
            return 0.0
        # Interrupts that were late came together: no wheel is so fast.
        if speed > _FASTEST:
            speed = _FASTEST
        # The next edge is late: it is slower.
        if age * speed > way:
            return way / age
        return speed

    def _turn_round(self, target: float, quiet: int) -> None:
        """Take the direction of the target, as soon as the wheel stands."""
        if target == 0 or (target > 0) == (self.direction > 0):
            self.reversing = False
        # Something else turns it, where it does not come to a stand: do not brake for ever.
        elif self.resting or quiet >= self._still_us or self._held_us > 1000000:
            self.direction = -self.direction
            self._known = 0
            self.resting = True
            self.reversing = False
        else:
            self.reversing = True
