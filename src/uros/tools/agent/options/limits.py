"""The options of ``uros agent`` about how much boards may have."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ...common import positive_int

if TYPE_CHECKING:
    from ....agent.policy.limits import Limits

DEFAULTS: Final[dict[str, Any]] = {"max_objects": None, "max_message": None, "max_memory": None}

# A message of more is nothing that a board has memory for.
_MOST_MESSAGE: Final = 256 * 1024 * 1024


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = common.add_argument_group(
        "how much boards may have", "What is over it is refused, and the log says so."
    )
    group.add_argument(
        "--max-objects", type=positive_int, metavar="N",
        help="DDS-XRCE objects of one board (default 4096)",
    )  # fmt: skip
    group.add_argument(
        "--max-message", type=_message, metavar="BYTES",
        help="longest message, either way (default 8388608)",
    )  # fmt: skip
    group.add_argument(
        "--max-memory", type=positive_int, metavar="MB",
        help="memory that all boards together may make the agent hold (default 256)",
    )  # fmt: skip


def make_limits(options: argparse.Namespace) -> Limits:
    """What the options say."""
    from ....agent.policy.limits import Limits

    given = {
        "objects": options.max_objects,
        "message": options.max_message,
        "memory": options.max_memory and options.max_memory * 1024 * 1024,
    }
    return Limits(**{name: it for name, it in given.items() if it is not None})


def _message(text: str) -> int:
    size = positive_int(text)
    if size > _MOST_MESSAGE:
        raise argparse.ArgumentTypeError(f"{text} is over {_MOST_MESSAGE} bytes")
    return size
