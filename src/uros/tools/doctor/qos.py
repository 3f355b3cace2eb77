"""Checks the QoS of publishers and subscriptions: which pairs do not match, and how to fix them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Final

from ...middleware.qos_matching import Mismatch, mismatches
from .finding import Finding, note, ok, problem, word
from .graph import Picture, full_name

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo

# Of more mismatches the first ones are reported.
_MOST: Final = 32
# Attack: a thousand writers and a thousand readers on one topic.
_MAX_PAIRS: Final = 20_000


# --- a graph ------------------------------------------------------------------------------------


def check_qos(picture: Picture, domain: int, boards: Collection[str] = ()) -> list[Finding]:
    """Find the pairs of a domain that do not match.

    Args:
        picture: The graph.
        domain: Its domain.
        boards: Full names of boards' nodes, whose QoS ``uros agent --qos`` can change.
    """
    found: dict[Finding, None] = {}
    pairs = 0
    for topic in picture.topics:
        for writer in picture.writers(topic):
            for reader in picture.readers(topic):
                if writer.type_name != reader.type_name:
                    continue  # check_types reports it
                if pairs == _MAX_PAIRS:
                    break
                pairs += 1
                for mismatch in mismatches(writer.qos, reader.qos):
                    found[_pair(topic, writer, reader, mismatch, boards)] = None
    rest = []
    if len(found) > _MOST:
        more = len(found) - _MOST
        rest.append(note("qos", f"and {more} more pairs in domain {domain} do not match"))
    if pairs == _MAX_PAIRS:
        rest.append(note("qos", f"domain {domain} has more pairs than the {pairs} looked at"))
    if found or rest:
        return [*list(found)[:_MOST], *rest]
    if pairs:
        what = "the one pair" if pairs == 1 else f"all {pairs} pairs"
        return [ok("qos", f"the QoS of {what} of writer and reader in domain {domain} fit")]
    return []


def _pair(
    topic: str, writer: EndpointInfo, reader: EndpointInfo, one: Mismatch,
    boards: Collection[str],
) -> Finding:  # fmt: skip
    sender, receiver = full_name(writer), full_name(reader)
    return problem(
        "qos",
        f"nothing that {sender} publishes on {topic} reaches {receiver}: {one.policy} offered is"
        f" {one.offered}, requested {one.requested}",
        _fix(topic, sender, receiver, one, boards),
        about=f"{topic} to {receiver}",
        kind=f"{one.policy} {one.offered} {one.requested}",
    )


# How rclpy's QoSProfile spells a policy and its value.
_IN_CODE: Final[Mapping[str, str]] = {
    "reliability=reliable": "reliability=ReliabilityPolicy.RELIABLE",
    "reliability=best_effort": "reliability=ReliabilityPolicy.BEST_EFFORT",
    "durability=transient_local": "durability=DurabilityPolicy.TRANSIENT_LOCAL",
    "durability=volatile": "durability=DurabilityPolicy.VOLATILE",
    "liveliness=manual_by_topic": "liveliness=LivelinessPolicy.MANUAL_BY_TOPIC",
    "liveliness=automatic": "liveliness=LivelinessPolicy.AUTOMATIC",
}


def _fix(topic: str, sender: str, receiver: str, one: Mismatch, boards: Collection[str]) -> str:
    if receiver in boards and one.request:
        return f"start the agent with --qos {word(f'{topic}:{one.request}')}"
    if sender in boards and one.offer:
        return f"start the agent with --qos {word(f'{topic}:{one.offer}')}"
    for node, rule, kind in (
        (receiver, one.request, "subscription"),
        (sender, one.offer, "publisher"),
    ):
        if rule and node not in boards:
            return f"in {node}, create the {kind} of {topic} with {_code(rule)}"
    if one.policy == "partition":
        return f"give {sender} and {receiver} a common partition, or none, on {topic}"
    return f"set the same {one.policy} for {topic} in {sender} and {receiver}"


def _code(rule: str) -> str:
    if rule in _IN_CODE:
        return f"QoSProfile({_IN_CODE[rule]}, ...)"
    name, _, value = rule.partition("=")
    argument = {"deadline_ms": "deadline", "liveliness_lease_ms": "liveliness_lease_duration"}
    return f"QoSProfile({argument.get(name, name)}=Duration(nanoseconds={value}000000), ...)"
