"""The options of ``uros agent`` about captures."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, Final

from ...common import positive_int
from ...errors import ToolError
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.agent import Agent
    from ....agent.observability.capture import Capture

DEFAULT_SIZE: Final = 100

OPTIONS: Final = OptionGroup(
    "capture", "'uros trace' and Wireshark read captures.", table="capture"
)
OPTIONS.add(
    "--capture", metavar="FILE",
    help="write every message of both directions to FILE: as pcapng if the name ends with .pcapng,"
    " else as text",
)  # fmt: skip
OPTIONS.add(
    "--capture-size", type=positive_int, metavar="MB", default=DEFAULT_SIZE,
    help="rename FILE to FILE.1 and begin a new one at this size, and when the agent starts"
    f" (default: {DEFAULT_SIZE})",
)  # fmt: skip


def _is_same_file(path: str, second: str) -> bool:
    return os.path.realpath(path) == os.path.realpath(second)


def open_capture(options: argparse.Namespace, agent: Agent) -> Capture | None:
    """Open the capture of ``--capture``, if it is given, and connect it to the agent.

    Raises:
        ToolError: The file cannot be written, or is the one of ``--state``.
    """
    if options.capture is None:
        return None
    from ....agent.observability.capture import Capture, CaptureError

    if options.state is not None and _is_same_file(options.state, options.capture):
        raise ToolError(
            f"--state and --capture are both {options.capture}: give each a file of its own"
        )
    try:
        return Capture(
            options.capture, options.capture_size * 1_000_000, agent.log, agent.message_hooks
        )
    except CaptureError as error:
        raise ToolError(str(error)) from error
