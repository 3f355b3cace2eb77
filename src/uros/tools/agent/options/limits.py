"""The options of ``uros agent`` about how much boards may use."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ...common import positive_int
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.policy.limits import Limits

# A board has no memory for a longer message.
_HIGHEST_MAX_MESSAGE: Final = 256 * 1024 * 1024


def _message_size(text: str) -> int:
    size = positive_int(text)
    if size > _HIGHEST_MAX_MESSAGE:
        raise argparse.ArgumentTypeError(f"{text} is over {_HIGHEST_MAX_MESSAGE} bytes")
    return size


OPTIONS: Final = OptionGroup(
    "limits", "The agent refuses what exceeds a limit, and logs a warning.", table="limits"
)
OPTIONS.add(
    "--max-objects", type=positive_int, metavar="N",
    help="maximum number of DDS-XRCE objects of one board (default: 4096)",
)  # fmt: skip
OPTIONS.add(
    "--max-message", type=_message_size, metavar="BYTES",
    help="maximum length of a message, in both directions (default: 8388608)",
)  # fmt: skip
OPTIONS.add(
    "--max-memory", type=positive_int, metavar="MB",
    help="maximum memory that all boards together may use in the agent (default: 256)",
)  # fmt: skip


def make_limits(options: argparse.Namespace) -> Limits:
    """Make the limits that the options give."""
    from ....agent.policy.limits import Limits

    given = {
        "objects": options.max_objects,
        "message": options.max_message,
        "memory": options.max_memory and options.max_memory * 1024 * 1024,
    }
    return Limits(**{name: value for name, value in given.items() if value is not None})
