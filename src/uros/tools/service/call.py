"""``uros service call``

There are two forms in which requests travel. rmw_cyclonedds's is spoken by boards on an agent
without rclpy, by nodes of uros, and by us; rmw_fastrtps's, and any other, by rclpy alone. A server
that has the first says so where it is discovered, so the form is chosen when it is there.
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
    from ...host.graph import EndpointInfo
    from ...host.network import Network
    from ...middleware.base import Middleware, Requester, Service

# How long a service that is there takes to be discovered, at most.
_DISCOVERY: Final = 1.5
# A server may know us later than we know it, and then misses the request.
_SETTLE: Final = 0.15
_POLL: Final = 0.01
_PATIENCE: Final = 5.0
_CYCLONE_FORM: Final = b"serviceid="


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_service(parser)
    add_type_and_values(parser, "std_srvs/srv/Trigger", "service")
    add_common(parser)
    parser.add_argument(
        "-r", "--rate", metavar="N", type=positive_float,
        help="call again and again, N times a second at most",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", metavar="S", type=positive_float,
        help="wait so long at most for the service, and for each answer; exit status 1 if it did"
        " not come (default: for ever)",
    )  # fmt: skip
    parser.add_argument(
        "-m", "--middleware", choices=("auto", "dds", "ros2"), default="auto",
        help="dds: the form of rmw_cyclonedds and of boards on an agent without rclpy; ros2: by"
        " rclpy, which has that of rmw_fastrtps; auto (default): what the server has",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    type_name, text = type_and_text(args)
    if args.middleware == "ros2" and not find_spec("rclpy"):
        raise ToolError(
            "-m ros2 calls by rclpy, which this Python does not have: start uros where ROS 2 is"
            " sourced, or leave -m out"
        )
    with join(args) as network:  # which makes --interfaces known
        kind = load_service(type_name) if type_name else None
        filled = Filled(kind.Request, text) if kind else None
        servers = _find(network, args)
        there = sorted({service_type_from_dds(server.type_name) for server in servers})
        if kind is None:
            if len(there) > 1:
                raise ToolError(
                    f"{args.service} has more than one type: {', '.join(there)}; say which"
                )
            kind = load_service(there[0])
        wanted = kind.Request._TYPE.rpartition("_")[0]
        if wanted not in there:
            raise ToolError(f"{args.service} is {' and '.join(there)}, not {wanted}")
        filled = filled or Filled(kind.Request, text)
        filled.stamp(time.time_ns())
        line = _open(network, args, kind, servers)
        try:
            _call(line, args, kind.Response, filled)
        finally:
            line.close()
    return 0


def _find(network: Network, args: argparse.Namespace) -> list[EndpointInfo]:
    """The servers, waited for."""
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


# --- the line to the server -------------------------------------------------------------------


class _Line:
    """One client of the service, and the loop that serves it.

    ``middleware`` is the requester's where that is not the network's own.
    """

    def __init__(self, network: Network, service: str) -> None:
        self.requester: Requester | None = None
        self.middleware: Middleware | None = None
        self._network = network
        self._service = service

    def wait(self, done: Callable[[], bool], seconds: float | None) -> bool:
        """Serve the network until ``done()``; False: so much time went by before."""
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


def _open(
    network: Network, args: argparse.Namespace, kind: Any, servers: list[EndpointInfo]
) -> _Line:
    from ...middleware.base import Service
    from ...qos import services_profile

    form = args.middleware
    if form == "auto":
        ours = any(_CYCLONE_FORM in server.qos.user_data for server in servers)
        form = "dds" if ours else "ros2"
    service = Service(
        f"rq{args.service}Request", kind.Request._DDS_TYPE,
        f"rr{args.service}Reply", kind.Response._DDS_TYPE,
    )  # fmt: skip
    line = _Line(network, args.service)
    if form == "dds":
        line.requester = network.node.create_requester(service, services_profile(), _nothing)
        line.wait(lambda: False, _SETTLE)
    else:
        _open_ros2(line, network, args, service)
    return line


def _open_ros2(line: _Line, network: Network, args: argparse.Namespace, service: Service) -> None:
    from ...middleware import open_middleware
    from ...middleware.base import MiddlewareError
    from ...qos import services_profile

    try:
        line.middleware = open_middleware("ros2")
        node = line.middleware.create_node(network.domain, "/", f"_uros_asks_{os.getpid()}")
        requester: Any = node.create_requester(service, services_profile(), _nothing)
    except MiddlewareError as error:
        line.close()
        if args.middleware == "ros2":
            raise ToolError(f"-m ros2 calls by rclpy: {error}") from error
        raise ToolError(
            f"{args.service} is served in the form of rmw_fastrtps, which rclpy alone speaks:"
            f" {error}"
        ) from error
    line.requester = requester
    if not line.wait(requester.entity.service_server_is_available, args.timeout):
        raise ToolError(f"rclpy did not find {args.service} within {args.timeout:g} s")
    line.wait(lambda: False, _SETTLE)


def _nothing() -> None:
    """Replies are asked for after each event."""


# --- calling ----------------------------------------------------------------------------------


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _call(line: _Line, args: argparse.Namespace, response: Any, filled: Filled) -> None:
    from ...interfaces.codec import from_cdr, to_cdr

    requester = line.requester
    assert requester is not None, "opened"
    request = to_cdr(filled.message)
    while True:
        _say(f"requester: making request: {constructed(filled.message)}\n")
        started = time.monotonic()
        number = requester.request(request)
        while number is None:
            line.wait(lambda: False, _POLL)
            number = requester.request(request)
        answer = from_cdr(response, _answer(line, requester, number, args))
        _say(f"response:\n{constructed(answer)}\n")
        if args.rate is None:
            return
        left = started + 1.0 / args.rate - time.monotonic()
        if left > 0.0:
            line.wait(lambda: False, left)


def _answer(line: _Line, requester: Requester, number: int, args: argparse.Namespace) -> bytes:
    """The reply to the request of that number."""
    answers: dict[int, bytes] = {}

    def came() -> bool:
        answers.update(requester.take(16))
        return number in answers or bool(requester.refusal()) or not line.is_served()

    patience = _PATIENCE if args.timeout is None else min(_PATIENCE, args.timeout)
    if not line.wait(came, patience):
        if args.timeout is None:
            warn(f"{args.service} has not answered for {patience:g} s; waiting on")
        left = None if args.timeout is None else args.timeout - patience
        if not line.wait(came, left):
            raise ToolError(
                f"{args.service} did not answer within {args.timeout:g} s; is its node busy, or"
                " does it spin at all?"
            )
    if number not in answers and (why := requester.refusal()):
        raise ToolError(why)
    if number not in answers:
        raise ToolError(f"{args.service} has left and has not answered; call it again")
    return answers[number]
