"""``uros topic info``: print information about a topic."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..common import add_common, add_topic, discover, join
from ..graph_types import types_of
from ..listing import add_json, print_json, qos_entry
from ..sim_time import add_use_sim_time

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo
    from ...qos import QoSProfile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic info``."""
    add_topic(parser)
    add_common(parser)
    add_use_sim_time(parser, used=False)
    parser.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        help="print the node, type, type hash, GID and QoS profile of each endpoint",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the types and the endpoints of a topic.

    Raises:
        ToolError: There is no such topic.
    """
    with join(args) as network:
        discover(network, args)
        graph = network.graph
        types = types_of(network, "topic", args.topic, graph.topics())
        if args.json:
            print_json(
                {
                    "name": args.topic,
                    "types": types,
                    "publishers": list(map(endpoint_entry, graph.publishers(args.topic))),
                    "subscriptions": list(map(endpoint_entry, graph.subscriptions(args.topic))),
                }
            )
            return 0
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


def endpoint_entry(endpoint: EndpointInfo) -> dict[str, Any]:
    """Return what is known of an endpoint, for JSON."""
    return {
        "node_name": endpoint.node_name,
        "node_namespace": endpoint.node_namespace,
        "type": endpoint.type_name,
        "type_hash": endpoint.type_hash,
        "gid": endpoint.gid.hex("."),
        "qos": qos_entry(endpoint.qos),
    }


def describe(endpoint: EndpointInfo) -> str:
    """Return the lines that ros2 prints about an endpoint."""
    return "\n".join(
        [
            f"Node name: {endpoint.node_name}",
            f"Node namespace: {endpoint.node_namespace}",
            f"Topic type: {endpoint.type_name}",
            f"Topic type hash: {endpoint.type_hash}",
            f"Endpoint type: {'PUBLISHER' if endpoint.is_publisher else 'SUBSCRIPTION'}",
            f"GID: {endpoint.gid.hex('.')}",
            "QoS profile:",
            *describe_qos(endpoint.qos),
        ]
    )


def describe_qos(profile: QoSProfile, indent: str = "  ") -> list[str]:
    """Return the lines that ros2 prints about a profile."""
    qos = qos_entry(profile)
    depth = f" ({qos['depth']})" if qos["history"] == "KEEP_LAST" else ""
    return [
        f"{indent}Reliability: {qos['reliability']}",
        f"{indent}History (Depth): {qos['history']}{depth}",
        f"{indent}Durability: {qos['durability']}",
        f"{indent}Lifespan: {_time(qos['lifespan'])}",
        f"{indent}Deadline: {_time(qos['deadline'])}",
        f"{indent}Liveliness: {qos['liveliness']}",
        f"{indent}Liveliness lease duration: {_time(qos['liveliness_lease_duration'])}",
    ]


def _time(nanoseconds: int | None) -> str:
    return "Infinite" if nanoseconds is None else f"{nanoseconds} nanoseconds"
