"""peer.py with clients of the parameter services and of the lifecycle services of boards."""

import threading

import rclpy
from lifecycle_msgs.msg import TransitionEvent
from lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from peer import Peer
from rcl_interfaces.msg import ParameterEvent
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

ASK_AGAIN = 3.0
TYPES = {
    "change_state": ChangeState,
    "get_state": GetState,
    "get_available_states": GetAvailableStates,
    "get_available_transitions": GetAvailableTransitions,
    "get_transition_graph": GetAvailableTransitions,
}


def plain(value):
    """Convert a message or a value to JSON types; octets become numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    return [plain(item) for item in value]


class Camera(LifecycleNode):
    """An rclpy lifecycle node to compare with; ``outcomes`` are the results of its callbacks."""

    outcomes = {}

    def on_configure(self, state):
        return self.outcomes.get("configure", super().on_configure(state))

    def on_error(self, state):
        return self.outcomes.get("error", super().on_error(state))


class BoardPeer(Peer):
    def __init__(self):
        super().__init__()
        self.parameters = {}
        self.clients = {}
        self.answered = set()  # services that have answered
        self.events = []
        self.steps = []
        self.cameras = {}
        self.event_subscriptions = [
            self.node.create_subscription(
                ParameterEvent, "/parameter_events", self.events.append, 1000
            )
        ]

    def finish(self, ask, key, seconds):
        """Return the result of the future that ``ask()`` returns.

        The first request to a service may be lost and is repeated: see service_peer.py.
        """
        future = ask()
        while not self.wait(min(ASK_AGAIN, seconds), future.done):
            assert key not in self.answered and seconds > 0, f"{key} does not answer"
            seconds -= ASK_AGAIN
            future = ask()
        self.answered.add(key)
        return plain(future.result())

    def do_parameters(self, node, method, seconds=30, **arguments):
        """Call a method of rclpy's parameter client, and return the response."""
        if node not in self.parameters:
            self.parameters[node] = AsyncParameterClient(self.node, node)
        client = self.parameters[node]
        assert self.wait(seconds, client.services_are_ready), "the services are not available"
        if "parameters" in arguments:
            arguments["parameters"] = [
                Parameter(name, Parameter.Type(kind), value_of(kind, value))
                for name, kind, value in arguments["parameters"]
            ]
        ask = getattr(client, method)
        return {"response": self.finish(lambda: ask(**arguments), (node, method), seconds)}

    def do_parameter_events(self, node, count, seconds=15):
        """Wait for ``count`` parameter events of a node, and return all that have come."""

        def of_node():
            return [event for event in self.events if event.node == node]

        self.wait(seconds, lambda: len(of_node()) >= count)
        events = [plain(event) for event in of_node()]
        self.events.clear()
        return {"events": events}

    def do_lifecycle(self, node, service, values=None, seconds=30):
        """Call a lifecycle service of a node, and return the response."""
        name = f"{node}/{service}"
        if name not in self.clients:
            self.clients[name] = self.node.create_client(TYPES[service], name)
        client = self.clients[name]
        assert self.wait(seconds, client.service_is_ready), "the service is not available"
        request = TYPES[service].Request()
        if values is not None:
            request.transition.id, request.transition.label = values
        answer = self.finish(lambda: client.call_async(request), name, seconds)
        return {"response": answer}

    def do_hear_steps(self, node, seconds=15):
        """Subscribe to a node's transition events; ``publishers`` says whether it has them."""
        self.event_subscriptions.append(
            self.node.create_subscription(
                TransitionEvent, f"{node}/transition_event", self.steps.append, 10
            )
        )
        return {
            "publishers": self.wait(
                seconds, lambda: self.node.count_publishers(f"{node}/transition_event")
            )
        }

    def do_steps(self, count, seconds=15):
        """Wait for ``count`` transition events, and return all that have come."""
        self.wait(seconds, lambda: len(self.steps) >= count)
        steps = [plain(step) for step in self.steps]
        self.steps.clear()
        return {"steps": steps}

    def do_camera(self, name, seconds=15, **outcomes):
        """Create an rclpy lifecycle node, or change the results of its callbacks."""
        if name not in self.cameras:
            self.cameras[name] = Camera(name)
            executor = rclpy.executors.SingleThreadedExecutor()
            executor.add_node(self.cameras[name])
            threading.Thread(target=executor.spin, daemon=True).start()
        self.cameras[name].outcomes = {
            key: TransitionCallbackReturn.__members__[value] for key, value in outcomes.items()
        }
        return {}


def value_of(kind, value):
    """Convert a value to what rclpy's Parameter accepts: octets as a list of bytes objects."""
    return [bytes([octet]) for octet in value] if kind == 5 else value


if __name__ == "__main__":
    rclpy.init()
    try:
        BoardPeer().run()
    finally:
        rclpy.try_shutdown()
