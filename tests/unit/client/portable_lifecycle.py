"""Lifecycle nodes: their methods and their services. Also runs on MicroPython."""

from support.board import Number
from support.services import Bench

from uros.client.lifecycle import (
    LifecycleNode,
    LifecycleState,
    ManagedEntity,
    SimpleManagedEntity,
    TransitionCallbackReturn,
)

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR

# Recorded from rclpy's LifecycleNode (Kilted): its states and its transition graph.
STATES = [
    [0, "unknown"], [1, "unconfigured"], [2, "inactive"], [3, "active"], [4, "finalized"],
    [10, "configuring"], [11, "cleaningup"], [12, "shuttingdown"], [13, "activating"],
    [14, "deactivating"], [15, "errorprocessing"],
]  # fmt: skip
GRAPH = [
    [1, "configure", 1, "unconfigured", 10, "configuring"],
    [10, "transition_success", 10, "configuring", 2, "inactive"],
    [11, "transition_failure", 10, "configuring", 1, "unconfigured"],
    [12, "transition_error", 10, "configuring", 15, "errorprocessing"],
    [2, "cleanup", 2, "inactive", 11, "cleaningup"],
    [20, "transition_success", 11, "cleaningup", 1, "unconfigured"],
    [21, "transition_failure", 11, "cleaningup", 2, "inactive"],
    [22, "transition_error", 11, "cleaningup", 15, "errorprocessing"],
    [3, "activate", 2, "inactive", 13, "activating"],
    [30, "transition_success", 13, "activating", 3, "active"],
    [31, "transition_failure", 13, "activating", 2, "inactive"],
    [32, "transition_error", 13, "activating", 15, "errorprocessing"],
    [4, "deactivate", 3, "active", 14, "deactivating"],
    [40, "transition_success", 14, "deactivating", 2, "inactive"],
    [41, "transition_failure", 14, "deactivating", 3, "active"],
    [42, "transition_error", 14, "deactivating", 15, "errorprocessing"],
    [5, "shutdown", 1, "unconfigured", 12, "shuttingdown"],
    [6, "shutdown", 2, "inactive", 12, "shuttingdown"],
    [7, "shutdown", 3, "active", 12, "shuttingdown"],
    [50, "transition_success", 12, "shuttingdown", 4, "finalized"],
    [51, "transition_failure", 12, "shuttingdown", 4, "finalized"],
    [52, "transition_error", 12, "shuttingdown", 15, "errorprocessing"],
    [60, "transition_success", 15, "errorprocessing", 1, "unconfigured"],
    [61, "transition_failure", 15, "errorprocessing", 4, "finalized"],
    [62, "transition_error", 15, "errorprocessing", 4, "finalized"],
]
# The callback of each transition that can be requested.
CALLED = {
    "configure": "on_configure", "cleanup": "on_cleanup", "activate": "on_activate",
    "deactivate": "on_deactivate", "shutdown": "on_shutdown",
}  # fmt: skip
# The transitions to each state that is not final.
WAYS = {"unconfigured": [], "inactive": ["configure"], "active": ["configure", "activate"]}


class Device(LifecycleNode):
    """``calls`` are (callback, state before, state); ``outcomes`` are return values by callback."""

    def __init__(self, *arguments, **options):
        self.calls = []
        self.outcomes = {}
        LifecycleNode.__init__(self, *arguments, **options)

    def tell(self, name, state):
        assert isinstance(state, LifecycleState)
        self.calls.append((name, state.label, self.current_state.label))
        outcome = self.outcomes.get(name, SUCCESS)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def on_configure(self, state):
        return self.tell("on_configure", state)

    def on_cleanup(self, state):
        return self.tell("on_cleanup", state)

    def on_activate(self, state):
        return self.tell("on_activate", state)

    def on_deactivate(self, state):
        return self.tell("on_deactivate", state)

    def on_shutdown(self, state):
        return self.tell("on_shutdown", state)

    def on_error(self, state):
        return self.tell("on_error", state)


def bench(make=Device, **options):
    return Bench("cam", "/left", make=make, **options)


# Written out: the build of a board drops methods whose names do not occur.
TRIGGERS = {
    "configure": lambda node: node.trigger_configure(),
    "cleanup": lambda node: node.trigger_cleanup(),
    "activate": lambda node: node.trigger_activate(),
    "deactivate": lambda node: node.trigger_deactivate(),
    "shutdown": lambda node: node.trigger_shutdown(),
}


def trigger(node, label):
    return TRIGGERS[label](node)


