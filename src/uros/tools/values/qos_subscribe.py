"""The ``--qos-…`` options of a subscription, which adapts to the publishers otherwise."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from ..common import positive_float, unsigned_int

if TYPE_CHECKING:
    from ...qos import QoSProfile

# A tenth of a second at 10,000 messages a second, for when the machine gives the command no time.
# Discovery does not tell a publisher's depth.
_DEFAULT_DEPTH: Final = 1000

# name → (depth, best effort, transient local), from rmw/qos_profiles.h
PRESETS: Final = {
    "default": (10, False, False),
    "system_default": (1, True, False),
    "sensor_data": (5, True, False),
    "services_default": (10, False, False),
    "parameters": (1000, False, False),
    "parameter_events": (1000, False, False),
    "action_status_default": (1, False, True),
    "rosout_default": (1000, False, True),
    "best_available": (10, True, False),
}
_ADAPTS: Final = "best_available"


def add_qos_arguments(parser: argparse.ArgumentParser, preset: str | None = None) -> None:
    """Declare the options.

    Args:
        parser: Where to declare them.
        preset: The default of ``--qos-profile``; None is what `choose` says.
    """
    group = parser.add_argument_group(
        "quality of service",
        "Reliability and durability are those of the publishers unless they are given.",
    )
    group.add_argument(
        "--qos-profile",
        choices=tuple(PRESETS),
        metavar="NAME",
        default=preset,
        help=f"preset: {', '.join(PRESETS)}"
        f" (default: {preset or f'sensor_data with depth {_DEFAULT_DEPTH}'})",
    )
    group.add_argument(
        "--qos-depth",
        metavar="N",
        type=unsigned_int,
        help="history depth: how many messages are queued",
    )
    group.add_argument(
        "--qos-history",
        choices=("system_default", "keep_last", "keep_all"),
        help="keep the last --qos-depth messages, or all",
    )
    group.add_argument(
        "--qos-reliability", choices=("system_default", "reliable", "best_effort", _ADAPTS)
    )
    group.add_argument(
        "--qos-durability", choices=("system_default", "transient_local", "volatile", _ADAPTS)
    )
    add_liveliness(group)


def add_liveliness(group: argparse._ArgumentGroup) -> None:
    """Declare the options of liveliness, of a publisher or a subscription."""
    group.add_argument(
        "--qos-liveliness", choices=("system_default", "automatic", "manual_by_topic", _ADAPTS)
    )
    group.add_argument(
        "--qos-liveliness-lease-duration-seconds",
        metavar="S",
        type=positive_float,
        help="lease duration, after which a silent manual_by_topic publisher is not alive",
    )


def liveliness(args: argparse.Namespace) -> tuple[int, int | None]:
    """Return the liveliness that the options name, and its lease duration in ms."""
    from ...qos import LivelinessPolicy

    manual = args.qos_liveliness == "manual_by_topic"
    lease = args.qos_liveliness_lease_duration_seconds
    return (
        LivelinessPolicy.MANUAL_BY_TOPIC if manual else LivelinessPolicy.AUTOMATIC,
        None if lease is None else max(1, round(lease * 1000)),
    )


def choose(args: argparse.Namespace, offered: Sequence[QoSProfile]) -> tuple[QoSProfile, list[str]]:
    """Return the profile to subscribe with, and notes for the user.

    Args:
        args: The command line.
        offered: The profiles of the publishers.
    """
    from ...host.matching import adapt
    from ...qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    depth, best_effort, transient_local = PRESETS[args.qos_profile or "sensor_data"]
    if args.qos_profile is None:
        depth = _DEFAULT_DEPTH
    reliability = args.qos_reliability if args.qos_reliability != _ADAPTS else None
    durability = args.qos_durability if args.qos_durability != _ADAPTS else None
    if reliability is not None:
        best_effort = reliability != "reliable"
    if durability is not None:
        transient_local = durability == "transient_local"
    policy, lease_ms = liveliness(args)
    profile = QoSProfile(
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
    notes = adapt(profile, offered, reliability is not None, durability is not None)
    if reliability == "reliable" and not all(qos.reliable for qos in offered):
        notes.append("best-effort publishers do not match: reliable was requested")
    if durability == "transient_local" and not all(qos.transient_local for qos in offered):
        notes.append("volatile publishers do not match: transient local was requested")
    return profile, notes
