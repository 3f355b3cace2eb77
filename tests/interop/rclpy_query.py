"""Ask a real rclpy one question: JSON in the first argument, the answer as JSON on stdout.

``{"query": "presets"}``: the QoS profiles of rclpy. ``{"query": "names", "cases": [[rules, node,
namespace, [names ...]] ...]}``: the names after remapping. ``{"query": "refused_rules", "rules":
[...]}``: the remapping rules that rclpy refuses. ``{"query": "endpoints", "topics": [...]}``: the
QoS of the publisher or subscription of each topic, once it is discovered.
"""

import json
import sys
import time

import rclpy
import rclpy.qos
from rclpy.context import Context
from rclpy.node import Node

SECONDS = 30


def qos_fields(profile):
    """Return the policies of a profile; times in milliseconds, None for unlimited."""

    def milliseconds(duration):
        ns = duration.nanoseconds
        return None if ns == 0 or ns >= 2**62 else ns // 1_000_000

    return {
        "depth": profile.depth,
        "reliability": int(profile.reliability),
        "durability": int(profile.durability),
        "history": int(profile.history),
        "liveliness": int(profile.liveliness),
        "deadline_ms": milliseconds(profile.deadline),
        "lifespan_ms": milliseconds(profile.lifespan),
    }


def presets():
    return {
        name: qos_fields(getattr(rclpy.qos, name))
        for name in dir(rclpy.qos)
        if name.startswith("qos_profile_")
    }


def make_node(rules, name, namespace):
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        arguments = ["--ros-args", *(word for rule in rules for word in ("-r", rule))]
        return context, Node(
            name, namespace=namespace, context=context, cli_args=arguments,
            enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
    except BaseException:
        rclpy.shutdown(context=context)
        raise


def names(cases):
    answers = []
    for rules, node_name, namespace, unresolved in cases:
        context, node = make_node(rules, node_name, namespace)
        answer = [node.get_name(), node.get_namespace()]
        for name in unresolved:
            answer += [node.resolve_topic_name(name), node.resolve_service_name(name)]
        answers.append(answer)
        node.destroy_node()
        rclpy.shutdown(context=context)
    return answers


def refused_rules(rules):
    refused = []
    for rule in rules:
        try:
            context, node = make_node([rule], "node", "/ns")
        except Exception:
            refused.append(rule)
        else:
            node.destroy_node()
            rclpy.shutdown(context=context)
    return refused


def endpoints(topics):
    context, node = make_node([], "asking", "/real")
    deadline = time.monotonic() + SECONDS
    profiles = {}
    while len(profiles) < len(topics) and time.monotonic() < deadline:
        for topic in topics:
            infos = node.get_publishers_info_by_topic(topic)
            infos += node.get_subscriptions_info_by_topic(topic)
            if infos:
                profiles[topic] = qos_fields(infos[0].qos_profile)
        time.sleep(0.05)  # discovery has a thread of its own
    node.destroy_node()
    rclpy.shutdown(context=context)
    return profiles


question = json.loads(sys.argv[1])
print(json.dumps(globals()[question.pop("query")](**question)))
