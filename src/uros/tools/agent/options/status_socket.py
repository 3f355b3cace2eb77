"""The options of ``uros agent`` about looking into it while it runs."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ....agent.server import Server

DEFAULTS: Final[dict[str, Any]] = {"inspection": True, "metrics": None}


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = common.add_argument_group(
        "what the owner sees", "'uros agent status' shows how a running agent is."
    )
    group.add_argument(
        "--no-inspection", dest="inspection", action="store_false",
        help="have no socket for 'uros agent status', 'uros trace' and 'uros doctor'",
    )  # fmt: skip
    group.add_argument(
        "--metrics", type=_address, metavar="[HOST:]PORT",
        help="serve metrics for Prometheus over HTTP (default host 127.0.0.1; port 0: any that"
        " is free)",
    )  # fmt: skip


def _address(text: str) -> tuple[str, int]:
    host, port = "127.0.0.1", text
    if ":" in text:
        host, _, port = text.rpartition(":")
        host = host[1:-1] if re.fullmatch(r"\[[^\[\]]+\]", host) else host
    if not host or not re.fullmatch(r"[0-9]{1,5}", port) or int(port) > 65535:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no address, such as 9100, 0.0.0.0:9100 or [::1]:9100"
        )
    return host, int(port)


def attach(options: argparse.Namespace, server: Server) -> None:
    """Add to the server what the options ask for. Raises ToolError."""
    if options.inspection:
        from ....agent.observability.status_socket import Inspection

        server.attachments.append(Inspection())
    if options.metrics is not None:
        from ....agent.observability.prometheus import Metrics

        server.attachments.append(Metrics(*options.metrics))
