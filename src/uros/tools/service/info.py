"""``uros service info``: print information about a service."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..common import add_common, add_service, discover, join
from ..graph_types import types_of
from ..listing import add_json, print_json
from ..topic.info import describe_qos, endpoint_entry

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service info``."""
    add_service(parser)
    add_common(parser)
    parser.add_argument(
        "-v", "--verbose", action="store_true",
        help="print the node, type, type hash, GIDs and QoS profiles of each client and server",
    )  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the type of a service, its clients and its servers.

    Raises:
        ToolError: There is no such service.
    """
    with join(args) as network:
        discover(network, args)
        graph = network.graph
        types = types_of(network, "service", args.service, graph.services())
        if args.json:
            print_json(
                {
                    "name": args.service,
                    "types": types,
                    "clients": _entries(graph.service_endpoints(args.service, True)),
                    "servers": _entries(graph.service_endpoints(args.service, False)),
                }
            )
            return 0
        end = "\n\n" if args.verbose else "\n"
        print("Type:", types[0] if len(types) == 1 else types)
        for what, of_clients in (("Clients", True), ("Services", False)):
            pairs = graph.service_endpoints(args.service, of_clients)
            print(f"{what} count: {len(pairs)}", end=end)
            if args.verbose:
                for request, reply in pairs:
                    print(describe(request, reply), end=end)
    return 0


def _entries(pairs: list[tuple[EndpointInfo, EndpointInfo]]) -> list[dict[str, Any]]:
    return [
        {"request": endpoint_entry(request), "response": endpoint_entry(reply)}
        for request, reply in pairs
    ]


def describe(request: EndpointInfo, reply: EndpointInfo) -> str:
    """Return the lines that ros2 prints about a client or a server."""
    is_client = request.is_publisher
    names = (
        ("Request Writer", "Response Reader")
        if is_client
        else ("Request Reader", "Response Writer")
    )
    type_name = request.type_name.removesuffix("_Request")
    lines = [
        f"Node name: {request.node_name}",
        f"Node namespace: {request.node_namespace}",
        f"Service type: {type_name}",
        f"Service type hash: {_service_hash(type_name, request.type_hash)}",
        f"Endpoint type: {'CLIENT' if is_client else 'SERVER'}",
        "Endpoint count: 2",
        "GIDs:",
    ]
    endpoints = list(zip(names, (request, reply), strict=True))
    lines += [f" - {name} : {endpoint.gid.hex('.')}" for name, endpoint in endpoints]
    lines.append("QoS profiles:")
    for name, endpoint in endpoints:
        lines += [f" - {name} :", *describe_qos(endpoint.qos, "      ")]
    return "\n".join(lines)


def _service_hash(type_name: str, request_hash: str) -> str:
    """Return the hash of the known definition, if the request's announced hash is of it too."""
    from ...host.graph_queries import NO_HASH
    from ...interfaces import known_hash

    if request_hash == NO_HASH or known_hash(f"{type_name}_Request") != request_hash:
        return NO_HASH
    return known_hash(type_name) or NO_HASH
