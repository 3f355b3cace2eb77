"""The options of ``uros agent`` about its status socket, its metrics and its diagnostics."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Final

from ....names import is_valid
from ...common import positive_float
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.server import Server

# The periods of --diagnostics in seconds: a shorter one takes the boards' time, and tools have
# forgotten a status long before a longer one.
MIN_PERIOD: Final = 0.1
MAX_PERIOD: Final = 3600.0


def _address(text: str) -> tuple[str, int]:
    host, port = "127.0.0.1", text
    if ":" in text:
        host, _, port = text.rpartition(":")
        host = host[1:-1] if re.fullmatch(r"\[[^\[\]]+\]", host) else host
    if not host or not re.fullmatch(r"[0-9]{1,5}", port) or int(port) > 65535:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not an address, such as 9100, 0.0.0.0:9100 or [::1]:9100"
        )
    return host, int(port)


def _period(text: str) -> float:
    period = positive_float(text)
    if not MIN_PERIOD <= period <= MAX_PERIOD:
        raise argparse.ArgumentTypeError(
            f"{text} is not a period from {MIN_PERIOD:g} to {MAX_PERIOD:g} seconds"
        )
    return period


def _node(text: str) -> str:
    if "/" in text or not is_valid(f"/{text}"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a node's name, such as uros_agent_arm")
    return text


OPTIONS: Final = OptionGroup(
    "monitoring", "'uros agent status' shows the state of an agent.", table="monitoring"
)
OPTIONS.add(
    "--no-inspection", dest="inspection", action="store_false",
    help="do not open the socket of 'uros agent status', 'uros trace' and 'uros doctor'",
)  # fmt: skip
OPTIONS.add(
    "--metrics", type=_address, metavar="[HOST:]PORT",
    help="serve metrics for Prometheus over HTTP (default host: 127.0.0.1; port 0: any free one)",
)  # fmt: skip
OPTIONS.add(
    "--diagnostics", nargs="?", const=1.0, type=_period, metavar="SECONDS",
    help="publish the state of the agent and of its boards on /diagnostics, each at this period"
    " (default: 1)",
)  # fmt: skip
OPTIONS.add(
    "--diagnostics-node", type=_node, metavar="NAME", default="uros_agent",
    help="name of the agent's node that publishes them, and the beginning of their names, which"
    " differ from agent to agent on a network (default: uros_agent)",
)  # fmt: skip


def attach(options: argparse.Namespace, server: Server) -> None:
    """Attach the status socket, the metrics and the diagnostics to the server, as options say.

    Raises:
        ToolError: The metrics cannot be served.
    """
    if options.inspection:
        from ....agent.observability.status_socket import StatusSocket

        server.attachments.append(StatusSocket())
    if options.metrics is not None:
        from ....agent.observability.prometheus import Metrics

        server.attachments.append(Metrics(*options.metrics))
    if options.diagnostics is not None:
        from ....agent.observability.diagnostics import Diagnostics

        agent = server.agent
        domain = agent.domain_of_agent if agent.domain_override is None else agent.domain_override
        server.attachments.append(
            Diagnostics(domain, options.diagnostics, options.diagnostics_node)
        )
