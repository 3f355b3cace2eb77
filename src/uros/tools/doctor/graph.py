"""Checks the ROS graph: names, domains and types of nodes and topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from .finding import Finding, note, ok, problem, word

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo, Graph

# Topics of every node. In a healthy system many have publishers but no subscription.
EVERYWHERE: Final = frozenset({"/rosout", "/parameter_events"})
# How many names one sentence lists.
_NAMED: Final = 3


def full_name(endpoint: EndpointInfo) -> str:
    """Return the full name of an endpoint's node, or a description if it is not known."""
    from ... import names
    from ...host.graph_queries import BARE_DDS, UNKNOWN_NODE

    if (endpoint.node_namespace, endpoint.node_name) == UNKNOWN_NODE:
        return "a node that is not known yet"
    if (endpoint.node_namespace, endpoint.node_name) == BARE_DDS:
        return "a DDS program without ROS"
    return names.join(endpoint.node_namespace, endpoint.node_name)


class Picture:
    """A graph at one moment, for several checks.

    Args:
        graph: The graph.
        ours: Full names of nodes to leave out.

    Attributes:
        nodes: Full names of the nodes. A name of two nodes stands twice.
        topics: The topics that have an endpoint.
    """

    def __init__(self, graph: Graph, ours: Collection[str] = ()) -> None:
        self.nodes = [node for node in graph.nodes() if node not in ours]
        self.topics: list[str] = []
        self._writers: dict[str, list[EndpointInfo]] = {}
        self._readers: dict[str, list[EndpointInfo]] = {}
        for topic in graph.topics():
            writers = [end for end in graph.publishers(topic) if full_name(end) not in ours]
            readers = [end for end in graph.subscriptions(topic) if full_name(end) not in ours]
            if writers or readers:
                self.topics.append(topic)
                self._writers[topic], self._readers[topic] = writers, readers

    def writers(self, topic: str) -> list[EndpointInfo]:
        """Return the publishers of a topic."""
        return self._writers.get(topic, [])

    def readers(self, topic: str) -> list[EndpointInfo]:
        """Return the subscriptions of a topic."""
        return self._readers.get(topic, [])

    def ends(self, topic: str) -> list[EndpointInfo]:
        """Return the publishers, then the subscriptions of a topic."""
        return [*self.writers(topic), *self.readers(topic)]


@dataclass(frozen=True)
class End:
    """A publisher or subscription of a topic, without its QoS."""

    topic: str
    type_name: str
    node: str
    is_writer: bool


def ends(picture: Picture) -> list[End]:
    """Return the endpoints of all topics."""
    return [
        End(topic, end.type_name, full_name(end), end.is_publisher)
        for topic in picture.topics
        for end in picture.ends(topic)
    ]


# --- names ------------------------------------------------------------------------------------


def check_names(picture: Picture, domain: int) -> list[Finding]:
    """Find nodes of one domain that have the same name."""
    counts = Counter(picture.nodes)
    return [
        note(
            "node name",
            f"{count} nodes in domain {domain} have the name {name}: what is sent to one, such as"
            " a parameter request, may reach the other",
            "give one of them another name: --ros-args -r __node:=NAME; of a board, in its program",
            about=name,
        )
        for name, count in counts.items()
        if count > 1
    ]


# --- domains ------------------------------------------------------------------------------------


def check_domains(
    found: Mapping[int, Sequence[End]],
    boards: Sequence[tuple[str, int]],
    wanted: Sequence[int],
    agents: Mapping[int, Collection[int]] | None = None,
) -> list[Finding]:
    """Find boards and endpoints that are in another domain than their peers.

    Args:
        found: The endpoints by domain.
        boards: The boards' nodes, each with its domain.
        wanted: The domains of the user's own nodes.
        agents: The domains of the boards of each agent, by process id. With several agents a
            domain may be that of other people: boards in it are then a note, not a problem.
    """
    several = agents if agents and len(agents) > 1 else {}
    findings: list[Finding] = []
    reported: set[int] = set()
    names = {node for node, _ in boards}
    for publishing in found:
        for subscribing in found:
            if publishing == subscribing:
                continue
            topics = _apart(found, publishing, subscribing)
            if topics:
                reported |= {publishing, subscribing}
                finding = _apart_finding(found, publishing, subscribing, topics, names)
                if several and not {publishing, subscribing} & set(wanted):
                    finding = note(finding.check, finding.what, finding.fix)
                findings.append(finding)
    for domain in dict.fromkeys(domain for _, domain in boards):
        if domain in wanted or domain in reported:
            continue
        nodes = [node for node, board_domain in boards if board_domain == domain]
        subject = (
            f"the boards' nodes {_some(nodes)} are"
            if len(nodes) > 1
            else f"the board's node {nodes[0]} is"
        )
        what = (
            f"{subject} in domain {domain}, and you look at domain {' and '.join(map(str, wanted))}"
        )
        fix = (
            f"export ROS_DOMAIN_ID={domain} where your ROS 2 nodes start, or start the agent with"
            f" --domain {wanted[0]}"
        )
        if several:
            pids = [str(pid) for pid, domains in several.items() if domain in domains]
            who = f"agent {' and '.join(pids)}"
            findings.append(
                note(
                    "domain",
                    f"{what} ({who})",
                    f"nothing to do if {who} is somebody else's; to check yours alone: uros doctor"
                    f" --agent PID; else: {fix}",
                )
            )
        else:
            findings.append(problem("domain", what, fix))
    if findings:
        return findings
    if boards:
        return [ok("domain", f"all boards are in domain {' and '.join(map(str, _of(boards)))}")]
    where = [domain for domain in found if found[domain]]
    if where:
        return [ok("domain", f"no topic has its ends in different domains (nodes are in domain"
                   f" {' and '.join(map(str, sorted(where)))})")]  # fmt: skip
    looked = " or ".join(map(str, sorted(found)))
    return [
        note(
            "domain",
            f"there is no ROS 2 node in domain {looked}",
            "if your nodes are in domain N: uros doctor --domain N",
        )
    ]


