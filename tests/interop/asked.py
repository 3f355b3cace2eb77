"""What a real rclpy says, once: JSON in the first argument, JSON on stdout.

``{"what": "presets"}``: its QoS profiles. ``{"what": "names", "cases": [[rules, node, namespace,
[asked ...]] ...]}``: what remapping makes of names. ``{"what": "refused", "rules": [...]}``: those
that it does not take. ``{"what": "endpoints", "topics": [...]}``: the publisher's or subscription's
QoS of each, waiting for them.
"""

import json
import sys
import time

import rclpy
import rclpy.qos
from rclpy.context import Context
from rclpy.node import Node

SECONDS = 30


def described(profile):
    """Times in milliseconds, None for unlimited."""

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
        name: described(getattr(rclpy.qos, name))
        for name in dir(rclpy.qos)
        if name.startswith("qos_profile_")
    }


def made(rules, name, namespace):
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        arguments = ["--ros-args", *(it for rule in rules for it in ("-r", rule))]
        return context, Node(
            name, namespace=namespace, context=context, cli_args=arguments,
            enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
    except BaseException:
        rclpy.shutdown(context=context)
        raise


def names(cases):
    answers = []
    for rules, name, namespace, asked in cases:
        context, node = made(rules, name, namespace)
        answer = [node.get_name(), node.get_namespace()]
        for it in asked:
            answer += [node.resolve_topic_name(it), node.resolve_service_name(it)]
        answers.append(answer)
        node.destroy_node()
        rclpy.shutdown(context=context)
    return answers


def refused(rules):
    out = []
    for rule in rules:
        try:
            context, node = made([rule], "node", "/ns")
        except Exception:
            out.append(rule)
        else:
            node.destroy_node()
            rclpy.shutdown(context=context)
    return out


def endpoints(topics):
    context, node = made([], "asking", "/real")
    deadline = time.monotonic() + SECONDS
    found = {}
    while len(found) < len(topics) and time.monotonic() < deadline:
        for topic in topics:
            infos = node.get_publishers_info_by_topic(topic)
            infos += node.get_subscriptions_info_by_topic(topic)
            if infos:
                found[topic] = described(infos[0].qos_profile)
        time.sleep(0.05)  # discovery has a thread of its own
    node.destroy_node()
    rclpy.shutdown(context=context)
    return found


question = json.loads(sys.argv[1])
print(json.dumps(globals()[question.pop("what")](**question)))
