"""Executor: calls the callbacks of timers, subscriptions, services and clients in the order added.

It follows rclc's executor. A round checks all handles, asks the trigger whether to begin, and calls
each handle once that has something new or whose ``invocation`` is ALWAYS. Triggers other than "any"
are in ``triggers``, logical execution time and fixed periods in ``logical_execution_time``.
"""

from ..ticks import ticks_add, ticks_diff

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

try:
    from sys import print_exception  # type: ignore[attr-defined]
except ImportError:  # CPython
    from traceback import print_exception

ON_NEW_DATA: Final = 0
ALWAYS: Final = 1

# Longest wait, so that it fits any platform's integers.
_LONGEST_MS: Final = 60000
# Longest time between two calls of a trigger, whose result may change at any time: rclc's default.
_TRIGGER_MS: Final = 100
# Longest wait of a node with a watchdog: a quarter of the shortest timeout, a second on an ESP32.
_FEED_MS: Final = 250
_NS: Final = 1000000  # nanoseconds in a millisecond


class Executor:
    """Calls ready handles in rounds.

    A handle has ``invocation``, ``is_ready(now)``, ``execute(new)``, ``next_deadline()`` and
    ``overfull()``. ``trigger(handles, ready)`` is a function of ``triggers`` or of the program;
    with None a round begins if a handle is ready. ``between()`` is called after each callback.
    ``failed`` counts the callbacks that raised; their exceptions are passed to ``report``, which
    prints them, and the round continues. A round without a trigger allocates nothing itself.
    ``watchdog`` is None, or a ``machine.WDT`` or another object with ``feed()``.

    Args:
        max_handles: Most handles; adding another one raises ValueError, as in rclc.
    """

    def __init__(self, max_handles: "int | None" = None) -> None:
        self.max_handles = max_handles
        self.handles: "list[Any]" = []  # copied on change: a running round keeps its list
        self.trigger: "Callable[[list[Any], list[bool]], bool] | None" = None
        self.between: "Callable[[], object] | None" = None
        self.watchdog: "Any" = None
        self.failed = 0
        self.report: "Callable[[Exception], object]" = print_exception
        # Handles ready in a round that the trigger did not begin; None: check all handles.
        self._held: "list[bool] | None" = None

    def add(self, handle: "Any") -> None:
        """Add a handle behind the others.

        Raises:
            ValueError: There are ``max_handles`` handles.
        """
        if self.max_handles is not None and len(self.handles) >= self.max_handles:
            raise ValueError("the executor was made for %d handles" % self.max_handles)
        self.handles = self.handles + [handle]
        self._held = None

    def remove(self, handle: "Any") -> None:
        """Remove a handle; no effect if it was not added."""
        if handle in self.handles:
            self.handles = [item for item in self.handles if item is not handle]
            self._held = None

    def execute(self, now: int) -> int:
        """Run one round and return the number of callbacks called.

        Args:
            now: Milliseconds modulo 2^30.
        """
        self.feed()
        handles = self.handles
        ready = self._held
        self._held = None  # a callback that spins runs a round with a list of its own
        if ready is None:
            ready = [False] * len(handles)
        begin = False
        for i in range(len(handles)):
            ready[i] = handles[i].is_ready(now)
            begin = begin or ready[i]
        if self.trigger is not None:
            begin = False  # also if the trigger raises
            try:
                begin = self.trigger(handles, ready)
            except Exception as error:
                self._fail(error)
        count = 0
        for i in range(len(handles) if begin else 0):
            handle = handles[i]
            # Callbacks that ran before may have used up what was ready, or removed the handle.
            new = ready[i] and handle.is_ready(now)
            ready[i] = False
            if (new or handle.invocation == ALWAYS) and handle in self.handles:
                count += 1
                try:
                    handle.execute(new)
                except Exception as error:
                    self._fail(error)
                self.feed()
                if self.between is not None:
                    self.between()
        if handles is self.handles:
            self._held = ready
        return count

    def feed(self) -> None:
        """Feed the watchdog, if there is one: before each round, and after each callback."""
        if self.watchdog is not None:
            self.watchdog.feed()

    def _fail(self, error: Exception) -> None:
        self.failed += 1
        try:
            self.report(error)
        except Exception:  # no memory left to report it
            pass

    def wait(self, now: int, longest: int = _LONGEST_MS) -> int:
        """Return the milliseconds until a handle is ready by time, at most ``longest``.

        Handles that were ready when the trigger did not begin are ignored: the trigger waits for
        others.
        """
        handles = self.handles
        held = self._held
        if self.trigger is not None:
            longest = min(longest, _TRIGGER_MS)
        if self.watchdog is not None:
            longest = min(longest, _FEED_MS)
        for i in range(len(handles)):
            if held is not None and held[i]:
                continue
            if handles[i].is_ready(now):
                return 0
            deadline = handles[i].next_deadline()
            if deadline is not None:
                longest = min(longest, ticks_diff(deadline, now))
        return max(0, longest)

    def overfull(self) -> bool:
        """Return whether a handle has more items queued than its depth."""
        for handle in self.handles:
            if handle.overfull():
                return True
        return False