def at(state, **options):
    """Return a bench whose device is in this state."""
    device = bench(**options)
    for label in WAYS[state]:
        assert trigger(device.node, label) == SUCCESS
    device.node.calls.clear()
    assert device.node.current_state.label == state
    return device


def row(start, label):
    """Return (number, transition state) of a transition."""
    for number, name, _, begin, _, goal in GRAPH:
        if (begin, name) == (start, label):
            return number, goal
    raise AssertionError((start, label))


def end(start, outcome):
    for _, name, _, begin, _, goal in GRAPH:
        if begin == start and name == ("transition_" + outcome):
            return goal
    raise AssertionError((start, outcome))


OUTCOMES = {SUCCESS: "success", FAILURE: "failure", ERROR: "error"}


# --- the machine ------------------------------------------------------------------------------


def test_each_outcome_of_each_transition_follows_the_graph() -> None:
    for state in WAYS:
        for label in CALLED:
            if not [
                transition
                for transition in GRAPH
                if transition[3] == state and transition[1] == label
            ]:
                continue
            between = row(state, label)[1]
            for outcome in (SUCCESS, FAILURE):
                node = at(state, connect=False).node
                node.outcomes[CALLED[label]] = outcome
                assert trigger(node, label) == outcome
                assert node.current_state.label == end(between, OUTCOMES[outcome])
                assert node.calls == [(CALLED[label], state, between)]
            for second in (SUCCESS, FAILURE, ERROR):
                node = at(state, connect=False).node
                node.outcomes = {CALLED[label]: ERROR, "on_error": second}
                assert trigger(node, label) == ERROR
                assert node.current_state.label == end("errorprocessing", OUTCOMES[second])
                assert node.calls[1] == ("on_error", state, "errorprocessing")


def test_invalid_transitions_change_nothing() -> None:
    for state in WAYS:
        for label in CALLED:
            if [
                transition
                for transition in GRAPH
                if transition[3] == state and transition[1] == label
            ]:
                continue
            node = at(state, connect=False).node
            assert trigger(node, label) == ERROR
            assert node.calls == [] and node.current_state.label == state


def test_finalized_has_no_transitions() -> None:
    node = at("inactive", connect=False).node
    assert node.trigger_shutdown() == SUCCESS
    assert node.current_state.label == "finalized" and node.current_state.state_id == 4
    for label in CALLED:
        assert trigger(node, label) == ERROR


def test_a_callback_that_raises_or_returns_none_is_a_reported_error() -> None:
    for outcome, text in ((RuntimeError("no lens"), "no lens"), (None, "on_configure gave None")):
        device = at("unconfigured")
        device.node.outcomes = {"on_configure": outcome}
        if outcome is None:
            device.node.on_configure = lambda state: None
        assert device.node.trigger_configure() == ERROR
        assert device.node.current_state.label == "unconfigured"  # on_error returned SUCCESS
        assert len(device.errors) == 1 and text in str(device.errors[0])


def test_a_callback_cannot_begin_another_transition() -> None:
    node = at("unconfigured", connect=False).node
    inside = []

    def configure(state):
        inside.append(node.trigger_activate())
        inside.append(node._machine.trigger("transition_success"))
        return SUCCESS

    node.on_configure = configure
    assert node.trigger_configure() == SUCCESS
    assert inside == [ERROR, ERROR] and node.current_state.label == "inactive"


# --- managed entities -------------------------------------------------------------------------


def test_a_lifecycle_publisher_sends_only_while_active() -> None:
    device = bench(LifecycleNode)
    node = device.node
    publisher = node.create_lifecycle_publisher(Number, "image")
    device.connect()
    sent = []
    for label in ("configure", "activate", "deactivate", "activate", "shutdown"):
        sent.append(publisher.publish(Number(1)))
        assert trigger(node, label) == SUCCESS
    sent.append(publisher.publish(Number(1)))
    assert sent == [False, False, True, False, True, False]
    device.run(50)
    assert (
        len([1 for object_id, _ in device.agent.samples if object_id & 15 == 5 and object_id >> 4])
        >= 2
    )
    assert publisher.published == 2 and publisher.name == "/left/image"


def test_a_lifecycle_publisher_of_a_node_with_its_own_callbacks() -> None:
    device = at("inactive")
    publisher = device.node.create_lifecycle_publisher(Number, "image")
    device.connect()
    device.node.outcomes["on_activate"] = FAILURE
    assert device.node.trigger_activate() == FAILURE and not publisher.publish(Number(1))
    device.node.outcomes.clear()
    assert device.node.trigger_activate() == SUCCESS and publisher.publish(Number(1))
    late = device.node.create_lifecycle_publisher(Number, "late")
    device.connect()
    assert late.publish(Number(1))
    device.node.destroy_lifecycle_publisher(late)
    device.node.outcomes = {"on_deactivate": ERROR, "on_error": FAILURE}
    assert device.node.trigger_deactivate() == ERROR and not publisher.publish(Number(1))


