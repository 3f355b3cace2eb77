"""Listings and infos as JSON: the option, the document, and the entries that verbs share."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ..qos import QoSProfile

_NS_OF_MS: Final = 1_000_000


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare ``--json``."""
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def print_json(document: Any) -> None:
    """Print a document on one line, in ASCII."""
    print(json.dumps(document))


def entries(types: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Return an object with ``name`` and ``types`` for each name."""
    return [{"name": name, "types": list(some)} for name, some in types.items()]


def qos_entry(qos: QoSProfile) -> dict[str, Any]:
    """Return a profile's policies by the names that ros2 prints.

    Durations are in nanoseconds, None if infinite; an unknown policy is ``UNKNOWN``.
    """
    from ..qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy

    def name(kind: Any, value: int, *known: str) -> str:
        return next((each for each in known if getattr(kind, each) == value), "UNKNOWN")

    return {
        "reliability": name(ReliabilityPolicy, qos.reliability, "RELIABLE", "BEST_EFFORT"),
        "history": name(HistoryPolicy, qos.history, "KEEP_LAST", "KEEP_ALL"),
        "depth": qos.depth,
        "durability": name(DurabilityPolicy, qos.durability, "TRANSIENT_LOCAL", "VOLATILE"),
        "lifespan": _nanoseconds(qos.lifespan_ms),
        "deadline": _nanoseconds(qos.deadline_ms),
        "liveliness": name(LivelinessPolicy, qos.liveliness, "AUTOMATIC", "MANUAL_BY_TOPIC"),
        "liveliness_lease_duration": _nanoseconds(qos.liveliness_lease_ms),
    }


def _nanoseconds(milliseconds: int | None) -> int | None:
    return None if milliseconds is None else milliseconds * _NS_OF_MS
