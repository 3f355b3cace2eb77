"""Publisher that repeats its last message to each new agent."""

from ..ticks import ticks_add, ticks_diff
from .connection import AGENT_CONNECTED
from .entities import Publisher
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

# Time until a retry.
_RETRY_MS: Final = 100


class LatchedPublisher(Publisher):
    """Publisher that calls ``on_connected()`` each time it has been created at an agent.

    The executor calls it, and again after 100 ms if it returns False or raises. The publisher is a
    handle of the executor only while such a call is pending, so that triggers do not wait for it.
    """

    invocation = ON_NEW_DATA

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.on_connected: "Callable[[], object]" = bool
        self._due = 0
        super().__init__(node, name, type, qos)

    def create(self, connection: "Any", step: int) -> bool:
        """Create the publisher and have ``on_connected`` called."""
        self.call_in(0)
        return super().create(connection, step)

    def call_in(self, ms: int = _RETRY_MS) -> None:
        """Have ``on_connected`` called after ``ms`` milliseconds, unless a call is pending."""
        executor = self.node.executor
        if self not in executor.handles:
            self._due = ticks_add(self.node.clock.ms(), ms)
            try:
                executor.add(self)
            except ValueError:  # the executor has max_handles already
                pass

    def on_lost(self) -> None:
        """Drop a pending call: the session has ended."""
        self.node.executor.remove(self)
        super().on_lost()

    def is_ready(self, now: int) -> bool:
        """Return whether the pending call is due."""
        due = self.next_deadline()
        return due is not None and ticks_diff(now, due) >= 0

    def next_deadline(self) -> "int | None":
        """Return the ticks of the pending call, or None while not connected."""
        # While not connected, a deadline that has passed would turn the wait into busy waiting.
        connected = self.created and self.node.connection.state == AGENT_CONNECTED
        return self._due if connected else None

    def overfull(self) -> bool:
        """Return False: at most one call is pending."""
        return False

    def execute(self, new: bool) -> None:
        """Call ``on_connected``; schedule a retry if it returns False or raises."""
        self._due = ticks_add(self.node.clock.ms(), _RETRY_MS)  # also if it raises
        if self.on_connected() is not False:
            self.node.executor.remove(self)


def create_latched(node: "Any", type: "Any", topic: str, qos: "Any") -> LatchedPublisher:
    """Create a latched publisher for the node."""
    publisher = LatchedPublisher(node, node.resolve_topic_name(topic), type, qos)
    node._entities.append(publisher)
    return publisher
