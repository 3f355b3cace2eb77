"""The options of ``uros agent`` about captures."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, Any, Final

from ...common import positive_int
from ...errors import ToolError

if TYPE_CHECKING:
    from ....agent.agent import Agent
    from ....agent.observability.capture import Capture

DEFAULT_SIZE: Final = 100
DEFAULTS: Final[dict[str, Any]] = {"capture": None, "capture_size": DEFAULT_SIZE}


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = common.add_argument_group(
        "what boards say", "A capture is read by 'uros trace', and by Wireshark."
    )
    group.add_argument(
        "--capture", metavar="FILE",
        help="write every message both ways to FILE: as pcapng where it ends with .pcapng,"
        " else as text",
    )  # fmt: skip
    group.add_argument(
        "--capture-size", type=positive_int, metavar="MB",
        help="when FILE is so large, and when the agent starts, it becomes FILE.1 and a new one is"
        " begun"
        f" (default {DEFAULT_SIZE})",
    )  # fmt: skip


def _same(one: str, other: str) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def open_capture(options: argparse.Namespace, agent: Agent) -> Capture | None:
    """What ``--capture`` asks for, listening to the agent. Raises ToolError."""
    if options.capture is None:
        return None
    from ....agent.observability.capture import Capture, CaptureError

    if options.state is not None and _same(options.state, options.capture):
        raise ToolError(
            f"--state and --capture are both {options.capture}: give each a file of its own"
        )
    try:
        return Capture(options.capture, options.capture_size * 1_000_000, agent.log, agent.taps)
    except CaptureError as error:
        raise ToolError(str(error)) from error
