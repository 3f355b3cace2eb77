"""Which writers and readers of a topic do not reach each other for their QoS, and what mends it.

The rules are DDS's: what a writer offers must be as good as what the reader requests.
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
    from ...host.graph import EndpointInfo

# The better ones are further behind; what is not here counts as the first.
_DURABILITIES: Final = (
    DurabilityPolicy.VOLATILE,
    DurabilityPolicy.TRANSIENT_LOCAL,
    DurabilityPolicy.TRANSIENT,
    DurabilityPolicy.PERSISTENT,
)
_DURABILITY_NAMES: Final = ("volatile", "transient_local", "transient", "persistent")
# A graph of a thousand mismatches is told of by its first.
_MOST: Final = 32
# Attack: a thousand writers and a thousand readers on one topic.
_MAX_PAIRS: Final = 20_000


@dataclass(frozen=True)
class Mismatch:
    """One policy that keeps a pair apart, with each side's value in words. ``option`` is the rule
    for a topic of `uros agent --qos` that makes a board's writer (``offer``) or reader
    (``request``) fit, empty where none does.
    """

    policy: str
    offered: str
    requested: str
    offer: str = ""
    request: str = ""


def mismatches(offered: QoSProfile, requested: QoSProfile) -> list[Mismatch]:
    """Why a writer's samples do not reach a reader of the same topic and type; empty: they do."""
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


def _meet(ones: Sequence[str], others: Sequence[str]) -> bool:
    """Whether two lists of partitions have one in common. Patterns meet names, and no
    pattern, not even the same one; no partition is the partition ''.
    """
    for one in ones or ("",):
        for other in others or ("",):
            if _is_pattern(one) and _is_pattern(other):
                continue
            if fnmatchcase(one, other) or fnmatchcase(other, one):
                return True
    return False


def _is_pattern(partition: str) -> bool:
    return any(it in partition for it in "*?[")


# --- a graph ------------------------------------------------------------------------------------


def check_qos(picture: Picture, domain: int, boards: Collection[str] = ()) -> list[Finding]:
    """All pairs of a domain that do not match. ``boards`` are full names of boards' nodes, which
    `uros agent --qos` can change.
    """
    found: dict[Finding, None] = {}
    pairs = 0
    for topic in picture.topics:
        for writer in picture.writers(topic):
            for reader in picture.readers(topic):
                if writer.type_name != reader.type_name:
                    continue  # which the check of types tells
                if pairs == _MAX_PAIRS:
                    break
                pairs += 1
                for one in mismatches(writer.qos, reader.qos):
                    found[_pair(topic, writer, reader, one, boards)] = None
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
        _mend(topic, sender, receiver, one, boards),
    )


# The argument of rclpy's QoSProfile that stands for a policy, and how its value is written.
_IN_CODE: Final[Mapping[str, str]] = {
    "reliability=reliable": "reliability=ReliabilityPolicy.RELIABLE",
    "reliability=best_effort": "reliability=ReliabilityPolicy.BEST_EFFORT",
    "durability=transient_local": "durability=DurabilityPolicy.TRANSIENT_LOCAL",
    "durability=volatile": "durability=DurabilityPolicy.VOLATILE",
    "liveliness=manual_by_topic": "liveliness=LivelinessPolicy.MANUAL_BY_TOPIC",
    "liveliness=automatic": "liveliness=LivelinessPolicy.AUTOMATIC",
}


def _mend(topic: str, sender: str, receiver: str, one: Mismatch, boards: Collection[str]) -> str:
    if receiver in boards and one.request:
        return f"start the agent with --qos {word(f'{topic}:{one.request}')}"
    if sender in boards and one.offer:
        return f"start the agent with --qos {word(f'{topic}:{one.offer}')}"
    for who, rule, what in (
        (receiver, one.request, "subscription"),
        (sender, one.offer, "publisher"),
    ):
        if rule and who not in boards:
            return f"in {who}, make the {what} of {topic} with {_code(rule)}"
    if one.policy == "partition":
        return f"give {sender} and {receiver} a partition in common, or none, on {topic}"
    return f"make the {one.policy} of {topic} the same in {sender} and {receiver}"


def _code(rule: str) -> str:
    if rule in _IN_CODE:
        return f"QoSProfile({_IN_CODE[rule]}, ...)"
    name, _, value = rule.partition("=")
    argument = {"deadline_ms": "deadline", "liveliness_lease_ms": "liveliness_lease_duration"}
    return f"QoSProfile({argument.get(name, name)}=Duration(nanoseconds={value}000000), ...)"
