"""The option of ``uros agent`` about restarts."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ...errors import ToolError
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.log import Log
    from ....agent.persistence.session_store import SessionStore

OPTIONS: Final = OptionGroup("restart")
OPTIONS.add(
    "--state", metavar="FILE",
    help="keep the sessions of boards in FILE, such as /run/uros.state: they continue after a"
    " restart or a crash of the agent if it restarts before the boards time out",
)  # fmt: skip


def make_session_store(options: argparse.Namespace, log: Log) -> SessionStore | None:
    """Open the session store of ``--state``, if it is given: an attachment of the server.

    Raises:
        ToolError: The file cannot be used.
    """
    if options.state is None:
        return None
    from ....agent.persistence.journal import JournalError, open_journal
    from ....agent.persistence.session_store import SessionStore

    try:
        return SessionStore(open_journal(options.state), log)
    except JournalError as error:
        raise ToolError(str(error)) from error
