"""A real rclpy node as a process: commands on stdin, events on stdout, one JSON line each.

Runs in an environment of its own without uros. A command is ``{"id": 1, "do": "subscribe", …}``;
its answer has the same id. Messages that arrive are events without an id. Commands that wait for
something poll rclpy until a deadline.
"""

import json
import queue
import sys
import threading
import time
from importlib import import_module

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

ASK_AGAIN = 0.02


def say(**event):
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def find_type(name):
    package, kind, plain = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), plain)


def profile(
    reliability="reliable", durability="volatile", depth=10, liveliness="automatic", **durations
):  # fmt: skip
    """A profile; ``durations`` are those of QoSProfile, in milliseconds."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy[reliability.upper()],
        durability=DurabilityPolicy[durability.upper()],
        liveliness=LivelinessPolicy[liveliness.upper()],
        **{name: Duration(nanoseconds=ms * 10**6) for name, ms in durations.items()},
    )


def events_of(topic):
    """Callbacks that report QoS events of a subscription."""
    return SubscriptionEventCallbacks(
        liveliness=lambda info: say(
            event="liveliness", topic=topic, alive=info.alive_count, not_alive=info.not_alive_count
        ),
        deadline=lambda info: say(event="deadline", topic=topic, total=info.total_count),
        incompatible_qos=lambda info: say(
            event="incompatible",
            topic=topic,
            policy=info.last_policy_kind.name.removeprefix("RMW_QOS_POLICY_"),
        ),
    )


class Peer:
    def __init__(self):
        self.node = rclpy.create_node("peer", namespace="/real")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publishers = {}
        self.subscriptions = {}

    def wait(self, seconds, ready):
        """Spin until ``ready()`` is true or the time is up; return its last result."""
        deadline = time.monotonic() + seconds
        while True:
            result = ready()
            if result or time.monotonic() > deadline:
                return result
            self.executor.spin_once(timeout_sec=ASK_AGAIN)

    # --- commands: the dictionary that each returns is put into the answer -------

    def do_subscribe(self, topic, type, seconds=15, **qos):
        """Subscribe; with ``seconds`` wait until a publisher is matched."""
        cls = find_type(type)

        def arrived(message):
            now = self.node.get_clock().now().nanoseconds
            cdr = bytes(serialize_message(message)).hex()
            say(event="message", topic=topic, cdr=cdr, now=now)

        if topic not in self.subscriptions:
            self.subscriptions[topic] = self.node.create_subscription(
                cls, topic, arrived, profile(**qos), event_callbacks=events_of(topic)
            )
        return {}

    def do_unsubscribe(self, topic):
        self.node.destroy_subscription(self.subscriptions.pop(topic))
        return {}

    def do_publish(self, topic, type, cdr, seconds=15, **qos):
        """Wait for a subscriber, then publish typed messages that are given as CDR."""
        cls = find_type(type)
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(cls, topic, profile(**qos))
        publisher = self.publishers[topic]
        matched = self.wait(seconds, publisher.get_subscription_count)
        for sample in cdr if matched else []:
            publisher.publish(deserialize_message(bytes.fromhex(sample), cls))
        return {"subscribers": matched}

    def do_node(self, namespace, name, publishers, seconds=15):
        """Wait until the node is in the graph with these publishers (topic → type)."""

        def ready():
            if (name, namespace) not in self.node.get_node_names_and_namespaces():
                return None
            try:
                types = dict(self.node.get_publisher_names_and_types_by_node(name, namespace))
            except rclpy.node.NodeNameNonExistentError:  # the node has left between the two calls
                return None
            return (types,) if all(types.get(t) == [k] for t, k in publishers.items()) else None

        (types,) = self.wait(seconds, ready) or (None,)
        return {"publishers": types, **self.do_graph()}

    def do_gone(self, namespace, name, seconds=15):
        """Wait until the node is no longer in the graph."""
        gone = self.wait(
            seconds, lambda: (name, namespace) not in self.node.get_node_names_and_namespaces()
        )
        return {"gone": gone, **self.do_graph()}

    def do_unused(self, topic, seconds=15):
        """Wait until the topic has neither a publisher nor a subscription."""
        node = self.node
        unused = self.wait(
            seconds,
            lambda: (
                not (
                    node.get_publishers_info_by_topic(topic)
                    or node.get_subscriptions_info_by_topic(topic)
                )
            ),
        )
        return {"unused": unused}

    def do_graph(self):
        return {
            "names": sorted(self.node.get_node_names()),
            "full_names": sorted(
                f"{namespace.rstrip('/')}/{name}"
                for name, namespace in self.node.get_node_names_and_namespaces()
            ),
        }

    def do_topic(self, topic, seconds=15, of="publishers", count=1):
        """Wait for ``count`` publishers (subscriptions) of a topic; return type and QoS of each."""
        ask = getattr(self.node, f"get_{of}_info_by_topic")
        self.wait(seconds, lambda: len(ask(topic)) >= count)
        return {
            "infos": [
                {
                    "type": info.topic_type,
                    "hash": str(info.topic_type_hash),
                    "reliability": info.qos_profile.reliability.name,
                    "durability": info.qos_profile.durability.name,
                }
                for info in ask(topic)
            ]
        }

    def run(self):
        commands = queue.Queue()

        def read():
            for line in sys.stdin:
                commands.put(json.loads(line))
            commands.put(None)

        threading.Thread(target=read, daemon=True).start()
        say(event="ready")
        while True:
            try:
                command = commands.get_nowait()
            except queue.Empty:
                self.executor.spin_once(timeout_sec=ASK_AGAIN)
                continue
            if command is None:
                return
            number, name = command.pop("id"), command.pop("do")
            try:
                say(id=number, **getattr(self, "do_" + name)(**command))
            except Exception as error:
                say(id=number, error=repr(error))


if __name__ == "__main__":
    rclpy.init()
    try:
        Peer().run()
    finally:
        rclpy.shutdown()
