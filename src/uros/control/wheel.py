"""Distance and speed of a wheel, from an encoder with one channel."""

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
    """A wheel with a single-channel encoder.

    Call `edge` from the pin's interrupt, for each edge, and `update` regularly.

    ``moved`` is the signed distance between the last two updates in metres, ``speed`` the signed
    speed in m/s; ``edges`` counts edges with the sign of their direction. ``pitch`` is the distance
    between two edges in metres.

    One channel does not tell the direction. The wheel is assumed to turn in the direction in which
    it was last driven. When that changes, the old direction is kept until the wheel stands, which
    is after ``still_us`` of braking without an edge; ``reversing`` is true until then: brake, and
    do not drive. After a reversal the same edge passes again, which adds no distance.

    Between edges the distance is extrapolated with the speed, up to the next edge at most. The
    speed is that of the last two intervals (teeth and slots are not equally wide), decreases when
    the next edge is late, and is 0 after ``stop_us``. It is unknown before the second edge of a
    motion; ``unsure_us`` is for how long the wheel has been driven without that.

    Args:
        radius: In metres.
        edges: Edges per revolution.
        stop_us: The speed is 0 after so long without an edge.
        still_us: A braked wheel stands after so long without an edge.
        glitch_us: Two edges within this time are noise and count as none; 0 turns that off. Use it
            only where interrupts are never late: interrupts that wait for a garbage collection
            are served together.
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
        # Written by the interrupt: a count, the times of the last three edges, and how many of them
        # belong to one motion.
        self._count = 0
        self._last = 0
        self._second = 0
        self._third = 0
        self._known = 0
        # Position between two edges, as a share of the pitch. It is unknown at rest: the middle is
        # right on average.
        self._part = 0.5
        self._last_count = 0
        self._updated = 0
        self._held_us = 0

    def set_radius(self, radius: float, edges: int = 40) -> None:
        """Set a calibrated radius, in metres."""
        self.pitch = 2 * math.pi * radius / edges

    def edge(self, now_us: int) -> None:
        """Count one edge of the encoder. For interrupts: nothing is allocated."""
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
        """Compute ``moved`` and ``speed``.

        Args:
            now_us: Ticks in microseconds.
            target: Speed or duty that the wheel is driven with; only its sign is used.
        """
        # An interrupt may change these while they are read: then read them again.
        count = self._count - 1
        last = second = third = 0
        while count != self._count or last != self._last:
            count = self._count
            last = self._last
            second = self._second
            third = self._third
        known = self._known
        new = _since(count, self._last_count)
        self._last_count = count
        age = _since(now_us, last)
        if age < 0:
            age = 0
        dt_us = _since(now_us, self._updated)
        self._updated = now_us
        # The wheel is braked now. Before that, a wheel without edges may have been a slow one.
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
            # The wheel has just entered the interval between two edges at this end.
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
        """Return the absolute speed in m/s."""
        way = self.pitch * 1000000
        if known >= 3:
            took = _since(last, third)
            speed = 2 * way / took if took > 0 else 0.0
        elif known == 2:
            took = _since(last, second)
            speed = way / took if took > 0 else 0.0
        else:
            return 0.0
        # Late interrupts were served together: no wheel is so fast.
        if speed > _FASTEST:
            speed = _FASTEST
        # The next edge is late: the wheel has slowed down.
        if age * speed > way:
            return way / age
        return speed

    def _turn_round(self, target: float, quiet: int) -> None:
        """Take the direction of the target as soon as the wheel stands."""
        if target == 0 or (target > 0) == (self.direction > 0):
            self.reversing = False
        # A wheel that does not stop is turned by something else: do not brake for ever.
        elif self.resting or quiet >= self._still_us or self._held_us > 1000000:
            self.direction = -self.direction
            self._known = 0
            self.resting = True
            self.reversing = False
        else:
            self.reversing = True
