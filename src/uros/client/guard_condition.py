"""Guard condition: a program triggers it, and the executor calls a callback.

``trigger()`` only sets a flag, so an interrupt handler or another thread may call it.
"""

from ..ticks import ticks_add
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

# Longest wait for the agent, because the wait does not end when an interrupt sets the flag.
LATENCY_MS: Final = 20


class GuardCondition:
    """Handle that calls ``callback()`` once in the next round after one or more triggers.

    A trigger by an interrupt or a thread while the node waits takes effect within LATENCY_MS.
    Created by ``node.create_guard_condition``.
    """

    invocation = ON_NEW_DATA
    kinds = None  # it has no object at the agent

    def __init__(self, callback: "Callable[[], object]", clock: "Any") -> None:
        self.callback = callback
        self._clock = clock
        self._triggered = False

    def trigger(self) -> None:
        """Have the callback called in the next round; allocates nothing."""
        self._triggered = True

    def is_ready(self, now: int) -> bool:
        """Return whether it was triggered."""
        return self._triggered

    def next_deadline(self) -> "int | None":
        """Return the ticks LATENCY_MS from now, to limit the wait."""
        return ticks_add(self._clock.ms(), LATENCY_MS)

    def overfull(self) -> bool:
        """Return False: triggers are not queued."""
        return False

    def execute(self, new: bool) -> None:
        """Clear the flag and call the callback."""
        self._triggered = False
        self.callback()
