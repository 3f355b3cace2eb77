"""QoS profiles in the metadata of bags: rosbag2's mapping, with numbers or names for policies.

Up to version 8 of the metadata the profiles of a topic are a text that is YAML itself, and policies
are numbers of rmw; from version 9 on they are a list, and policies have names. Both are read at any
version, as rosbag2 does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from ..qos import QoSProfile
from .errors import BagError

Profile = dict[str, Any]

# rmw/types.h; the place of a name is its number.
_HISTORY: Final = ("system_default", "keep_last", "keep_all", "unknown")
_RELIABILITY: Final = ("system_default", "reliable", "best_effort", "unknown", "best_available")
_DURABILITY: Final = (
    "system_default", "transient_local", "volatile", "unknown", "best_available",
    "transient_local", "transient_local",
)  # fmt: skip
"""rmw has no durability above TRANSIENT_LOCAL: TRANSIENT (5) and PERSISTENT (6) become that."""
_LIVELINESS: Final = (
    "system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available",
)  # fmt: skip
_SECOND_NS: Final = 10**9
_MS: Final = 10**6
# RMW_DURATION_INFINITE: the largest int64 of nanoseconds.
_INFINITE: Final = {"sec": 9223372036, "nsec": 854775807}
# From here on a duration is infinite: Foxy's DDS libraries had about 2^31 seconds for it.
_INFINITE_S: Final = 0x7FFFFFFF
_MAX_PROFILES: Final = 1000  # attack: a text that makes a great many profiles of one topic


def to_yaml(profiles: Sequence[QoSProfile], version: int = 9) -> list[Profile]:
    """Return the profiles as rosbag2 writes them at a version of the metadata."""
    return [_profile_to_yaml(profile, version) for profile in profiles]


def from_yaml(node: object, where: str) -> list[QoSProfile]:
    """Return the profiles of a list, or of the text of one.

    Args:
        node: What the metadata have as ``offered_qos_profiles``; empty text and None mean none.
        where: The file and the topic, for the error.

    Raises:
        BagError: These are no profiles.
    """
    if isinstance(node, str):
        from .yaml_text import load

        node = load(node, where)
    if node is None:
        return []
    if not isinstance(node, list) or len(node) > _MAX_PROFILES:
        raise BagError(f"{where}: offered_qos_profiles is no list of profiles")
    return [_profile_from_yaml(each, where) for each in node]


def to_text(profiles: Sequence[QoSProfile]) -> str:
    """Return the text that MCAP channels and SQLite tables have for the profiles of a topic."""
    from .yaml_text import dump

    return dump(to_yaml(profiles)) if profiles else ""


def _profile_to_yaml(profile: QoSProfile, version: int) -> Profile:
    def policy(names: tuple[str, ...], value: int) -> str | int:
        name = names[value] if 0 <= value < len(names) else "unknown"
        return name if version >= 9 else names.index(name)

    return {
        "history": policy(_HISTORY, profile.history),
        "depth": profile.depth,
        "reliability": policy(_RELIABILITY, profile.reliability),
        "durability": policy(_DURABILITY, profile.durability),
        "deadline": _time_to_yaml(profile.deadline_ms),
        "lifespan": _time_to_yaml(profile.lifespan_ms),
        "liveliness": policy(_LIVELINESS, profile.liveliness),
        "liveliness_lease_duration": _time_to_yaml(profile.liveliness_lease_ms),
        "avoid_ros_namespace_conventions": False,
    }


def _profile_from_yaml(node: object, where: str) -> QoSProfile:
    if not isinstance(node, Mapping):
        raise BagError(f"{where}: a QoS profile is no mapping")

    def policy(key: str, names: tuple[str, ...]) -> int:
        value = node.get(key, "unknown")
        if isinstance(value, int) and 0 <= value < len(names):
            return value
        return names.index(value) if value in names else names.index("unknown")

    depth = node.get("depth", 0)
    if not isinstance(depth, int) or depth < 0:
        raise BagError(f"{where}: the depth {depth!r} of a QoS profile is no number from 0 on")
    return QoSProfile(
        depth=depth,
        history=policy("history", _HISTORY),
        reliability=policy("reliability", _RELIABILITY),
        durability=policy("durability", _DURABILITY[:5]),
        deadline_ms=_time_from_yaml(node, "deadline", where),
        lifespan_ms=_time_from_yaml(node, "lifespan", where),
        liveliness=policy("liveliness", _LIVELINESS),
        liveliness_lease_ms=_time_from_yaml(node, "liveliness_lease_duration", where),
    )


def _time_to_yaml(ms: int | None) -> dict[str, int]:
    if not ms:
        return dict(_INFINITE)
    return {"sec": ms // 1000, "nsec": ms % 1000 * _MS}


def _time_from_yaml(profile: Mapping[Any, Any], key: str, where: str) -> int | None:
    """Return milliseconds, rounded up; None for an infinite duration and for 0, the default."""
    node = profile.get(key, _INFINITE)
    sec, nsec = (node.get("sec"), node.get("nsec")) if isinstance(node, Mapping) else (None, None)
    if not isinstance(sec, int) or not isinstance(nsec, int) or sec < 0 or nsec < 0:
        raise BagError(f"{where}: {key} of a QoS profile is not 'sec' and 'nsec' from 0 on")
    if sec >= _INFINITE_S:
        return None
    return -(-(sec * _SECOND_NS + nsec) // _MS) or None
