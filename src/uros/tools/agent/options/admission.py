"""The options of ``uros agent`` about the admission of clients and their liveliness."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ...common import positive_int
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.policy.admission import Admission
    from ....agent.policy.rules import Rules


def dead_time(text: str) -> float:
    """Parse ``--dead-time``: seconds, 0 for never."""
    from ....agent.policy.liveliness import MAX_DEAD_TIME

    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= MAX_DEAD_TIME:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a number of seconds from 0 (never) to {MAX_DEAD_TIME:.0f}"
        )
    return value


OPTIONS: Final = OptionGroup(
    "admission", "A rules file (--control) can hold these too, in its table [admission].",
    table="admission",
)  # fmt: skip
OPTIONS.add(
    "--allow-key", metavar="KEY", action="append",
    help="admit only clients with these keys (0x4B0CBE99, or a decimal number); may be repeated",
)  # fmt: skip
OPTIONS.add(
    "--allow-net", metavar="NET", action="append",
    help="accept messages over UDP and TCP only from these networks (192.168.1.0/24, fd00::/8, or"
    " one address); may be repeated",
)  # fmt: skip
OPTIONS.add(
    "--max-clients", type=positive_int, metavar="N",
    help="maximum number of clients at a time (default: 4096, which is also the highest)",
)  # fmt: skip
OPTIONS.add(
    "--dead-time", type=dead_time, metavar="SECONDS",
    help="delete the session of a client that was silent for so long and does not answer a ping"
    " (default: 300; 0: never)",
)  # fmt: skip


def make_admission(options: argparse.Namespace, rules: Rules) -> Admission:
    """Make the admission rules of the options and of the rules files.

    Raises:
        ConfigError: A key or a network is wrong.
    """
    from ....agent.policy.admission import make_admission as make
    from ....agent.policy.config_values import faults_of

    make(rules.admission)  # first alone: a mistake in a file is not the command line's
    with faults_of("the command line"):
        return make(rules.admission, options.allow_key, options.allow_net, options.max_clients)
