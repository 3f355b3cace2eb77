"""Common parts of action client and action server: goal states, names, entities.

An action ``/x`` has three services, ``/x/_action/send_goal``, ``cancel_goal`` and ``get_result``,
and two topics, ``/x/_action/feedback`` and ``status``. :mod:`~uros.client.action_server` and
:mod:`~uros.client.action_client` are separate modules, so that a board loads only the one it uses.
"""

from ..wire import ids
from .executor import ON_NEW_DATA

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

UNKNOWN: Final = 0
ACCEPTED: Final = 1
EXECUTING: Final = 2
CANCELING: Final = 3
SUCCEEDED: Final = 4
CANCELED: Final = 5
ABORTED: Final = 6


class GoalStatus:
    """Goal states, with the names and numbers of ``action_msgs/msg/GoalStatus``."""

    STATUS_UNKNOWN = 0
    STATUS_ACCEPTED = 1
    STATUS_EXECUTING = 2
    STATUS_CANCELING = 3
    STATUS_SUCCEEDED = 4
    STATUS_CANCELED = 5
    STATUS_ABORTED = 6


class GoalResponse:
    """Return values of a ``goal_callback``."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse:
    """Return values of a ``cancel_callback``."""

    REJECT = 1
    ACCEPT = 2


class End:
    """Base class of action client and action server: a single handle of the executor.

    ``entities`` are all entities of the action, ``parts`` those that receive. In each round one of
    ``parts`` is executed, the first that is ready. ``states`` is the publisher or subscription of
    the status topic.
    """

    invocation = ON_NEW_DATA
    kinds = ()  # type: tuple[int, ...]
    states: "Any"

    def __init__(self, node: "Any", action_type: "Any", action_name: str) -> None:
        self.node = node
        self.action_type = action_type
        self.name: str = node.resolve_topic_name(action_name)
        self.parts: "tuple[Any, ...]" = ()
        self.entities: "tuple[Any, ...]" = ()
        self.service("cancel_goal")  # the longest name: raises if it is too long
        node.executor.add(self)  # first: raises if the executor has max_handles already
        node._entities.append(self)

    def make(self, kind: "Callable[..., Any]", *arguments: "Any") -> "Any":
        """Create one of the entities; on failure destroy those created before and raise."""
        try:
            entity = kind(*arguments)
        except Exception:
            self.destroy()
            raise
        self.entities += (entity,)
        return entity

    def make_states(self, make: "Callable[..., Any]", qos: "Any", *arguments: "Any") -> None:
        """Create ``states``.

        By default its durability is transient local. On a board a flag sets that, which takes less
        memory than a QoSProfile.
        """
        flags = 0
        if qos is None:
            qos = self.node.connection.transient_local(1)
            flags = ids.QOS_TRANSIENT_LOCAL
        kind = self.action_type.Impl.GoalStatusMessage
        self.states = self.make(make, self.node, self.topic("status"), kind, qos, *arguments)
        self.states.flags |= flags

    def is_ready(self, now: int) -> bool:
        """Return whether one of the parts is ready."""
        ready = False
        # Every part is asked, because is_ready of a service also sends its queued replies.
        for part in self.parts:
            if part.is_ready(now):
                ready = True
        return ready

    def next_deadline(self) -> "int | None":
        """Return None: it has no deadline."""
        return None

    def overfull(self) -> bool:
        """Return whether one of the parts has more items queued than its depth."""
        for part in self.parts:
            if part.overfull():
                return True
        return False

    def execute(self, new: bool) -> None:
        """Execute the first part that is ready."""
        now = self.node.clock.ms()
        for part in self.parts:
            if part.is_ready(now):
                part.execute(True)
                return

    def destroy(self) -> None:
        """Delete the entities in this session and do not create them in later ones."""
        self.node.forget(self)
        for part in self.entities:
            part.created = False
            self.node.connection.remove(part, tuple([part.object_id(kind) for kind in part.kinds]))

    def topic(self, name: str) -> str:
        """Return the full name of one of the action's topics."""
        full: str = self.node.resolve_topic_name(self.name + "/_action/" + name)
        return full

    def service(self, name: str) -> str:
        """Return the full name of one of the action's services."""
        full: str = self.node.resolve_service_name(self.name + "/_action/" + name)
        return full

    def attempt(self, call: "Callable[..., Any]", *arguments: "Any") -> "Any":
        """Call a function of the program and return its result.

        If it raises, the executor reports the exception, as for any callback, and None is returned.
        """
        try:
            return call(*arguments)
        except Exception as error:
            self.node.executor._fail(error)
            return None
