"""``uros service call``: call a service.

Requests go over RTPS, in the form that the server uses. ``-m dds`` and ``-m ros2`` show what
Cyclone DDS and rclpy do.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib.util import find_spec

from ...names import service_type_from_dds
from ..common import add_common, add_service, join, positive_float
from ..errors import ToolError
from ..graph_types import only_type
from ..values.fill import Filled
from ..values.plain import constructed
from ..values.qos_publish import add_qos_arguments, choose
from ..values.typed_values import add_type_and_values, load_service, type_and_text
from .client import RclpyClient, ServiceClient, find_servers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service call``."""
    add_service(parser)
    add_type_and_values(parser, "std_srvs/srv/Trigger", "service")
    add_common(parser)
    parser.add_argument(
        "-r", "--rate", metavar="N", type=positive_float,
        help="repeat the call, at most N times a second",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", metavar="S", type=positive_float,
        help="seconds to wait for the service, and for each response; exit status 1 if it does not"
        " come (default: no limit)",
    )  # fmt: skip
    parser.add_argument(
        "-m", "--middleware", choices=("auto", "dds", "rtps", "ros2"), default="auto",
        help="auto, rtps (default): RTPS in the form that the server uses; dds: Cyclone DDS, for"
        " servers with rmw_cyclonedds; ros2: rclpy",
    )  # fmt: skip
    add_qos_arguments(parser, "services_default")


def run(args: argparse.Namespace) -> int:
    """Call a service and print its response.

    Raises:
        ToolError: The service is missing, has another type, or did not answer in time.
    """
    type_name, text = type_and_text(args)
    if args.middleware == "ros2" and not find_spec("rclpy"):
        raise ToolError(
            "-m ros2 needs rclpy, which this Python does not have: run uros where ROS 2 is sourced,"
            " or leave -m out"
        )
    with join(args, "dds" if args.middleware == "dds" else "auto") as network:
        kind = load_service(type_name) if type_name else None
        filled = Filled(kind.Request, text) if kind else None
        servers = find_servers(network, args.service, args.timeout)
        there = sorted({service_type_from_dds(server.type_name) for server in servers})
        if kind is None:
            kind = load_service(only_type("service call", args.service, there))
        wanted = kind.Request._TYPE.rpartition("_")[0]
        if wanted not in there:
            raise ToolError(f"{args.service} is {' and '.join(there)}, not {wanted}")
        filled = filled or Filled(kind.Request, text)
        filled.stamp(time.time_ns())
        client = (RclpyClient if args.middleware == "ros2" else ServiceClient)(
            network, args.service, kind, choose(args)
        )
        try:
            client.match(args.timeout)
            _call(client, args, filled)
        finally:
            client.close()
    return 0


def _call(client: ServiceClient, args: argparse.Namespace, filled: Filled) -> None:
    while True:
        _say(f"requester: making request: {constructed(filled.message)}\n")
        started = time.monotonic()
        answer = client.answer(client.request(filled.message), args.timeout)
        _say(f"response:\n{constructed(answer)}\n")
        if args.rate is None:
            return
        left = started + 1.0 / args.rate - time.monotonic()
        if left > 0.0:
            client.wait(lambda: False, left)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
