"""What the graphs of the domains tell: ends of a topic that are apart, and types that differ."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from .finding import Finding, note, ok, problem, word

if TYPE_CHECKING:
    from ...host.graph import EndpointInfo, Graph

# Topics that every node has an end of, and that lack the other one in a healthy system.
EVERYWHERE: Final = frozenset({"/rosout", "/parameter_events"})
# So many topics are named in one sentence.
_NAMED: Final = 3


def full_name(endpoint: EndpointInfo) -> str:
    """Its node's name, or what it is where that is not known."""
    from ... import names
    from ...host.graph import BARE_DDS, UNKNOWN_NODE

    if (endpoint.node_namespace, endpoint.node_name) == UNKNOWN_NODE:
        return "a node that is not known yet"
    if (endpoint.node_namespace, endpoint.node_name) == BARE_DDS:
        return "a DDS program without ROS"
    return names.join(endpoint.node_namespace, endpoint.node_name)


class Picture:
    """What a graph has been at one moment, without the nodes in ``ours``: asked once, and looked
    at by several checks. ``topics`` has those that others have an end of.
    """

    def __init__(self, graph: Graph, ours: Collection[str] = ()) -> None:
        self.nodes = [it for it in graph.nodes() if it not in ours]
        self.topics: list[str] = []
        self._writers: dict[str, list[EndpointInfo]] = {}
        self._readers: dict[str, list[EndpointInfo]] = {}
        for topic in graph.topics():
            writers = [it for it in graph.publishers(topic) if full_name(it) not in ours]
            readers = [it for it in graph.subscriptions(topic) if full_name(it) not in ours]
            if writers or readers:
                self.topics.append(topic)
                self._writers[topic], self._readers[topic] = writers, readers

    def writers(self, topic: str) -> list[EndpointInfo]:
        return self._writers.get(topic, [])

    def readers(self, topic: str) -> list[EndpointInfo]:
        return self._readers.get(topic, [])

    def ends(self, topic: str) -> list[EndpointInfo]:
        return [*self.writers(topic), *self.readers(topic)]


@dataclass(frozen=True)
class End:
    """Of a topic, in a domain."""

    topic: str
    type_name: str
    node: str
    is_writer: bool


def ends(picture: Picture) -> list[End]:
    """All ends of topics."""
    return [
        End(topic, it.type_name, full_name(it), it.is_publisher)
        for topic in picture.topics
        for it in picture.ends(topic)
    ]


# --- domains ------------------------------------------------------------------------------------


def check_domains(
    found: Mapping[int, Sequence[End]],
    boards: Sequence[tuple[str, int]],
    wanted: Sequence[int],
) -> list[Finding]:
    """Boards, and ends of topics, that are in another domain than those they are for.

    ``found`` are the ends by domain, ``boards`` boards' nodes with their domain, ``wanted`` the
    domains that the user's own nodes are in.
    """
    findings = []
    told: set[int] = set()
    names = {node for node, _ in boards}
    for here in found:
        for there in found:
            if here == there:
                continue
            topics = _apart(found, here, there)
            if topics:
                told |= {here, there}
                findings.append(_apart_finding(found, here, there, topics, names))
    for domain in dict.fromkeys(domain for _, domain in boards):
        if domain in wanted or domain in told:
            continue
        nodes = [node for node, its in boards if its == domain]
        who = (
            f"the boards' nodes {_some(nodes)} are"
            if len(nodes) > 1
            else f"the board's node {nodes[0]} is"
        )
        findings.append(
            problem(
                "domain",
                f"{who} in domain {domain},"
                f" and you look at domain {' and '.join(map(str, wanted))}",
                f"export ROS_DOMAIN_ID={domain} where your ROS 2 nodes start, or start the agent"
                f" with --domain {wanted[0]}",
            )
        )
    if findings:
        return findings
    if boards:
        return [ok("domain", f"all boards are in domain {' and '.join(map(str, _of(boards)))}")]
    where = [it for it in found if found[it]]
    if where:
        return [ok("domain", f"no topic has its ends in different domains (nodes are in domain"
                   f" {' and '.join(map(str, sorted(where)))})")]  # fmt: skip
    looked = " and ".join(map(str, sorted(found)))
    return [
        note(
            "domain",
            f"there is no ROS 2 node in domain {looked}",
            "if your nodes are in domain N: uros doctor --domain N",
        )
    ]


