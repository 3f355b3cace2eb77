"""The options of ``uros agent`` about the record of refusals."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ...common import positive_int
from ...errors import ToolError
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.server import Server

DEFAULT_SIZE: Final = 10

OPTIONS: Final = OptionGroup("audit", table="audit")
OPTIONS.add(
    "--audit", metavar="FILE",
    help="record in FILE which boards, requests and connections were refused, and by which rule",
)  # fmt: skip
OPTIONS.add(
    "--audit-size", type=positive_int, metavar="MB", default=DEFAULT_SIZE,
    help=f"rename FILE to FILE.1 and begin a new one at this size (default: {DEFAULT_SIZE})",
)  # fmt: skip


def attach(options: argparse.Namespace, server: Server) -> None:
    """Attach the record of refusals to the server, if ``--audit`` is given.

    Raises:
        ToolError: The file cannot be used.
    """
    if options.audit is None:
        return
    from ....agent.observability.audit import AuditError, AuditTrail

    try:
        server.attachments.append(AuditTrail(options.audit, options.audit_size * 1_000_000))
    except AuditError as error:
        raise ToolError(str(error)) from error
