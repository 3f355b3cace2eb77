"""Which QoS policies keep a writer and a reader from matching (DDS 2.2.3, table of RxO policies).

A writer must offer at least what the reader requests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from ..qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from . import partitions

# From weakest to strongest. An unknown one counts as the first.
_DURABILITIES: Final = (
    DurabilityPolicy.VOLATILE,
    DurabilityPolicy.TRANSIENT_LOCAL,
    DurabilityPolicy.TRANSIENT,
    DurabilityPolicy.PERSISTENT,
)
_DURABILITY_NAMES: Final = ("volatile", "transient_local", "transient", "persistent")
# Attack: lists from the network, 32 kB long, that are told to the user in a line: texts of one that
# are shown, and characters of a text.
_MOST: Final = 4
_LONGEST: Final = 48


@dataclass(frozen=True)
class Mismatch:
    """One policy that keeps a writer and a reader from matching.

    Attributes:
        policy: The policy's name.
        offered: The writer's value.
        requested: The reader's value.
        offer: The rule of ``uros agent --qos`` that makes a board's writer match, or nothing.
        request: The rule that makes a board's reader match, or nothing.
    """

    policy: str
    offered: str
    requested: str
    offer: str = ""
    request: str = ""


def mismatches(offered: QoSProfile, requested: QoSProfile) -> list[Mismatch]:
    """Return why a writer and a reader of one topic and type do not match; empty if they do."""
    found = []
    if requested.reliable and not offered.reliable:
        found.append(
            Mismatch(
                "reliability",
                "best_effort",
                "reliable",
                "reliability=reliable",
                "reliability=best_effort",
            )  # fmt: skip
        )
    have, want = _rank(offered.durability), _rank(requested.durability)
    if have < want:
        found.append(
            Mismatch(
                "durability",
                _DURABILITY_NAMES[have],
                _DURABILITY_NAMES[want],
                "durability=transient_local" if want == 1 else "",
                f"durability={_DURABILITY_NAMES[have]}" if have < 2 else "",
            )  # fmt: skip
        )
    if _longer(offered.deadline_ms, requested.deadline_ms):
        found.append(
            Mismatch(
                "deadline",
                _time(offered.deadline_ms),
                _time(requested.deadline_ms),
                f"deadline_ms={requested.deadline_ms}",
                "" if offered.deadline_ms is None else f"deadline_ms={offered.deadline_ms}",
            )  # fmt: skip
        )
    manual = LivelinessPolicy.MANUAL_BY_TOPIC
    if requested.liveliness == manual and offered.liveliness != manual:
        found.append(
            Mismatch(
                "liveliness",
                "automatic",
                "manual_by_topic",
                "liveliness=manual_by_topic",
                "liveliness=automatic",
            )  # fmt: skip
        )
    if _longer(offered.liveliness_lease_ms, requested.liveliness_lease_ms):
        lease = offered.liveliness_lease_ms
        found.append(
            Mismatch(
                "liveliness lease",
                _time(lease),
                _time(requested.liveliness_lease_ms),
                f"liveliness_lease_ms={requested.liveliness_lease_ms}",
                "" if lease is None else f"liveliness_lease_ms={lease}",
            )  # fmt: skip
        )
    if offered.ownership_exclusive != requested.ownership_exclusive:
        words = {True: "exclusive", False: "shared"}
        found.append(
            Mismatch(
                "ownership",
                words[offered.ownership_exclusive],
                words[requested.ownership_exclusive],
            )
        )
    if not partitions.meet(offered.partitions, requested.partitions):
        found.append(
            Mismatch(
                "partition",
                shorten([*map(repr, offered.partitions)]),
                shorten([*map(repr, requested.partitions)]),
            )
        )
    return found


def _rank(durability: int) -> int:
    return _DURABILITIES.index(durability) if durability in _DURABILITIES else 0


def _longer(offered: int | None, requested: int | None) -> bool:
    return requested is not None and (offered is None or offered > requested)


def _time(milliseconds: int | None) -> str:
    return "unlimited" if milliseconds is None else f"{milliseconds} ms"


def shorten(texts: Sequence[str]) -> str:
    """Return a list for one line: its first texts, each cut to 48 characters, and how many more."""
    shown = [
        text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…" for text in texts[:_MOST]
    ]
    more = f" and {len(texts) - _MOST} more" if len(texts) > _MOST else ""
    return (", ".join(shown) + more) or "none"
