"""Lifecycle nodes, as in rclpy.lifecycle: other nodes start and stop them by transitions.

::

    class Camera(LifecycleNode):
        def on_configure(self, state):
            self.images = self.create_lifecycle_publisher(CompressedImage, "image", 1)
            return TransitionCallbackReturn.SUCCESS

``ros2 lifecycle`` and lifecycle managers use its five services, and receive each transition on
``~/transition_event``. Ids and labels are those of lifecycle_msgs.
"""

from .dynamic_messages import Shape, ShapedService
from .entities import Publisher
from .node import Node

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

UNCONFIGURED: Final = 1
INACTIVE: Final = 2
ACTIVE: Final = 3
FINALIZED: Final = 4
CONFIGURING: Final = 10
ERROR_PROCESSING: Final = 15

_STATES: Final = (
    "unknown unconfigured inactive active finalized - - - - -"
    " configuring cleaningup shuttingdown activating deactivating errorprocessing"
)
_TRANSITIONS: Final = (
    "create configure cleanup activate deactivate shutdown shutdown shutdown destroy"
)
_OUTCOMES: Final = "transition_success transition_failure transition_error"
# Transition, start state, goal state, in the order of rcl_lifecycle. Transitions from 10 on end a
# transition state; their last digit means success (0), failure (1) or error (2).
_TABLE: Final = (
    b"\x01\x01\x0a\x0a\x0a\x02\x0b\x0a\x01\x0c\x0a\x0f\x02\x02\x0b\x14\x0b\x01\x15\x0b\x02"
    b"\x16\x0b\x0f\x03\x02\x0d\x1e\x0d\x03\x1f\x0d\x02\x20\x0d\x0f\x04\x03\x0e\x28\x0e\x02"
    b"\x29\x0e\x03\x2a\x0e\x0f\x05\x01\x0c\x06\x02\x0c\x07\x03\x0c\x32\x0c\x04\x33\x0c\x04"
    b"\x34\x0c\x0f\x3c\x0f\x01\x3d\x0f\x04\x3e\x0f\x04"
)
_CALLBACKS: Final = (
    "on_configure", "on_cleanup", "on_shutdown", "on_activate", "on_deactivate", "on_error",
)  # fmt: skip


class TransitionCallbackReturn:
    """Return values of transition callbacks."""

    SUCCESS = 97
    FAILURE = 98
    ERROR = 99


class LifecycleState:
    """A state, with its label and its number."""

    def __init__(self, label: str, state_id: int) -> None:
        self.label = label
        self.state_id = state_id

    def __repr__(self) -> str:
        return "LifecycleState(%r, %d)" % (self.label, self.state_id)


class ManagedEntity:
    """Base class of objects that follow a node's transitions.

    Each method gets the LifecycleState before the transition and returns a
    TransitionCallbackReturn.
    """

    def on_configure(self, state: LifecycleState) -> int:
        """Handle the transition configure."""
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> int:
        """Handle the transition cleanup."""
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> int:
        """Handle the transition shutdown."""
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> int:
        """Handle the transition activate."""
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> int:
        """Handle the transition deactivate."""
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> int:
        """Handle an error of another transition."""
        return TransitionCallbackReturn.SUCCESS


class SimpleManagedEntity(ManagedEntity):
    """Managed entity that only keeps whether it is activated."""

    is_activated = False

    def on_activate(self, state: LifecycleState) -> int:
        """Set ``is_activated``."""
        self.is_activated = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> int:
        """Clear ``is_activated``."""
        self.is_activated = False
        return TransitionCallbackReturn.SUCCESS


class LifecyclePublisher(Publisher):
    """Publisher that sends messages only while its node is active."""

    def __init__(self, node: "Any", name: str, type: "Any", qos: "Any") -> None:
        self.is_activated = False
        super().__init__(node, name, type, qos)

    def publish(self, message: "Any") -> bool:
        """Send a message; return False if the node is not active or the message was dropped."""
        return self.is_activated and super().publish(message)


