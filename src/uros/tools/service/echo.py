"""``uros service echo``: print the requests and responses of a service.

The service or its client publishes them if its introspection is enabled.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..common import add_common, add_service, discover, join
from ..graph_types import only_type, types_of
from ..values.qos_subscribe import add_qos_arguments
from ..values.show_options import add_show_arguments
from ..values.typed_values import load_service
from ..waiting import warn
from .events import PRESET, EventPrinter, event_topic, listen_to_events

if TYPE_CHECKING:
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service echo``."""
    add_service(parser)
    parser.add_argument(
        "type", metavar="TYPE", nargs="?",
        help="type of the service, such as std_srvs/srv/Trigger (default: the service's type)",
    )  # fmt: skip
    add_common(parser)
    add_show_arguments(parser)
    add_qos_arguments(parser, PRESET)


def run(args: argparse.Namespace) -> int:
    """Print events until Ctrl-C.

    Raises:
        ToolError: There is no such service, or it has several types.
    """
    printer = EventPrinter(args)
    try:
        with join(args) as network:
            given = None if args.type is None else load_service(args.type)._TYPE
            discover(network, args)
            type_name = _type(network, args.service, given)
            if not listen_to_events(network, args, args.service, type_name, printer):
                warn(
                    f"nobody publishes {event_topic(args.service)}: is the introspection of the"
                    " client or of the server enabled?"
                )
            network.spin(lambda: False)
    except KeyboardInterrupt:
        pass  # the usual end
    return 0


def _type(network: Network, service: str, given: str | None) -> str:
    """Return the type of the service: the given one, or the only one in the domain."""
    known = network.graph.services()
    if given is not None:
        types = known.get(service)
        if types and given not in types:
            warn(f"{service} has the type {' and '.join(types)}: no event will come")
        return given
    return only_type("service echo", service, types_of(network, "service", service, known))