def _of(boards: Sequence[tuple[str, int]]) -> list[int]:
    return sorted({domain for _, domain in boards})


def _apart(found: Mapping[int, Sequence[End]], here: int, there: int) -> list[str]:
    """The topics that have only writers here, and only readers there, of the same type."""
    topics = []
    for topic in dict.fromkeys(it.topic for it in found[here] if it.is_writer):
        if topic in EVERYWHERE:
            continue
        writers = [it for it in found[here] if it.topic == topic]
        readers = [it for it in found[there] if it.topic == topic]
        if (
            readers
            and all(it.is_writer for it in writers)
            and not any(it.is_writer for it in readers)
            and {it.type_name for it in writers} & {it.type_name for it in readers}
        ):
            topics.append(topic)
    return topics


def _apart_finding(
    found: Mapping[int, Sequence[End]], here: int, there: int, topics: list[str], boards: set[str]
) -> Finding:
    senders = _nodes(found[here], topics)
    receivers = _nodes(found[there], topics)
    what = (
        f"{_some(senders)} in domain {here} publishes {_some(topics)}, and {_some(receivers)}"
        f" subscribes to it in domain {there}: they never meet"
    )
    if boards & set(receivers) and not boards & set(senders):
        agent, other, moved = here, there, senders
    else:
        agent, other, moved = there, here, receivers
    mend = f"export ROS_DOMAIN_ID={other} before {_some(moved)} starts"
    if boards & {*senders, *receivers}:
        mend += f", or start the agent with --domain {agent}"
    return problem("domain", what, mend)


def _nodes(some: Sequence[End], topics: Collection[str]) -> list[str]:
    return list(dict.fromkeys(it.node for it in some if it.topic in topics))


def _some(words: Sequence[str]) -> str:
    if len(words) > _NAMED:
        return f"{', '.join(words[:_NAMED])} and {len(words) - _NAMED} more"
    return " and ".join(words)


# --- types --------------------------------------------------------------------------------------


def check_types(picture: Picture, domain: int) -> list[Finding]:
    """Topics whose ends have different types, or one type in different versions."""
    findings = []
    for topic in picture.topics:
        all_ends = picture.ends(topic)
        by_type: dict[str, list[str]] = {}
        for it in all_ends:
            by_type.setdefault(it.type_name, []).append(full_name(it))
        if len(by_type) > 1:
            findings.append(_types_differ(topic, by_type))
            continue
        by_hash: dict[str, list[str]] = {}
        for it in all_ends:
            if it.type_hash.startswith("RIHS"):
                by_hash.setdefault(it.type_hash, []).append(full_name(it))
        if len(by_hash) > 1:
            findings.append(_hashes_differ(topic, all_ends[0].type_name, by_hash))
    if not findings and picture.topics:
        count = len(picture.topics)
        what = "the one topic has" if count == 1 else f"each of the {count} topics has"
        return [ok("types", f"{what} one type everywhere in domain {domain}")]
    return findings


def _types_differ(topic: str, by_type: Mapping[str, list[str]]) -> Finding:
    told = ", and ".join(
        f"{type_name} in {_some(list(dict.fromkeys(nodes)))}"
        for type_name, nodes in by_type.items()
    )
    fewest = min(by_type.values(), key=len)
    other = next(it for it, nodes in by_type.items() if nodes is not fewest)
    new = word(f"{topic}:={topic}_2")
    return problem(
        "types",
        f"{topic} has different types, whose ends do not reach each other: {told}",
        f"use {other} in {fewest[0]} too, or another name there: --ros-args -r {new}"
        f" (a board's: uros agent ... --remap {new})",
    )


def _hashes_differ(topic: str, type_name: str, by_hash: Mapping[str, list[str]]) -> Finding:
    told = ", and ".join(
        f"{it[:15]}... in {_some(list(dict.fromkeys(nodes)))}" for it, nodes in by_hash.items()
    )
    return problem(
        "types",
        f"{type_name} of {topic} is not the same everywhere: {told}",
        f"build all of them with one version of {type_name.partition('/')[0]}; compare:"
        f" ros2 interface show {word(type_name)}",
    )
