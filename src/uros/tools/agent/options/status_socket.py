"""The options of ``uros agent`` about its status socket and its metrics."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Final

from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.server import Server


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


OPTIONS: Final = OptionGroup("monitoring", "'uros agent status' shows the state of an agent.")
OPTIONS.add(
    "--no-inspection", dest="inspection", action="store_false",
    help="do not open the socket of 'uros agent status', 'uros trace' and 'uros doctor'",
)  # fmt: skip
OPTIONS.add(
    "--metrics", type=_address, metavar="[HOST:]PORT",
    help="serve metrics for Prometheus over HTTP (default host: 127.0.0.1; port 0: any free one)",
)  # fmt: skip


def attach(options: argparse.Namespace, server: Server) -> None:
    """Attach the status socket and the metrics to the server, as the options say.

    Raises:
        ToolError: The metrics cannot be served.
    """
    if options.inspection:
        from ....agent.observability.status_socket import StatusSocket

        server.attachments.append(StatusSocket())
    if options.metrics is not None:
        from ....agent.observability.prometheus import Metrics

        server.attachments.append(Metrics(*options.metrics))
