"""Runs what is ready: timers, samples, requests and answers, in the order they were added.

As rclc's executor: one round looks at all handles, asks the trigger whether to begin at all, and
then calls each one that has something new, or whose ``invocation`` is ALWAYS, once. Other triggers
than "any" are in ``triggers``, logical execution time and fixed periods in ``let``.
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

# Timers are looked at no later than this, so that waiting fits any platform's integers.
_LONGEST_MS: Final = 60000
# A trigger is asked at least so often, whatever it looks at: rclc's default.
_TRIGGER_MS: Final = 100
_NS: Final = 1000000  # in a millisecond


class Executor:
    """See the module. ``max_handles`` makes one more than so many an error, as rclc does.

    A handle has ``invocation``, ``is_ready(now)``, ``execute(new)``, ``next_deadline()`` and
    ``overfull()``. ``trigger(handles, ready)`` is one of ``triggers`` or the program's own; None
    begins when one handle is ready. ``between()`` is called after each callback. ``failed`` counts
    callbacks that raised; what they raised goes to ``report``, which prints it, and the rest goes
    on. A round without a trigger allocates nothing of its own.
    """

    def __init__(self, max_handles: "int | None" = None) -> None:
        self.max_handles = max_handles
        self.handles: "list[Any]" = []  # replaced at each change: a round goes on with its own
        self.trigger: "Callable[[list[Any], list[bool]], bool] | None" = None
        self.between: "Callable[[], object] | None" = None
        self.failed = 0
        self.report: "Callable[[Exception], object]" = print_exception
        # What was ready in a round that the trigger let not begin; None: ask all.
        self._held: "list[bool] | None" = None

    def add(self, handle: "Any") -> None:
        """Add a handle behind the others. Raises ValueError when there are enough."""
        if self.max_handles is not None and len(self.handles) >= self.max_handles:
            raise ValueError("the executor was made for %d handles" % self.max_handles)
        self.handles = self.handles + [handle]
        self._held = None

    def remove(self, handle: "Any") -> None:
        """Forget a handle; one that is not there too."""
        if handle in self.handles:
            self.handles = [it for it in self.handles if it is not handle]
            self._held = None

    def execute(self, now: int) -> int:
        """One round at ``now`` (milliseconds modulo 2^30); how many callbacks ran."""
        handles = self.handles
        ready = self._held
        self._held = None  # a callback that spins has a round, and a list, of its own
        if ready is None:
            ready = [False] * len(handles)
        begin = False
        for i in range(len(handles)):
            ready[i] = handles[i].is_ready(now)
            begin = begin or ready[i]
        if self.trigger is not None:
            begin = False  # also where it raises
            try:
                begin = self.trigger(handles, ready)
            except Exception as error:
                self._fail(error)
        count = 0
        for i in range(len(handles) if begin else 0):
            handle = handles[i]
            # What was ready may not be any more, or be gone, by callbacks that ran before.
            new = ready[i] and handle.is_ready(now)
            ready[i] = False
            if (new or handle.invocation == ALWAYS) and handle in self.handles:
                count += 1
                try:
                    handle.execute(new)
                except Exception as error:
                    self._fail(error)
                if self.between is not None:
                    self.between()
        if handles is self.handles:
            self._held = ready
        return count

    def _fail(self, error: Exception) -> None:
        self.failed += 1
        try:
            self.report(error)
        except Exception:  # no memory left to say it with
            pass

    def wait(self, now: int, longest: int = _LONGEST_MS) -> int:
        """Milliseconds until something is ready, as far as time tells: at most ``longest``.

        What was ready already when the trigger said no waits for news of others.
        """
        handles = self.handles
        held = self._held
        if self.trigger is not None:
            longest = min(longest, _TRIGGER_MS)
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
        """Whether more waits for some callback than should."""
        for handle in self.handles:
            if handle.overfull():
                return True
        return False


class Timer:
    """Calls back every ``period`` seconds; the n-th time is due at start + n periods.

    Times that have passed while something else ran are left out and counted in ``missed``. With
    ``autostart`` false it is made canceled. Periods count in nanoseconds, calls in milliseconds.
    """

    invocation = ON_NEW_DATA
    kinds = None  # the agent knows nothing of it

    def __init__(
        self, period: float, callback: "Callable[[], object]", clock: "Any", autostart: bool = True
    ) -> None:
        self.callback = callback
        self.missed = 0
        self._clock = clock
        ns = int((period + 0) * 1000000000 + 0.5)  # + 0: a text is no number
        self._ms = ns // _NS
        self._ns = ns % _NS
        if self._ms < 1 or self._ms >= 500000000:
            raise ValueError("a timer's period is 0.001 to 500000 seconds, not %s" % period)
        self.reset()
        self._called = clock.ms()
        self._canceled = not autostart

    def reset(self) -> None:
        """Begin anew: due a period from now, also after :meth:`cancel`."""
        self._due = self._clock.ms()
        self._rest = 0
        self._canceled = False
        self._advance(1)

    def cancel(self) -> None:
        """No more calls until :meth:`reset`."""
        self._canceled = True

    def is_canceled(self) -> bool:
        return self._canceled

    @property
    def timer_period_ns(self) -> int:
        """May be set: what is due next stays, and the times after it are a new period apart."""
        return self._ms * _NS + self._ns

    @timer_period_ns.setter
    def timer_period_ns(self, ns: int) -> None:
        if ns < _NS or ns >= 500000000 * _NS:
            raise ValueError("a timer's period is 0.001 to 500000 seconds, not %d ns" % ns)
        self._ms = ns // _NS
        self._ns = ns % _NS

    def time_until_next_call(self) -> "int | None":
        """Nanoseconds, below 0 where it is late; None: it is canceled."""
        if self._canceled:
            return None
        return ticks_diff(self._due, self._clock.ms()) * _NS + self._rest

    def time_since_last_call(self) -> int:
        """Nanoseconds since the last call began, at first since the timer was made."""
        return ticks_diff(self._clock.ms(), self._called) * _NS

    def _advance(self, periods: int) -> None:
        ns = self._ns * periods + self._rest
        self._rest = ns % _NS
        self._due = ticks_add(self._due, self._ms * periods + ns // _NS)

    def next_deadline(self) -> "int | None":
        return None if self._canceled else self._due

    def is_ready(self, now: "int | None" = None) -> bool:
        """Whether it is due."""
        if now is None:
            now = self._clock.ms()
        return not self._canceled and ticks_diff(now, self._due) >= 0

    def overfull(self) -> bool:
        return False

    def execute(self, new: bool) -> None:
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
