"""What both ends of an action share: the states of a goal, names, and their place in a node.

An action ``/x`` is three services, ``/x/_action/send_goal``, ``cancel_goal`` and ``get_result``,
and two topics, ``/x/_action/feedback`` and ``status``. :mod:`~uros.client.action_server` and
:mod:`~uros.client.action_client` are modules of their own: a board pays for the end that it has.
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
    """The states of a goal, by the names and numbers of ``action_msgs/msg/GoalStatus``."""

    STATUS_UNKNOWN = 0
    STATUS_ACCEPTED = 1
    STATUS_EXECUTING = 2
    STATUS_CANCELING = 3
    STATUS_SUCCEEDED = 4
    STATUS_CANCELED = 5
    STATUS_ABORTED = 6


class GoalResponse:
    """What a ``goal_callback`` returns."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse:
    """What a ``cancel_callback`` returns."""

    REJECT = 1
    ACCEPT = 2


class End:
    """One end of an action: a single handle of the executor. ``made`` are its entities, and
    ``parts`` those that receive; one of them has its turn in a round, an earlier one before a later
    one. ``states`` is the end of the topic of states.
    """

    invocation = ON_NEW_DATA
    kinds = ()  # type: tuple[int, ...]
    states: "Any"

    def __init__(self, node: "Any", action_type: "Any", action_name: str) -> None:
        self.node = node
        self.action_type = action_type
        self.name: str = node.resolve_topic_name(action_name)
        self.parts: "tuple[Any, ...]" = ()
        self.made: "tuple[Any, ...]" = ()
        self.service("cancel_goal")  # the longest name: raises where it is too long
        node.executor.add(self)  # raises where there are enough, before anything is half made
        node._entities.append(self)

    def make(self, kind: "Callable[..., Any]", *arguments: "Any") -> "Any":
        """One of the entities. Where it cannot be made, what was made before goes, too."""
        try:
            entity = kind(*arguments)
        except Exception:
            self.destroy()
            raise
        self.made += (entity,)
        return entity

    def make_states(self, make: "Callable[..., Any]", qos: "Any", *arguments: "Any") -> None:
        """Make ``states``. By default their last message is kept for who comes late: on a board a
        flag says so, which takes less memory than a QoSProfile.
        """
        flags = 0
        if qos is None:
            qos = self.node.connection.transient_local(1)
            flags = ids.QOS_TRANSIENT_LOCAL
        kind = self.action_type.Impl.GoalStatusMessage
        self.states = self.make(make, self.node, self.topic("status"), kind, qos, *arguments)
        self.states.flags |= flags

    def is_ready(self, now: int) -> bool:
        ready = False
        for part in self.parts:  # all are asked: a service sends in there what had no room before
            if part.is_ready(now):
                ready = True
        return ready

    def next_deadline(self) -> "int | None":
        return None

    def overfull(self) -> bool:
        for part in self.parts:
            if part.overfull():
                return True
        return False

    def execute(self, new: bool) -> None:
        """One callback."""
        now = self.node.clock.ms()
        for part in self.parts:
            if part.is_ready(now):
                part.execute(True)
                return

    def destroy(self) -> None:
        """Take it off the network, now and in sessions to come."""
        self.node.forget(self)
        for part in self.made:
            part.created = False
            self.node.connection.remove(part, tuple([part.object_id(kind) for kind in part.kinds]))

    def topic(self, name: str) -> str:
        """The full name of one of its topics."""
        full: str = self.node.resolve_topic_name(self.name + "/_action/" + name)
        return full

    def service(self, name: str) -> str:
        """The full name of one of its services."""
        full: str = self.node.resolve_service_name(self.name + "/_action/" + name)
        return full

    def attempt(self, call: "Callable[..., Any]", *arguments: "Any") -> "Any":
        """What the program's ``call`` returns. None where it raises: the executor is told, as of
        any callback, and the rest goes on.
        """
        try:
            return call(*arguments)
        except Exception as error:
            self.node.executor._fail(error)
            return None
