"""A publisher whose words are not lost when there is no agent to hear them yet."""

from ..ticks import ticks_add, ticks_diff
from .connection import AGENT_CONNECTED
from .entities import Publisher
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

# How soon it is tried again where there was no room.
_RETRY_MS: Final = 100


class LatchedPublisher(Publisher):
    """Calls ``on_connected()`` in the executor's turn each time that the publisher is there
    again, and once more after a while where that says False or raises. Only then it is a handle of
    the executor, so that triggers do not wait for it.
    """

    invocation = ON_NEW_DATA

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.on_connected: "Callable[[], object]" = bool
        self._due = 0
        super().__init__(node, name, type, qos)

    def create(self, connection: "Any", step: int) -> bool:
        self.call_in(0)
        return super().create(connection, step)

    def call_in(self, ms: int = _RETRY_MS) -> None:
        """Have ``on_connected`` called so much later, unless it is to be called anyway."""
        executor = self.node.executor
        if self not in executor.handles:
            self._due = ticks_add(self.node.clock.ms(), ms)
            try:
                executor.add(self)
            except ValueError:  # made for no more handles
                pass

    def on_lost(self) -> None:
        self.node.executor.remove(self)
        super().on_lost()

    def is_ready(self, now: int) -> bool:
        due = self.next_deadline()
        return due is not None and ticks_diff(now, due) >= 0

    def next_deadline(self) -> "int | None":
        # Not before it can be called: waiting for the agent would be spinning without a pause.
        connected = self.created and self.node.connection.state == AGENT_CONNECTED
        return self._due if connected else None

    def overfull(self) -> bool:
        return False

    def execute(self, new: bool) -> None:
        self._due = ticks_add(self.node.clock.ms(), _RETRY_MS)  # also where it raises
        if self.on_connected() is not False:
            self.node.executor.remove(self)


def create_latched(node: "Any", type: "Any", topic: str, qos: "Any") -> LatchedPublisher:
    """Make one for the node."""
    publisher = LatchedPublisher(node, node.resolve_topic_name(topic), type, qos)
    node._entities.append(publisher)
    return publisher
