"""Nodes with a life cycle, by their methods and by their services. Also runs on MicroPython."""

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
# The callback of each transition that others may ask for.
CALLED = {
    "configure": "on_configure", "cleanup": "on_cleanup", "activate": "on_activate",
    "deactivate": "on_deactivate", "shutdown": "on_shutdown",
}  # fmt: skip
# The way to each state from which one may go on.
WAYS = {"unconfigured": [], "inactive": ["configure"], "active": ["configure", "activate"]}


class Device(LifecycleNode):
    """``calls`` are its callbacks and the states before; ``says`` what they give, by name."""

    def __init__(self, *arguments, **options):
        self.calls = []
        self.says = {}
        LifecycleNode.__init__(self, *arguments, **options)

    def tell(self, name, state):
        assert isinstance(state, LifecycleState)
        self.calls.append((name, state.label, self.current_state.label))
        outcome = self.says.get(name, SUCCESS)
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


# Written out, as a board's build drops methods that nobody names.
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
    """A device in this state."""
    it = bench(**options)
    for label in WAYS[state]:
        assert trigger(it.node, label) == SUCCESS
    it.node.calls.clear()
    assert it.node.current_state.label == state
    return it


def row(start, label):
    """(number, transition state) of a transition."""
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


def test_each_transition_with_each_outcome_goes_where_the_graph_says() -> None:
    for state in WAYS:
        for label in CALLED:
            if not [it for it in GRAPH if it[3] == state and it[1] == label]:
                continue
            between = row(state, label)[1]
            for outcome in (SUCCESS, FAILURE):
                node = at(state, connect=False).node
                node.says[CALLED[label]] = outcome
                assert trigger(node, label) == outcome
                assert node.current_state.label == end(between, OUTCOMES[outcome])
                assert node.calls == [(CALLED[label], state, between)]
            for second in (SUCCESS, FAILURE, ERROR):
                node = at(state, connect=False).node
                node.says = {CALLED[label]: ERROR, "on_error": second}
                assert trigger(node, label) == ERROR
                assert node.current_state.label == end("errorprocessing", OUTCOMES[second])
                assert node.calls[1] == ("on_error", state, "errorprocessing")


def test_what_cannot_be_now_changes_nothing() -> None:
    for state in WAYS:
        for label in CALLED:
            if [it for it in GRAPH if it[3] == state and it[1] == label]:
                continue
            node = at(state, connect=False).node
            assert trigger(node, label) == ERROR
            assert node.calls == [] and node.current_state.label == state


def test_finalized_is_the_end() -> None:
    node = at("inactive", connect=False).node
    assert node.trigger_shutdown() == SUCCESS
    assert node.current_state.label == "finalized" and node.current_state.state_id == 4
    for label in CALLED:
        assert trigger(node, label) == ERROR


def test_a_callback_that_raises_or_says_nothing_is_an_error_and_told() -> None:
    for said, told in ((RuntimeError("no lens"), "no lens"), (None, "on_configure gave None")):
        it = at("unconfigured")
        it.node.says = {"on_configure": said}
        if said is None:
            it.node.on_configure = lambda state: None
        assert it.node.trigger_configure() == ERROR
        assert it.node.current_state.label == "unconfigured"  # on_error was content
        assert len(it.errors) == 1 and told in str(it.errors[0])


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


# --- what follows it --------------------------------------------------------------------------


def test_a_publisher_is_silent_unless_active() -> None:
    it = bench(LifecycleNode)
    node = it.node
    publisher = node.create_lifecycle_publisher(Number, "image")
    it.connect()
    sent = []
    for label in ("configure", "activate", "deactivate", "activate", "shutdown"):
        sent.append(publisher.publish(Number(1)))
        assert trigger(node, label) == SUCCESS
    sent.append(publisher.publish(Number(1)))
    assert sent == [False, False, True, False, True, False]
    it.run(50)
    assert len([1 for thing, _ in it.agent.samples if thing & 15 == 5 and thing >> 4]) >= 2
    assert publisher.published == 2 and publisher.name == "/left/image"


