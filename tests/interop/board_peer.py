"""peer.py for what boards offer besides topics: parameters by rclpy's own client, life cycles."""

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
    """A message or a value as JSON has it; octets as numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    return [plain(item) for item in value]


class Camera(LifecycleNode):
    """A node of rclpy's own, to compare with; ``says`` are the outcomes of its callbacks."""

    says = {}

    def on_configure(self, state):
        return self.says.get("configure", super().on_configure(state))

    def on_error(self, state):
        return self.says.get("error", super().on_error(state))


class BoardPeer(Peer):
    def __init__(self):
        super().__init__()
        self.parameters = {}
        self.clients = {}
        self.met = set()
        self.events = []
        self.steps = []
        self.cameras = {}
        self.kept = [
            self.node.create_subscription(
                ParameterEvent, "/parameter_events", self.events.append, 1000
            )
        ]

    def finish(self, ask, key, seconds):
        """What ``ask()`` comes to. A first request may be lost, and is repeated: see
        service_peer.py."""
        future = ask()
        while not self.wait(min(ASK_AGAIN, seconds), future.done):
            assert key not in self.met and seconds > 0, f"{key} does not answer"
            seconds -= ASK_AGAIN
            future = ask()
        self.met.add(key)
        return plain(future.result())

    def do_parameters(self, node, method, seconds=30, **arguments):
        """Call a method of rclpy's parameter client; the response."""
        if node not in self.parameters:
            self.parameters[node] = AsyncParameterClient(self.node, node)
        client = self.parameters[node]
        assert self.wait(seconds, client.services_are_ready), "the services are not there"
        if "parameters" in arguments:
            arguments["parameters"] = [
                Parameter(name, Parameter.Type(kind), value_of(kind, value))
                for name, kind, value in arguments["parameters"]
            ]
        ask = getattr(client, method)
        return {"response": self.finish(lambda: ask(**arguments), (node, method), seconds)}

    def do_parameter_events(self, node, count, seconds=15):
        """The next so many parameter events of a node."""
        self.wait(seconds, lambda: len([it for it in self.events if it.node == node]) >= count)
        events = [plain(it) for it in self.events if it.node == node]
        self.events.clear()
        return {"events": events}

    def do_lifecycle(self, node, service, values=None, seconds=30):
        """Call a service of a node's life cycle; the response."""
        name = f"{node}/{service}"
        if name not in self.clients:
            self.clients[name] = self.node.create_client(TYPES[service], name)
        client = self.clients[name]
        assert self.wait(seconds, client.service_is_ready), "the service is not there"
        request = TYPES[service].Request()
        if values is not None:
            request.transition.id, request.transition.label = values
        answer = self.finish(lambda: client.call_async(request), name, seconds)
        return {"response": answer}

    def do_hear_steps(self, node, seconds=15):
        """Hear the steps of a node from now on; whether it publishes them."""
        self.kept.append(
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
        """The next so many steps."""
        self.wait(seconds, lambda: len(self.steps) >= count)
        steps = [plain(it) for it in self.steps]
        self.steps.clear()
        return {"steps": steps}

    def do_camera(self, name, seconds=15, **says):
        """Make a node of rclpy's own with a life cycle, or change what its callbacks say."""
        if name not in self.cameras:
            self.cameras[name] = Camera(name)
            executor = rclpy.executors.SingleThreadedExecutor()
            executor.add_node(self.cameras[name])
            threading.Thread(target=executor.spin, daemon=True).start()
        self.cameras[name].says = {
            key: TransitionCallbackReturn.__members__[value] for key, value in says.items()
        }
        return {}


def value_of(kind, value):
    """What rclpy wants: octets one by one."""
    return [bytes([it]) for it in value] if kind == 5 else value


if __name__ == "__main__":
    rclpy.init()
    try:
        BoardPeer().run()
    finally:
        rclpy.try_shutdown()
