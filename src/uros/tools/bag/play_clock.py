"""The time of a bag while it is played: it runs at a rate, stands still, and can jump."""

from __future__ import annotations


class PlayClock:
    """Maps the time of a bag to the monotonic time at which it is reached, and back.

    Both are anchored where the clock was last changed, so that no errors add up while it runs.

    Args:
        start_ns: The time of the bag at which the clock starts.
        rate: How many seconds of the bag pass in one second, above 0.
        now_ns: The monotonic time.
        paused: Whether it stands still at first.
    """

    def __init__(self, start_ns: int, rate: float, now_ns: int, paused: bool = False) -> None:
        self._bag_ns = start_ns
        self._anchor_ns = now_ns
        self._rate = rate
        self._paused = paused

    @property
    def rate(self) -> float:
        """How many seconds of the bag pass in one second."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether it stands still."""
        return self._paused

    def time(self, now_ns: int) -> int:
        """Return the time of the bag at a monotonic time."""
        if self._paused:
            return self._bag_ns
        return self._bag_ns + round((now_ns - self._anchor_ns) * self._rate)

    def due(self, bag_ns: int) -> int | None:
        """Return the monotonic time at which a time of the bag is reached; None while paused."""
        if self._paused:
            return None
        return self._anchor_ns + round((bag_ns - self._bag_ns) / self._rate)

    def jump(self, bag_ns: int, now_ns: int) -> None:
        """Set the time of the bag."""
        self._bag_ns = bag_ns
        self._anchor_ns = now_ns

    def pause(self, now_ns: int) -> None:
        """Stand still; idempotent."""
        self.jump(self.time(now_ns), now_ns)
        self._paused = True

    def resume(self, now_ns: int) -> None:
        """Run on; idempotent."""
        self.jump(self.time(now_ns), now_ns)
        self._paused = False

    def set_rate(self, rate: float, now_ns: int) -> bool:
        """Run at another rate from now on; return False for one that is not above 0."""
        if not 0.0 < rate < float("inf"):
            return False
        self.jump(self.time(now_ns), now_ns)
        self._rate = rate
        return True