def test_managed_entities_follow_in_order_until_one_fails() -> None:
    calls = []

    class Part(ManagedEntity):
        def __init__(self, name, outcome=SUCCESS):
            self.name = name
            self.outcome = outcome

        def on_configure(self, state):
            calls.append((self.name, state.label))
            return self.outcome

    device = bench(LifecycleNode, connect=False)
    simple = SimpleManagedEntity()
    for part in (Part("a"), simple, Part("b", FAILURE), Part("c")):
        device.node.add_managed_entity(part)
    assert device.node.trigger_configure() == FAILURE
    assert calls == [("a", "unconfigured"), ("b", "unconfigured")]
    device = bench(LifecycleNode, connect=False)
    device.node.add_managed_entity(simple)
    activated = []
    for label in ("configure", "activate", "deactivate", "cleanup", "shutdown"):
        assert trigger(device.node, label) == SUCCESS
        activated.append(simple.is_activated)
    assert activated == [False, True, False, False, False]


# --- the services -----------------------------------------------------------------------------

NAME = "/left/cam/"


def test_the_services_answer_as_rclpys() -> None:
    device = bench()
    assert device.ask(NAME + "get_available_states", [0]) == [STATES]
    assert device.ask(NAME + "get_transition_graph", [0]) == [GRAPH]
    for state in WAYS:
        device = at(state)
        number = [row[0] for row in STATES if row[1] == state][0]
        assert device.ask(NAME + "get_state", [0]) == [number, state]
        available = device.ask(NAME + "get_available_transitions", [0])
        assert available == [[transition for transition in GRAPH if transition[3] == state]]
    device.node.trigger_shutdown()
    assert device.ask(NAME + "get_available_transitions", [0]) == [[]]


def test_change_state_takes_numbers_and_labels() -> None:
    device = bench()
    for values, success, state in (
        ([3, ""], False, "unconfigured"),
        ([1, ""], True, "inactive"),
        ([0, "activate"], True, "active"),
        ([1, "deactivate"], True, "inactive"),  # the label counts
        ([3, "none"], False, "inactive"),
        ([99, ""], False, "inactive"),
        ([10, ""], False, "inactive"),
        ([0, "transition_success"], False, "inactive"),
        ([6, ""], True, "finalized"),
        ([1, ""], False, "finalized"),
    ):
        assert device.ask(NAME + "change_state", values) == [success], values
        assert device.node.current_state.label == state
    assert not device.errors


def test_shutdown_has_a_number_for_each_state_and_one_label() -> None:
    for state in WAYS:
        device = at(state)
        wrong = [n for n in (5, 6, 7) if n != row(state, "shutdown")[0]]
        assert device.ask(NAME + "change_state", [wrong[0], ""]) == [False]
        assert device.ask(NAME + "change_state", [0, "shutdown"]) == [True]


def test_each_transition_is_published() -> None:
    device = bench()
    device.heard(NAME + "transition_event")
    device.node.trigger_configure()
    device.node.outcomes["on_activate"] = ERROR
    device.node.trigger_activate()
    heard = device.heard(NAME + "transition_event")
    assert all([event[0] > 1700000000 * 10**9 for event in heard])
    graph = {transition[0]: transition for transition in GRAPH}
    assert [event[1:] for event in heard] == [graph[n] for n in (1, 10, 3, 32, 60)]


def test_a_node_without_communication_interface() -> None:
    device = bench(enable_communication_interface=False)
    assert len(device.node._entities) == 0
    assert device.node.trigger_configure() == SUCCESS
    assert device.node.current_state.label == "inactive"


def test_the_state_outlives_the_agent() -> None:
    device = at("active")
    device.lose()
    device.connect()
    assert device.ask(NAME + "get_state", [0]) == [3, "active"]


def test_an_event_without_memory_does_not_stop_a_transition() -> None:
    for k in (1, 2):
        device = bench()
        events = device.node._machine._events
        publish = events.publish
        left = [k]

        def starving(message, left=left, publish=publish):
            left[0] -= 1
            if not left[0]:
                raise MemoryError
            return publish(message)

        events.publish = starving
        assert device.node.trigger_configure() == SUCCESS
        assert device.node.current_state.label == "inactive"
        assert [type(error) for error in device.errors] == [MemoryError]
