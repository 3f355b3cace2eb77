"""Checks the QoS of publishers and subscriptions: which pairs do not match, and how to fix them.

The rules are those of DDS: a writer must offer at least what the reader requests.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final

from ...qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from .finding import Finding, note, ok, problem, word
from .graph import Picture, full_name

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo

# From weakest to strongest. An unknown one counts as the first.
_DURABILITIES: Final = (
    DurabilityPolicy.VOLATILE,
    DurabilityPolicy.TRANSIENT_LOCAL,
    DurabilityPolicy.TRANSIENT,
    DurabilityPolicy.PERSISTENT,
)
_DURABILITY_NAMES: Final = ("volatile", "transient_local", "transient", "persistent")
# Of more mismatches the first ones are reported.
_MOST: Final = 32
# Attack: a thousand writers and a thousand readers on one topic.
_MAX_PAIRS: Final = 20_000


@dataclass(frozen=True)
class Mismatch:
    """One policy that keeps a writer and a reader from matching.

    Attributes:
        policy: The policy's name.
        offered: The writer's value.
        requested: The reader's value.
        offer: The rule of ``uros agent --qos`` that makes a board's writer match, or nothing.
        request: The rule that makes a board's reader match, or nothing.
    """

    policy: str
    offered: str
    requested: str
    offer: str = ""
    request: str = ""


def mismatches(offered: QoSProfile, requested: QoSProfile) -> list[Mismatch]:
    """Return why a writer and a reader of one topic and type do not match; empty if they do."""
    found = []
    if requested.reliable and not offered.reliable:
        found.append(
            Mismatch(
                "reliability",
                "best_effort",
                "reliable",
                "reliability=reliable",
                "reliability=best_effort",
            )  # fmt: skip
        )
    have, want = _rank(offered.durability), _rank(requested.durability)
    if have < want:
        found.append(
            Mismatch(
                "durability",
                _DURABILITY_NAMES[have],
                _DURABILITY_NAMES[want],
                "durability=transient_local" if want == 1 else "",
                f"durability={_DURABILITY_NAMES[have]}" if have < 2 else "",
            )  # fmt: skip
        )
    if _longer(offered.deadline_ms, requested.deadline_ms):
        found.append(
            Mismatch(
                "deadline",
                _time(offered.deadline_ms),
                _time(requested.deadline_ms),
                f"deadline_ms={requested.deadline_ms}",
                "" if offered.deadline_ms is None else f"deadline_ms={offered.deadline_ms}",
            )  # fmt: skip
        )
    manual = LivelinessPolicy.MANUAL_BY_TOPIC
    if requested.liveliness == manual and offered.liveliness != manual:
        found.append(
            Mismatch(
                "liveliness",
                "automatic",
                "manual_by_topic",
                "liveliness=manual_by_topic",
                "liveliness=automatic",
            )  # fmt: skip
        )
    if _longer(offered.liveliness_lease_ms, requested.liveliness_lease_ms):
        lease = offered.liveliness_lease_ms
        found.append(
            Mismatch(
                "liveliness lease",
                _time(lease),
                _time(requested.liveliness_lease_ms),
                f"liveliness_lease_ms={requested.liveliness_lease_ms}",
                "" if lease is None else f"liveliness_lease_ms={lease}",
            )  # fmt: skip
        )
    if offered.ownership_exclusive != requested.ownership_exclusive:
        words = {True: "exclusive", False: "shared"}
        found.append(
            Mismatch(
                "ownership",
                words[offered.ownership_exclusive],
                words[requested.ownership_exclusive],
            )
        )
    if not _meet(offered.partitions, requested.partitions):
        found.append(Mismatch("partition", _list(offered.partitions), _list(requested.partitions)))
    return found


def _rank(durability: int) -> int:
    return _DURABILITIES.index(durability) if durability in _DURABILITIES else 0


def _longer(offered: int | None, requested: int | None) -> bool:
    return requested is not None and (offered is None or offered > requested)


def _time(milliseconds: int | None) -> str:
    return "unlimited" if milliseconds is None else f"{milliseconds} ms"


def _list(partitions: Sequence[str]) -> str:
    return ", ".join(map(repr, partitions)) if partitions else "none"


def _meet(offered: Sequence[str], requested: Sequence[str]) -> bool:
    """Whether two lists of partitions have one in common.

    A pattern matches names, but no pattern, not even itself. An empty list is the partition ''.
    """
    for offer in offered or ("",):
        for request in requested or ("",):
            if _is_pattern(offer) and _is_pattern(request):
                continue
            if fnmatchcase(offer, request) or fnmatchcase(request, offer):
                return True
    return False


def _is_pattern(partition: str) -> bool:
    return any(sign in partition for sign in "*?[")


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
