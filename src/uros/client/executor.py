"""Runs what is ready: timers, samples, requests and answers, in the order they were added.

As rclc's executor: one round looks at all handles, asks the trigger whether to begin at all, and
then calls each one that has something new, or whose ``invocation`` is ALWAYS, once.
"""

from ..wire.streams import ticks_add, ticks_diff

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


def trigger_any(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when one handle is ready: the default."""
    return any(ready)


def trigger_all(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when every handle is ready."""
    return all(ready)


def trigger_always(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin every round."""
    return True


def trigger_one(handle: "Any") -> "Callable[[list[Any], list[bool]], bool]":
    """Begin when ``handle`` is ready."""

    def trigger(handles: "list[Any]", ready: "list[bool]") -> bool:
        return handle in handles and ready[handles.index(handle)]

    return trigger


class Executor:
    """See the module. ``max_handles`` makes one more than so many an error, as rclc does.

    A handle has ``invocation``, ``is_ready(now)``, ``execute(new)`` and ``next_deadline()``.
    ``failed`` counts callbacks that raised; what they raised goes to ``report``, which prints it,
    and the rest goes on.
    """

    def __init__(self, max_handles: "int | None" = None) -> None:
        self.max_handles = max_handles
        self.handles: "list[Any]" = []
        self.trigger: "Callable[[list[Any], list[bool]], bool]" = trigger_any
        self.failed = 0
        self.report: "Callable[[Exception], object]" = print_exception
        self._held: "list[Any]" = []  # what was ready in a round that the trigger let not begin

    def add(self, handle: "Any") -> None:
        """Add a handle behind the others. Raises ValueError when there are enough."""
        if self.max_handles is not None and len(self.handles) >= self.max_handles:
            raise ValueError("the executor was made for %d handles" % self.max_handles)
        self.handles.append(handle)

    def remove(self, handle: "Any") -> None:
        """Forget a handle; one that is not there too."""
        if handle in self.handles:
            self.handles.remove(handle)

    def execute(self, now: int) -> int:
        """One round at ``now`` (milliseconds modulo 2^30); how many callbacks ran."""
        self._held = []
        ready = [handle.is_ready(now) for handle in self.handles]
        if True not in ready and self.trigger is trigger_any:
            return 0
        handles = list(self.handles)  # callbacks may add and remove
        if not self.trigger(handles, ready):
            self._held = [handles[i] for i in range(len(handles)) if ready[i]]
            return 0
        count = 0
        for i in range(len(handles)):
            handle = handles[i]
            if (ready[i] or handle.invocation == ALWAYS) and handle in self.handles:
                count += 1
                try:
                    handle.execute(ready[i])
                except Exception as error:
                    self.failed += 1
                    self.report(error)
        return count

    def wait(self, now: int, longest: int = _LONGEST_MS) -> int:
        """Milliseconds until something is ready, as far as time tells: at most ``longest``.

        What was ready already when the trigger said no waits for news of others.
        """
        for handle in self.handles:
            if handle in self._held:
                continue
            if handle.is_ready(now):
                return 0
            deadline = handle.next_deadline()
            if deadline is not None:
                longest = min(longest, ticks_diff(deadline, now))
        return max(0, longest)


class Timer:
    """Calls back every ``period`` seconds; the n-th time is due at start + n periods.

    Times that have passed while something else ran are left out and counted in ``missed``.
    """

    invocation = ON_NEW_DATA

    def __init__(self, period: float, callback: "Callable[[], object]", clock: "Any") -> None:
        self.callback = callback
        self.missed = 0
        self._clock = clock
        self._us = int(period * 1000000 + 0.5)
        if self._us < 1000 or self._us >= 500000000000:
            raise ValueError("a timer's period is 0.001 to 500000 seconds, not %s" % period)
        self._canceled = False
        self.reset()

    def reset(self) -> None:
        """Begin anew: due a period from now, also after :meth:`cancel`."""
        self._due = self._clock.ms()
        self._rest = 0
        self._canceled = False
        self._advance()

    def cancel(self) -> None:
        """No more calls until :meth:`reset`."""
        self._canceled = True

    def is_canceled(self) -> bool:
        return self._canceled

    def _advance(self, periods: int = 1) -> None:
        us = self._us * periods + self._rest
        self._rest = us % 1000
        self._due = ticks_add(self._due, us // 1000)

    def next_deadline(self) -> "int | None":
        return None if self._canceled else self._due

    def is_ready(self, now: int) -> bool:
        return not self._canceled and ticks_diff(now, self._due) >= 0

    def execute(self, new: bool) -> None:
        if new:
            past = ticks_diff(self._clock.ms(), self._due)
            if self._canceled or past < 0:  # reset: both may happen in this same round
                return
            late = past * 1000 // self._us
            self.missed += late
            self._advance(late + 1)
        self.callback()