def test_a_publisher_of_a_program_with_its_own_callbacks() -> None:
    it = at("inactive")
    publisher = it.node.create_lifecycle_publisher(Number, "image")
    it.connect()
    it.node.says["on_activate"] = FAILURE
    assert it.node.trigger_activate() == FAILURE and not publisher.publish(Number(1))
    it.node.says.clear()
    assert it.node.trigger_activate() == SUCCESS and publisher.publish(Number(1))
    late = it.node.create_lifecycle_publisher(Number, "late")
    it.connect()
    assert late.publish(Number(1))
    it.node.destroy_lifecycle_publisher(late)
    it.node.says = {"on_deactivate": ERROR, "on_error": FAILURE}
    assert it.node.trigger_deactivate() == ERROR and not publisher.publish(Number(1))


def test_managed_entities_follow_in_their_order_until_one_does_not() -> None:
    calls = []

    class Part(ManagedEntity):
        def __init__(self, name, says=SUCCESS):
            self.name = name
            self.says = says

        def on_configure(self, state):
            calls.append((self.name, state.label))
            return self.says

    it = bench(LifecycleNode, connect=False)
    simple = SimpleManagedEntity()
    for part in (Part("a"), simple, Part("b", FAILURE), Part("c")):
        it.node.add_managed_entity(part)
    assert it.node.trigger_configure() == FAILURE
    assert calls == [("a", "unconfigured"), ("b", "unconfigured")]
    it = bench(LifecycleNode, connect=False)
    it.node.add_managed_entity(simple)
    seen = []
    for label in ("configure", "activate", "deactivate", "cleanup", "shutdown"):
        assert trigger(it.node, label) == SUCCESS
        seen.append(simple.is_activated)
    assert seen == [False, True, False, False, False]


# --- the services -----------------------------------------------------------------------------

NAME = "/left/cam/"


def test_the_services_tell_what_rclpys_node_tells() -> None:
    it = bench()
    assert it.ask(NAME + "get_available_states", [0]) == [STATES]
    assert it.ask(NAME + "get_transition_graph", [0]) == [GRAPH]
    for state in WAYS:
        it = at(state)
        number = [one[0] for one in STATES if one[1] == state][0]
        assert it.ask(NAME + "get_state", [0]) == [number, state]
        available = it.ask(NAME + "get_available_transitions", [0])
        assert available == [[one for one in GRAPH if one[3] == state]]
    it.node.trigger_shutdown()
    assert it.ask(NAME + "get_available_transitions", [0]) == [[]]


def test_others_drive_it_by_number_or_label() -> None:
    it = bench()
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
        assert it.ask(NAME + "change_state", values) == [success], values
        assert it.node.current_state.label == state
    assert not it.errors


def test_shutdown_has_a_number_for_each_state_and_one_label() -> None:
    for state in WAYS:
        it = at(state)
        wrong = [n for n in (5, 6, 7) if n != row(state, "shutdown")[0]]
        assert it.ask(NAME + "change_state", [wrong[0], ""]) == [False]
        assert it.ask(NAME + "change_state", [0, "shutdown"]) == [True]


def test_each_step_is_told() -> None:
    it = bench()
    it.heard(NAME + "transition_event")
    it.node.trigger_configure()
    it.node.says["on_activate"] = ERROR
    it.node.trigger_activate()
    heard = it.heard(NAME + "transition_event")
    assert all([one[0] > 1700000000 * 10**9 for one in heard])
    graph = {one[0]: one for one in GRAPH}
    assert [one[1:] for one in heard] == [graph[n] for n in (1, 10, 3, 32, 60)]


def test_a_node_may_keep_it_to_itself() -> None:
    it = bench(enable_communication_interface=False)
    assert len(it.node._entities) == 0
    assert it.node.trigger_configure() == SUCCESS
    assert it.node.current_state.label == "inactive"


def test_the_state_outlives_the_agent() -> None:
    it = at("active")
    it.lose()
    it.connect()
    assert it.ask(NAME + "get_state", [0]) == [3, "active"]


def test_an_event_that_finds_no_memory_stops_no_transition() -> None:
    for k in (1, 2):
        it = bench()
        events = it.node._machine._events
        publish = events.publish
        left = [k]

        def starving(message, left=left, publish=publish):
            left[0] -= 1
            if not left[0]:
                raise MemoryError
            return publish(message)

        events.publish = starving
        assert it.node.trigger_configure() == SUCCESS
        assert it.node.current_state.label == "inactive"
        assert [type(one) for one in it.errors] == [MemoryError]
