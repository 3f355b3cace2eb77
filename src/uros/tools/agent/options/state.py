"""The option of ``uros agent`` about restarts."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ...errors import ToolError

if TYPE_CHECKING:
    from ....agent.log import Log
    from ....agent.persistence.session_store import Keeper

DEFAULTS: Final[dict[str, Any]] = {"state": None}


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare it."""
    group = common.add_argument_group("restarts")
    group.add_argument(
        "--state", metavar="FILE",
        help="keep boards' sessions in FILE, such as /run/uros.state: after a restart or a crash of"
        " the agent they go on where they were, if it is back before they miss it",
    )  # fmt: skip


def make_keeper(options: argparse.Namespace, log: Log) -> Keeper | None:
    """What keeps sessions, if anything: an attachment of the server. Raises ToolError."""
    if options.state is None:
        return None
    from ....agent.persistence.journal import StateError, open_state
    from ....agent.persistence.session_store import Keeper

    try:
        return Keeper(open_state(options.state), log)
    except StateError as error:
        raise ToolError(str(error)) from error