class StateMachine:
    """State machine of a lifecycle node, and its services; ``state`` is the number of the state.

    Args:
        node: The node.
        talks: Whether to create the services and the publisher of transition events.
    """

    def __init__(self, node: "Any", talks: bool) -> None:
        self.state = UNCONFIGURED
        self._node = node
        self._events: "Any" = None
        if not talks:
            return
        transitions = "[BsBsBs]"
        # A request without fields is one octet in CDR.
        for name, kind, request, response, callback in (
            ("change_state", "ChangeState", "Bs", "?", self._on_change),
            ("get_state", "GetState", "B", "Bs", self._on_get),
            ("get_available_states", "GetAvailableStates", "B", "[Bs]", self._on_states),
            ("get_available_transitions", "GetAvailableTransitions", "B", transitions,
             self._on_transitions),
            ("get_transition_graph", "GetAvailableTransitions", "B", transitions, self._on_graph),
        ):  # fmt: skip
            service = ShapedService("lifecycle_msgs/srv/" + kind, request, response)
            node.create_service(service, "~/" + name, callback)
        shape = Shape("lifecycle_msgs/msg/TransitionEvent", "QBsBsBs")
        self._events = node.create_publisher(shape, "~/transition_event", 10)

    def find(self, wanted: "int | str", state: int) -> int:
        """Return the transition with this number or label that begins in ``state``; 0 if none."""
        for i in range(0, len(_TABLE), 3):
            if _TABLE[i + 1] == state and wanted in (_TABLE[i], _label(_TABLE[i])):
                return _TABLE[i]
        return 0

    def trigger(self, wanted: "int | str") -> int:
        """Make a transition with its callbacks; return a TransitionCallbackReturn."""
        before = LifecycleState(state_label(self.state), self.state)
        number = self.find(wanted, self.state)
        if not 0 < number < CONFIGURING:
            self._say("no transition %s from state %s" % (wanted, before.label))
            return TransitionCallbackReturn.ERROR
        self._go(number)
        outcome = self._call(before)
        if outcome == TransitionCallbackReturn.ERROR:
            self._call(before)  # now in the state errorprocessing
        for entity in self._node._managed:
            if isinstance(entity, LifecyclePublisher):
                entity.is_activated = self.state == ACTIVE
        return outcome

    def _call(self, before: LifecycleState) -> int:
        """Call the callback of the transition state and leave the state according to its result."""
        name = _CALLBACKS[self.state - CONFIGURING]
        outcome = TransitionCallbackReturn.ERROR
        try:
            outcome = getattr(self._node, name)(before)
            if outcome not in (97, 98, 99):
                wrong, outcome = outcome, TransitionCallbackReturn.ERROR
                raise TypeError("%s gave %r, no TransitionCallbackReturn" % (name, wrong))
        except Exception as error:
            self._node.executor._fail(error)
        self._go(self.find(_OUTCOMES.split(" ")[outcome - 97], self.state))
        return outcome

    def _go(self, number: int) -> None:
        """Change the state and publish the transition event."""
        start = self.state
        for i in range(0, len(_TABLE), 3):
            if _TABLE[i] == number and _TABLE[i + 1] == start:
                self.state = _TABLE[i + 2]
        if self._events is not None and self._events.created:
            try:
                seconds, nanoseconds = self._node.clock.now()
                values = [seconds * 1000000000 + nanoseconds, number, _label(number)]
                values += [start, state_label(start), self.state, state_label(self.state)]
                self._events.publish(self._events.type(values))
            except Exception as error:  # no memory; the transition must not stop halfway
                self._node.executor._fail(error)

    def _say(self, text: str) -> None:
        logger = self._node._rosout
        if logger is None:
            print("%s: %s" % (self._node.name, text))
        else:
            logger.logger.error(text)

    # --- the services ---------------------------------------------------------------------------

    def _on_change(self, request: "Any", response: "Any") -> "Any":
        number, label = request.values
        success = TransitionCallbackReturn.SUCCESS
        response.values = [self.trigger(label or number) == success]
        return response

    def _on_get(self, request: "Any", response: "Any") -> "Any":
        response.values = [self.state, state_label(self.state)]
        return response

    def _on_states(self, request: "Any", response: "Any") -> "Any":
        labels = _STATES.split(" ")
        states = [[i, labels[i]] for i in range(len(labels)) if labels[i] != "-"]
        response.values = [states]
        return response

    def _on_transitions(self, request: "Any", response: "Any") -> "Any":
        response.values = [self._described(self.state)]
        return response

    def _on_graph(self, request: "Any", response: "Any") -> "Any":
        response.values = [self._described(0)]
        return response

    def _described(self, state: int) -> "list[Any]":
        """Return the transitions from a state, for 0 all transitions."""
        out = []
        for i in range(0, len(_TABLE), 3):
            number, start, goal = _TABLE[i], _TABLE[i + 1], _TABLE[i + 2]
            if state in (0, start):
                out.append(
                    [number, _label(number), start, state_label(start), goal, state_label(goal)]
                )
        return out


