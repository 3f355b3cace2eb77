"""``uros service call``: call a service.

Requests go over RTPS, in the form that the server uses. ``-m dds`` and ``-m ros2`` show what
Cyclone DDS and rclpy do.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from ...names import service_type_from_dds
from ..common import add_common, add_service, join, positive_float, remedy
from ..errors import ToolError
from ..values.fill import Filled, constructed
from ..values.typed_values import add_type_and_values, load_service, type_and_text
from ..waiting import warn

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo
    from ...host.network import Network
    from ...middleware.base import Middleware, Requester, Service

# How long the discovery of a service takes at most, in seconds.
_DISCOVERY: Final = 1.5
# Where the middleware does not know which servers match: a server may discover us later than we
# discover it, and then misses the request.
_SETTLE: Final = 0.15
_POLL: Final = 0.01
_PATIENCE: Final = 5.0


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
        servers = _find(network, args)
        there = sorted({service_type_from_dds(server.type_name) for server in servers})
        if kind is None:
            if len(there) > 1:
                raise ToolError(
                    f"{args.service} has several types: {', '.join(there)}; give one:"
                    f" uros service call {args.service} TYPE"
                )
            kind = load_service(there[0])
        wanted = kind.Request._TYPE.rpartition("_")[0]
        if wanted not in there:
            raise ToolError(f"{args.service} is {' and '.join(there)}, not {wanted}")
        filled = filled or Filled(kind.Request, text)
        filled.stamp(time.time_ns())
        client = _open(network, args, kind)
        try:
            _call(client, args, kind.Response, filled)
        finally:
            client.close()
    return 0


def _find(network: Network, args: argparse.Namespace) -> list[EndpointInfo]:
    """Wait for the servers of the service."""
    graph = network.graph
    longest = args.timeout
    soon = _DISCOVERY if longest is None else min(_DISCOVERY, longest)
    if not network.spin(lambda: bool(graph.servers(args.service)), soon):
        known = [name for name in graph.services() if name != args.service]
        warn(
            f"waiting for service {args.service} to become available;"
            f" there is none{remedy(network, args.service, known)}"
        )
        left = None if longest is None else longest - soon
        if not network.spin(lambda: bool(graph.servers(args.service)), left):
            raise ToolError(
                f"there was no service {args.service} within {longest:g} s"
                f"{remedy(network, args.service, known)}"
            )
    return graph.servers(args.service)


# --- the client -------------------------------------------------------------------------------


class _Client:
    """A client of the service, and the loop that serves it.

    ``middleware`` is the requester's own one, if it does not use the network's.
    """

    def __init__(self, network: Network, service: str) -> None:
        self.requester: Requester | None = None
        self.middleware: Middleware | None = None
        self._network = network
        self._service = service

    def wait(self, done: Callable[[], bool], seconds: float | None) -> bool:
        """Serve the network until ``done()``. Return False if the time is over before."""
        other = self.middleware
        if other is None:
            return self._network.spin(done, seconds)
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            other.dispatch()
            other.tick()
            if done():
                return True
            if end is not None and time.monotonic() >= end:
                return False
            self._network.spin(lambda: False, _POLL)

    def is_served(self) -> bool:
        return bool(self._network.graph.servers(self._service))

    def close(self) -> None:
        if self.requester is not None:
            self.requester.close()
        if self.middleware is not None:
            self.middleware.close()


def _open(network: Network, args: argparse.Namespace, kind: Any) -> _Client:
    """Create the client, and wait until the server has matched it."""
    from ...middleware.base import Service
    from ...qos import services_profile

    service = Service(
        f"rq{args.service}Request", kind.Request._DDS_TYPE,
        f"rr{args.service}Reply", kind.Response._DDS_TYPE,
    )  # fmt: skip
    client = _Client(network, args.service)
    if args.middleware == "ros2":
        _open_ros2(client, network, args, service)
        return client
    client.requester = requester = network.node.create_requester(
        service, services_profile(), _nothing
    )
    if requester.servers() is None:
        client.wait(lambda: False, _SETTLE)
    elif not client.wait(lambda: bool(requester.servers()), args.timeout):
        raise ToolError(
            f"a server of {args.service} was found, but did not match within {args.timeout:g} s"
        )
    return client


def _open_ros2(
    client: _Client, network: Network, args: argparse.Namespace, service: Service
) -> None:
    from ...middleware import open_middleware
    from ...middleware.base import MiddlewareError
    from ...qos import services_profile

    try:
        client.middleware = open_middleware("ros2")
        node = client.middleware.create_node(network.domain, "/", f"_uros_asks_{os.getpid()}")
        requester: Any = node.create_requester(service, services_profile(), _nothing)
    except MiddlewareError as error:
        client.close()
        raise ToolError(f"-m ros2 needs rclpy: {error}") from error
    client.requester = requester
    if not client.wait(requester.entity.service_server_is_available, args.timeout):
        raise ToolError(f"rclpy did not find {args.service} within {args.timeout:g} s")
    client.wait(lambda: False, _SETTLE)


def _nothing() -> None:
    """Ignore the event: the loop takes replies after each one."""


# --- calling ----------------------------------------------------------------------------------


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _call(client: _Client, args: argparse.Namespace, response: Any, filled: Filled) -> None:
    from ...interfaces.codec import from_cdr, to_cdr

    requester = client.requester
    assert requester is not None, "opened"
    request = to_cdr(filled.message)
    while True:
        _say(f"requester: making request: {constructed(filled.message)}\n")
        started = time.monotonic()
        number = requester.request(request)
        while number is None:
            client.wait(lambda: False, _POLL)
            number = requester.request(request)
        answer = from_cdr(response, _answer(client, requester, number, args))
        _say(f"response:\n{constructed(answer)}\n")
        if args.rate is None:
            return
        left = started + 1.0 / args.rate - time.monotonic()
        if left > 0.0:
            client.wait(lambda: False, left)


def _answer(client: _Client, requester: Requester, number: int, args: argparse.Namespace) -> bytes:
    """Wait for the reply to a request."""
    answers: dict[int, bytes] = {}

    def came() -> bool:
        answers.update(requester.take(16))
        return number in answers or bool(requester.refusal()) or not client.is_served()

    patience = _PATIENCE if args.timeout is None else min(_PATIENCE, args.timeout)
    if not client.wait(came, patience):
        if args.timeout is None:
            warn(f"{args.service} has not answered for {patience:g} s; still waiting")
        left = None if args.timeout is None else args.timeout - patience
        if not client.wait(came, left):
            raise ToolError(
                f"{args.service} did not answer within {args.timeout:g} s; is its node busy, or"
                " not spinning?"
            )
    if number not in answers and (why := requester.refusal()):
        raise ToolError(why)
    if number not in answers:
        raise ToolError(f"{args.service} ended before it answered; call it again")
    return answers[number]
