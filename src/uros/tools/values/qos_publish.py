"""The ``--qos-…`` options of a publisher."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ..common import unsigned_int
from .qos_subscribe import PRESETS, add_liveliness, liveliness

if TYPE_CHECKING:
    from ...qos import QoSProfile

_SYSTEM: Final = "system_default"
_ADAPTS: Final = "best_available"


def add_qos_arguments(parser: argparse.ArgumentParser, preset: str = "default") -> None:
    """Declare the options; ``preset`` is the default of ``--qos-profile``."""
    group = parser.add_argument_group("quality of service")
    group.add_argument(
        "--qos-profile",
        choices=tuple(PRESETS),
        metavar="NAME",
        default=preset,
        help=f"preset: {', '.join(PRESETS)} (default: {preset})",
    )
    group.add_argument(
        "--qos-depth",
        metavar="N",
        type=unsigned_int,
        help="history depth: how many messages are kept",
    )
    group.add_argument(
        "--qos-history",
        choices=(_SYSTEM, "keep_last", "keep_all"),
        help="keep the last --qos-depth messages, or all",
    )
    group.add_argument("--qos-reliability", choices=(_SYSTEM, "reliable", "best_effort", _ADAPTS))
    group.add_argument(
        "--qos-durability",
        choices=(_SYSTEM, "transient_local", "volatile", _ADAPTS),
        help="transient_local: later subscriptions receive the last --qos-depth messages",
    )
    add_liveliness(group)


def choose(args: argparse.Namespace) -> QoSProfile:
    """Return the profile to publish with, or to call a service with.

    What is left to the system, or to the subscriptions, is reliable, volatile and automatic, which
    matches every subscription that does not request more.
    """
    from ...qos import (
        DurabilityPolicy,
        HistoryPolicy,
        QoSProfile,
        ReliabilityPolicy,
    )

    depth, best_effort, transient_local = PRESETS[args.qos_profile]
    if args.qos_profile in (_SYSTEM, _ADAPTS):
        best_effort = False
    if args.qos_reliability is not None:
        best_effort = args.qos_reliability == "best_effort"
    if args.qos_durability is not None:
        transient_local = args.qos_durability == "transient_local"
    policy, lease_ms = liveliness(args)
    return QoSProfile(
        depth=args.qos_depth or depth,
        history=(
            HistoryPolicy.KEEP_ALL if args.qos_history == "keep_all" else HistoryPolicy.KEEP_LAST
        ),
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE
        ),
        liveliness=policy,
        liveliness_lease_ms=lease_ms,
    )