class Timer:
    """Calls a callback every ``period`` seconds; the n-th call is due at start + n periods.

    Periods that passed while other callbacks ran are skipped and counted in ``missed``. Periods are
    kept in nanoseconds, calls are due at whole milliseconds.

    Args:
        period: Seconds, 0.001 to 500000.
        callback: Called without arguments.
        clock: The node's clock.
        autostart: False creates the timer canceled.

    Raises:
        ValueError: The period is out of range.
    """

    invocation = ON_NEW_DATA
    kinds = None  # it has no object at the agent

    def __init__(
        self, period: float, callback: "Callable[[], object]", clock: "Any", autostart: bool = True
    ) -> None:
        self.callback = callback
        self.missed = 0
        self._clock = clock
        ns = int((period + 0) * 1000000000 + 0.5)  # + 0: raises TypeError for a str
        self._ms = ns // _NS
        self._ns = ns % _NS
        if self._ms < 1 or self._ms >= 500000000:
            raise ValueError("a timer's period is 0.001 to 500000 seconds, not %s" % period)
        self.reset()
        self._called = clock.ms()
        self._canceled = not autostart

    def reset(self) -> None:
        """Restart the timer, also after :meth:`cancel`; it is due one period from now."""
        self._due = self._clock.ms()
        self._rest = 0
        self._canceled = False
        self._advance(1)

    def cancel(self) -> None:
        """Stop calling the callback until :meth:`reset`."""
        self._canceled = True

    def is_canceled(self) -> bool:
        """Return whether the timer is canceled."""
        return self._canceled

    @property
    def timer_period_ns(self) -> int:
        """The period in nanoseconds; a new period applies after the next call."""
        return self._ms * _NS + self._ns

    @timer_period_ns.setter
    def timer_period_ns(self, ns: int) -> None:
        if ns < _NS or ns >= 500000000 * _NS:
            raise ValueError("a timer's period is 0.001 to 500000 seconds, not %d ns" % ns)
        self._ms = ns // _NS
        self._ns = ns % _NS

    def time_until_next_call(self) -> "int | None":
        """Return the nanoseconds until the next call, negative if it is late, None if canceled."""
        if self._canceled:
            return None
        return ticks_diff(self._due, self._clock.ms()) * _NS + self._rest

    def time_since_last_call(self) -> int:
        """Return the nanoseconds since the last call began, or since creation if there was none."""
        return ticks_diff(self._clock.ms(), self._called) * _NS

    def _advance(self, periods: int) -> None:
        ns = self._ns * periods + self._rest
        self._rest = ns % _NS
        self._due = ticks_add(self._due, self._ms * periods + ns // _NS)

    def next_deadline(self) -> "int | None":
        """Return the ticks in milliseconds of the next call, or None if canceled."""
        return None if self._canceled else self._due

    def is_ready(self, now: "int | None" = None) -> bool:
        """Return whether the timer is due at ``now``, by default at the current time."""
        if now is None:
            now = self._clock.ms()
        return not self._canceled and ticks_diff(now, self._due) >= 0

    def overfull(self) -> bool:
        """Return False: a timer has no queue."""
        return False

    def execute(self, new: bool) -> None:
        """Call the callback if due; with ALWAYS also if not."""
        if new:
            now = self._clock.ms()
            past = ticks_diff(now, self._due)
            if self._canceled or past < 0:
                return
            late = 0
            if past >= self._ms:
                late = (past * _NS - self._rest) // (self._ms * _NS + self._ns)
                self.missed += late
            self._called = now
            self._advance(late + 1)
        self.callback()
