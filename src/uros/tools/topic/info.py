"""``uros topic info``: print information about a topic."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..common import add_common, add_topic, discover, join, remedy
from ..errors import ToolError

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic info``."""
    add_topic(parser)
    add_common(parser)
    parser.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="print the node, type, type hash, GID and QoS profile of each endpoint",
    )


def run(args: argparse.Namespace) -> int:
    """Print the types and the endpoints of a topic.

    Raises:
        ToolError: There is no such topic.
    """
    with join(args) as network:
        discover(network, args)
        graph = network.graph
        topics = graph.topics()
        types = topics.get(args.topic)
        if types is None:
            raise ToolError(
                f"there is no topic {args.topic!r}{remedy(network, args.topic, topics)}"
            )
        end = "\n\n" if args.verbose else "\n"
        print("Type:", types[0] if len(types) == 1 else types, end=end)
        for what, endpoints in (
            ("Publisher", graph.publishers(args.topic)),
            ("Subscription", graph.subscriptions(args.topic)),
        ):
            print(f"{what} count: {len(endpoints)}", end=end)
            if args.verbose:
                for endpoint in endpoints:
                    print(describe(endpoint), end=end)
    return 0


def describe(endpoint: EndpointInfo) -> str:
    """Return the lines that ros2 prints about an endpoint."""
    from ...qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy

    qos = endpoint.qos
    history = {
        HistoryPolicy.KEEP_LAST: f"KEEP_LAST ({qos.depth})",
        HistoryPolicy.KEEP_ALL: "KEEP_ALL",
    }
    reliability = {
        ReliabilityPolicy.RELIABLE: "RELIABLE",
        ReliabilityPolicy.BEST_EFFORT: "BEST_EFFORT",
    }
    durability = {
        DurabilityPolicy.TRANSIENT_LOCAL: "TRANSIENT_LOCAL",
        DurabilityPolicy.VOLATILE: "VOLATILE",
    }
    liveliness = {
        LivelinessPolicy.AUTOMATIC: "AUTOMATIC",
        LivelinessPolicy.MANUAL_BY_TOPIC: "MANUAL_BY_TOPIC",
    }
    return "\n".join(
        [
            f"Node name: {endpoint.node_name}",
            f"Node namespace: {endpoint.node_namespace}",
            f"Topic type: {endpoint.type_name}",
            f"Topic type hash: {endpoint.type_hash}",
            f"Endpoint type: {'PUBLISHER' if endpoint.is_publisher else 'SUBSCRIPTION'}",
            f"GID: {endpoint.gid.hex('.')}",
            "QoS profile:",
            f"  Reliability: {reliability.get(qos.reliability, 'UNKNOWN')}",
            f"  History (Depth): {history.get(qos.history, 'UNKNOWN')}",
            f"  Durability: {durability.get(qos.durability, 'UNKNOWN')}",
            f"  Lifespan: {_time(qos.lifespan_ms)}",
            f"  Deadline: {_time(qos.deadline_ms)}",
            f"  Liveliness: {liveliness.get(qos.liveliness, 'UNKNOWN')}",
            f"  Liveliness lease duration: {_time(qos.liveliness_lease_ms)}",
        ]
    )


def _time(milliseconds: int | None) -> str:
    return "Infinite" if milliseconds is None else f"{milliseconds * 1_000_000} nanoseconds"
