"""The options of ``uros agent`` about who may come in, and how long one may be silent."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ...common import positive_int

if TYPE_CHECKING:
    from ....agent.policy.admission import Admission
    from ....agent.policy.rules import Control

DEFAULTS: Final[dict[str, Any]] = {
    "allow_key": [],
    "allow_net": [],
    "max_clients": None,
    "dead_time": None,
}


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = common.add_argument_group(
        "who may come in", "A file of rules (--control) can say it too, in its table [admission]."
    )
    group.add_argument(
        "--allow-key", metavar="KEY", action="append",
        help="let only clients with these keys in (0x4B0CBE99, or a number); may be repeated",
    )  # fmt: skip
    group.add_argument(
        "--allow-net", metavar="NET", action="append",
        help="talk only to these networks (192.168.1.0/24, fd00::/8, or an address), over UDP and"
        " TCP; may be repeated",
    )  # fmt: skip
    group.add_argument(
        "--max-clients", type=positive_int, metavar="N",
        help="clients at a time (default and at most 4096)",
    )  # fmt: skip
    group.add_argument(
        "--dead-time", type=dead_time, metavar="SECONDS",
        help="forget a client that was silent for so long and answers no questions (default 300;"
        " 0: never)",
    )  # fmt: skip


def dead_time(text: str) -> float:
    """Seconds; 0 for never."""
    from ....agent.policy.liveliness import MAX_DEAD_TIME

    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= MAX_DEAD_TIME:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no number of seconds up to {MAX_DEAD_TIME:.0f} (0: never)"
        )
    return value


def make_admission(options: argparse.Namespace, control: Control) -> Admission:
    """Of the options and of the tables in ``control``. Raises ControlError."""
    from ....agent.policy.admission import make_admission as make
    from ....agent.policy.config_values import ControlError

    make(control.admission)  # so that a mistake of a file is not said to be the command line's
    try:
        return make(control.admission, options.allow_key, options.allow_net, options.max_clients)
    except ControlError as error:
        raise ControlError(f"the command line: {error}") from error