class LifecycleMethods:
    """Mixin with the methods of a lifecycle node; its user sets ``_machine`` and ``_managed``.

    The callbacks call those of the managed entities until one does not return SUCCESS. A program
    that overrides a callback calls it if it has managed entities.
    """

    _machine: StateMachine
    _managed: "list[Any]"

    @property
    def current_state(self) -> LifecycleState:
        """The LifecycleState of the node."""
        return LifecycleState(state_label(self._machine.state), self._machine.state)

    def trigger_configure(self) -> int:
        """Make the transition configure; return a TransitionCallbackReturn."""
        return self._machine.trigger("configure")

    def trigger_cleanup(self) -> int:
        """Make the transition cleanup; return a TransitionCallbackReturn."""
        return self._machine.trigger("cleanup")

    def trigger_activate(self) -> int:
        """Make the transition activate; return a TransitionCallbackReturn."""
        return self._machine.trigger("activate")

    def trigger_deactivate(self) -> int:
        """Make the transition deactivate; return a TransitionCallbackReturn."""
        return self._machine.trigger("deactivate")

    def trigger_shutdown(self) -> int:
        """Make the transition shutdown; return a TransitionCallbackReturn."""
        return self._machine.trigger("shutdown")

    def add_managed_entity(self, entity: "Any") -> None:
        """Have a ManagedEntity follow the node's transitions, after those added before."""
        self._managed.append(entity)

    def create_lifecycle_publisher(
        self, msg_type: "Any", topic: str, qos_profile: "Any" = 10
    ) -> LifecyclePublisher:
        """Create a LifecyclePublisher, which follows the node's transitions."""
        node: "Any" = self
        publisher = LifecyclePublisher(node, node.resolve_topic_name(topic), msg_type, qos_profile)
        publisher.is_activated = self._machine.state == ACTIVE
        node._entities.append(publisher)
        self._managed.append(publisher)
        return publisher

    def destroy_lifecycle_publisher(self, publisher: LifecyclePublisher) -> None:
        """Destroy a LifecyclePublisher."""
        self._managed.remove(publisher)
        publisher.destroy()

    def on_configure(self, state: LifecycleState) -> int:
        """Call ``on_configure`` of the managed entities."""
        return self._follow("on_configure", state)

    def on_cleanup(self, state: LifecycleState) -> int:
        """Call ``on_cleanup`` of the managed entities."""
        return self._follow("on_cleanup", state)

    def on_shutdown(self, state: LifecycleState) -> int:
        """Call ``on_shutdown`` of the managed entities."""
        return self._follow("on_shutdown", state)

    def on_activate(self, state: LifecycleState) -> int:
        """Call ``on_activate`` of the managed entities and activate the publishers."""
        return self._follow("on_activate", state)

    def on_deactivate(self, state: LifecycleState) -> int:
        """Call ``on_deactivate`` of the managed entities and deactivate the publishers."""
        return self._follow("on_deactivate", state)

    def on_error(self, state: LifecycleState) -> int:
        """Call ``on_error`` of the managed entities."""
        return self._follow("on_error", state)

    def _follow(self, name: str, state: LifecycleState) -> int:
        for entity in list(self._managed):
            outcome: int = TransitionCallbackReturn.SUCCESS
            if isinstance(entity, LifecyclePublisher):
                entity.is_activated = name == "on_activate"  # first: later entities may publish
            else:
                outcome = getattr(entity, name)(state)
            if outcome != TransitionCallbackReturn.SUCCESS:
                return outcome
        return TransitionCallbackReturn.SUCCESS


class LifecycleNode(LifecycleMethods, Node):
    """Lifecycle node; see :class:`~uros.client.node.Node` for the other arguments.

    Args:
        enable_communication_interface: Whether the node has the services and the transition events.
            Otherwise only the program itself changes its state.
    """

    def __init__(
        self, name: str, transport: "Any", namespace: str = "", domain_id: int = 0,
        key: "int | None" = None, enable_communication_interface: bool = True,
        **options: "Any",
    ) -> None:  # fmt: skip
        Node.__init__(self, name, transport, namespace, domain_id, key, **options)
        self._managed = []
        self._machine = StateMachine(self, enable_communication_interface)


def state_label(number: int) -> str:
    """Return the label of a state, ``inactive`` for 2."""
    return _STATES.split(" ")[number]


def _label(number: int) -> str:
    if number < CONFIGURING:
        return _TRANSITIONS.split(" ")[number]
    return _OUTCOMES.split(" ")[number % 10]
