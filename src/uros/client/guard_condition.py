"""A guard condition: a program says that something has happened, and the executor calls back.

``trigger()`` only sets a flag, so an interrupt's handler or another thread may call it.
"""

from ..ticks import ticks_add
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

# Who waits for the agent does not see a flag that an interrupt has set: so long at most.
LATENCY_MS: Final = 20


class GuardCondition:
    """``callback()`` runs once in the next round after one trigger or many: a handle.

    What is triggered by an interrupt or a thread while the node waits is seen within
    LATENCY_MS. Made by ``node.create_guard_condition``.
    """

    invocation = ON_NEW_DATA
    kinds = None  # the agent knows nothing of it

    def __init__(self, callback: "Callable[[], object]", clock: "Any") -> None:
        self.callback = callback
        self._clock = clock
        self._triggered = False

    def trigger(self) -> None:
        """Allocates nothing."""
        self._triggered = True

    def is_ready(self, now: int) -> bool:
        return self._triggered

    def next_deadline(self) -> "int | None":
        return ticks_add(self._clock.ms(), LATENCY_MS)

    def overfull(self) -> bool:
        return False

    def execute(self, new: bool) -> None:
        self._triggered = False
        self.callback()