def _of(boards: Sequence[tuple[str, int]]) -> list[int]:
    return sorted({domain for _, domain in boards})


def _apart(found: Mapping[int, Sequence[End]], publishing: int, subscribing: int) -> list[str]:
    """Return the topics with only publishers in one domain, only subscriptions in the other.

    The endpoints must have a type in common.
    """
    topics = []
    for topic in dict.fromkeys(end.topic for end in found[publishing] if end.is_writer):
        if topic in EVERYWHERE:
            continue
        writers = [end for end in found[publishing] if end.topic == topic]
        readers = [end for end in found[subscribing] if end.topic == topic]
        if (
            readers
            and all(end.is_writer for end in writers)
            and not any(end.is_writer for end in readers)
            and {end.type_name for end in writers} & {end.type_name for end in readers}
        ):
            topics.append(topic)
    return topics


def _apart_finding(
    found: Mapping[int, Sequence[End]],
    publishing: int,
    subscribing: int,
    topics: list[str],
    boards: set[str],
) -> Finding:
    senders = _nodes(found[publishing], topics)
    receivers = _nodes(found[subscribing], topics)
    what = (
        f"{_some(senders)} in domain {publishing} publishes {_some(topics)}, and {_some(receivers)}"
        f" subscribes to it in domain {subscribing}: they never meet"
    )
    if boards & set(receivers) and not boards & set(senders):
        agent, peer, moved = publishing, subscribing, senders
    else:
        agent, peer, moved = subscribing, publishing, receivers
    fix = f"export ROS_DOMAIN_ID={peer} before {_some(moved)} starts"
    if boards & {*senders, *receivers}:
        fix += f", or start the agent with --domain {agent}"
    return problem("domain", what, fix)


def _nodes(some: Sequence[End], topics: Collection[str]) -> list[str]:
    return list(dict.fromkeys(end.node for end in some if end.topic in topics))


def _some(words: Sequence[str]) -> str:
    if len(words) > _NAMED:
        return f"{', '.join(words[:_NAMED])} and {len(words) - _NAMED} more"
    return " and ".join(words)


# --- types --------------------------------------------------------------------------------------


def check_types(picture: Picture, domain: int) -> list[Finding]:
    """Find topics whose endpoints have different types, or different versions of a type."""
    findings = []
    for topic in picture.topics:
        all_ends = picture.ends(topic)
        by_type: dict[str, list[str]] = {}
        for end in all_ends:
            by_type.setdefault(end.type_name, []).append(full_name(end))
        if len(by_type) > 1:
            findings.append(_types_differ(topic, by_type))
            continue
        by_hash: dict[str, list[str]] = {}
        for end in all_ends:
            if end.type_hash.startswith("RIHS"):
                by_hash.setdefault(end.type_hash, []).append(full_name(end))
        if len(by_hash) > 1:
            findings.append(_hashes_differ(topic, all_ends[0].type_name, by_hash))
    if not findings and picture.topics:
        count = len(picture.topics)
        what = "the one topic has" if count == 1 else f"each of the {count} topics has"
        return [ok("types", f"{what} one type everywhere in domain {domain}")]
    return findings


def _types_differ(topic: str, by_type: Mapping[str, list[str]]) -> Finding:
    places = ", and ".join(
        f"{type_name} in {_some(list(dict.fromkeys(nodes)))}"
        for type_name, nodes in by_type.items()
    )
    fewest = min(by_type.values(), key=len)
    common = next(type_name for type_name, nodes in by_type.items() if nodes is not fewest)
    new = word(f"{topic}:={topic}_2")
    return problem(
        "types",
        f"{topic} has different types, so its endpoints do not match: {places}",
        f"use {common} in {fewest[0]} too, or another name there: --ros-args -r {new}"
        f" (a board's: uros agent ... --remap {new})",
        about=topic,
        kind=" ".join(by_type),
    )


def _hashes_differ(topic: str, type_name: str, by_hash: Mapping[str, list[str]]) -> Finding:
    places = ", and ".join(
        f"{type_hash[:15]}... in {_some(list(dict.fromkeys(nodes)))}"
        for type_hash, nodes in by_hash.items()
    )
    return problem(
        "types",
        f"{type_name} of {topic} is not the same everywhere: {places}",
        f"build all of them with one version of {type_name.partition('/')[0]}; compare:"
        f" ros2 interface show {word(type_name)}",
        about=topic,
        kind=type_name,
    )
