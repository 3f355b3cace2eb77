"""QoS profiles of recordings: overrides from a file, and what a player offers."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ..errors import ToolError, did_you_mean
from ..values import yaml_read

if TYPE_CHECKING:
    from ...qos import QoSProfile

_SYSTEM: Final = "system_default"
_POLICIES: Final = {
    "history": (_SYSTEM, "keep_last", "keep_all"),
    "reliability": (_SYSTEM, "reliable", "best_effort", "best_available"),
    "durability": (_SYSTEM, "transient_local", "volatile", "best_available"),
    "liveliness": (_SYSTEM, "automatic", "manual_by_topic", "best_available"),
}
_DURATIONS: Final = {
    "deadline": "deadline_ms",
    "lifespan": "lifespan_ms",
    "liveliness_lease_duration": "liveliness_lease_ms",
}
_IGNORED: Final = "avoid_ros_namespace_conventions"
_KEYS: Final = (*_POLICIES, "depth", *_DURATIONS, _IGNORED)
# Attack: a file of many megabytes, which YAML takes minutes for.
_MAX_FILE: Final = 1 << 20
# For subscriptions that come late, where the publishers' depth was not discovered; as in rosbag2.
_LATCHED_DEPTH: Final = 10
# For what was sent and is not acknowledged yet, which a larger depth keeps for longer.
_RESEND_DEPTH: Final = 1000


def read_overrides(path: str | None) -> dict[str, QoSProfile]:
    """Read a file of profiles by topic, in the format of rosbag2.

    Args:
        path: The file; None gives no profile.

    Raises:
        ToolError: The file cannot be read, or a policy in it is wrong.
    """
    if path is None:
        return {}
    try:
        with Path(path).open("rb") as file:
            text = file.read(_MAX_FILE + 1).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise ToolError(f"--qos-profile-overrides-path {path}: {reason}") from error
    if len(text) > _MAX_FILE:
        raise ToolError(f"--qos-profile-overrides-path {path}: over {_MAX_FILE} bytes")
    try:
        return _profiles(yaml_read.read(text))
    except (yaml_read.YamlError, _Fault) as error:
        raise ToolError(f"--qos-profile-overrides-path {path}: {error}") from error


class _Fault(Exception):
    """A policy is wrong."""


def _profiles(node: yaml_read.Node) -> dict[str, QoSProfile]:
    if node == "":
        return {}
    if not isinstance(node, dict):
        raise _Fault("expected topics with their profiles, such as '/chatter: {depth: 5}'")
    return {topic: _profile(topic, entries) for topic, entries in node.items()}


def _profile(topic: str, node: yaml_read.Node) -> QoSProfile:
    from ...qos import (
        DurabilityPolicy,
        HistoryPolicy,
        LivelinessPolicy,
        QoSProfile,
        ReliabilityPolicy,
    )

    values = {
        "keep_all": HistoryPolicy.KEEP_ALL,
        "best_effort": ReliabilityPolicy.BEST_EFFORT,
        "transient_local": DurabilityPolicy.TRANSIENT_LOCAL,
        "manual_by_topic": LivelinessPolicy.MANUAL_BY_TOPIC,
    }
    if not isinstance(node, dict):
        raise _Fault(f"{topic}: expected policies, such as 'reliability: best_effort'")
    profile = QoSProfile()
    for key, value in node.items():
        where = f"{topic}: {key}"
        if key in _POLICIES:
            if value not in _POLICIES[key]:
                known = _POLICIES[key]
                raise _Fault(
                    f"{where}: {value!r} is none of {', '.join(known)}"
                    f"{did_you_mean(str(value), known)}"
                )
            if value in values:  # the others are what the profile has already
                setattr(profile, key, values[str(value)])
        elif key == "depth":
            profile.depth = _number(where, value)
        elif key in _DURATIONS:
            setattr(profile, _DURATIONS[key], _milliseconds(where, value))
        elif key != _IGNORED:
            raise _Fault(f"{topic}: there is no policy {key!r}{did_you_mean(key, _KEYS)}")
    return profile


def _number(where: str, node: object) -> int:
    value = yaml_read.resolve(node) if isinstance(node, yaml_read.Plain) else None
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise _Fault(f"{where}: expected an integer of 0 or more")
    return value


def _milliseconds(where: str, node: object) -> int | None:
    """Return a duration, rounded up; None for 0 and for what is longer than a DDS duration."""
    if not isinstance(node, Mapping) or set(node) != {"sec", "nsec"}:
        raise _Fault(f"{where}: expected {{sec: …, nsec: …}}")
    sec, nsec = (_number(f"{where}: {key}", node[key]) for key in ("sec", "nsec"))
    return None if sec >= 1 << 31 else -(-(sec * 10**9 + nsec) // 10**6) or None


def offered(recorded: Sequence[QoSProfile]) -> tuple[QoSProfile, bool]:
    """Return the profile with which a recorded topic is published.

    It is that of the recorded publishers. Where they differ, it is reliable if any of them was, and
    transient local if any of them was: every subscription that one of them matched matches it.

    Args:
        recorded: The profiles that the publishers offered.

    Returns:
        The profile, and whether the publishers differed.
    """
    from ...qos import HistoryPolicy, QoSProfile

    profiles = [_known(profile) for profile in recorded] or [QoSProfile()]
    differ = len({_compared(profile) for profile in profiles}) > 1
    chosen = copy.copy(profiles[0])
    if differ:
        chosen = QoSProfile(
            reliability=min(profile.reliability for profile in profiles),  # RELIABLE is the least
            durability=min(profile.durability for profile in profiles),  # TRANSIENT_LOCAL likewise
        )
    if any(profile.history == HistoryPolicy.KEEP_ALL for profile in profiles):
        chosen.history = HistoryPolicy.KEEP_ALL
    if chosen.transient_local:  # one writer has what those of all publishers had
        chosen.depth = sum(profile.depth or _LATCHED_DEPTH for profile in profiles)
    else:
        chosen.depth = max(_RESEND_DEPTH, *(profile.depth for profile in profiles))
    return chosen, differ


def _known(profile: QoSProfile) -> QoSProfile:
    """Return the profile with DDS's default of a writer in place of unknown policies."""
    from ...qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy

    known = copy.copy(profile)
    if known.history != HistoryPolicy.KEEP_ALL:
        known.history = HistoryPolicy.KEEP_LAST
    if known.reliability != ReliabilityPolicy.BEST_EFFORT:
        known.reliability = ReliabilityPolicy.RELIABLE
    known.durability = (
        DurabilityPolicy.TRANSIENT_LOCAL
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        else DurabilityPolicy.VOLATILE
    )
    if known.liveliness != LivelinessPolicy.MANUAL_BY_TOPIC:
        known.liveliness = LivelinessPolicy.AUTOMATIC
    return known


def _compared(profile: QoSProfile) -> tuple[object, ...]:
    return (
        profile.reliability,
        profile.durability,
        profile.deadline_ms,
        profile.liveliness,
        profile.liveliness_lease_ms,
    )
