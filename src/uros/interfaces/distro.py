"""The ROS 2 distribution whose definitions are used: by ROS_DISTRO or `use`. Host only.

``definitions`` has the newest that uros knows. A folder of ``older`` has the definitions that were
different up to that distribution: Humble's are in ``older/humble`` and ``older/iron``, Iron's in
``older/iron`` alone. Definitions that differ in comments only are left out.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from .errors import InterfaceError

DISTROS: Final = ("humble", "iron", "jazzy", "kilted")
"""Distributions whose definitions uros has, the oldest first."""
NEWEST: Final = DISTROS[-1]
_AS_NEWEST: Final = ("lyrical", "rolling")
NAMES: Final = (*DISTROS, *_AS_NEWEST)
"""All distributions that may be chosen; those newer than `NEWEST` use its definitions."""
_WITHOUT_HASHES: Final = ("humble",)

_OLDER: Final = Path(__file__).parent / "older"
_SINCE: Final = {
    "rcl_interfaces/msg/LoggerLevel": "iron",
    "rcl_interfaces/msg/SetLoggerLevelsResult": "iron",
    "rcl_interfaces/srv/GetLoggerLevels": "iron",
    "rcl_interfaces/srv/SetLoggerLevels": "iron",
    "service_msgs/msg/ServiceEventInfo": "iron",
    "type_description_interfaces/msg/Field": "iron",
    "type_description_interfaces/msg/FieldType": "iron",
    "type_description_interfaces/msg/IndividualTypeDescription": "iron",
    "type_description_interfaces/msg/KeyValue": "iron",
    "type_description_interfaces/msg/TypeDescription": "iron",
    "type_description_interfaces/msg/TypeSource": "iron",
    "type_description_interfaces/srv/GetTypeDescription": "iron",
    "geometry_msgs/msg/PolygonInstance": "jazzy",
    "geometry_msgs/msg/PolygonInstanceStamped": "jazzy",
    "nav_msgs/msg/Goals": "kilted",
}
"""Types that earlier distributions do not have."""

_used = ""


def use(name: str) -> None:
    """Use the definitions of a distribution in place of ROS_DISTRO's; "" for ROS_DISTRO's.

    Call it before types are loaded: a loaded class is not replaced.

    Raises:
        InterfaceError: If the name is none of `NAMES`.
    """
    global _used
    _used = _known(name, "") if name else ""


def chosen() -> str:
    """Return the distribution, one of `DISTROS`.

    Raises:
        InterfaceError: If ROS_DISTRO names no known distribution.
    """
    return _used or _known(os.environ.get("ROS_DISTRO", ""), "ROS_DISTRO: ")


def has_hashes() -> bool:
    """Whether the chosen distribution has type hashes, which were added in Iron."""
    return chosen() not in _WITHOUT_HASHES


def since(type_name: str) -> str:
    """Return the distribution that added a type, or "" if Humble has it already."""
    return _SINCE.get(type_name, "")


def missing(type_name: str, distro: str) -> bool:
    """Whether a packaged type is newer than the distribution."""
    return type_name in _SINCE and DISTROS.index(distro) < DISTROS.index(_SINCE[type_name])


def older(distro: str) -> list[Path]:
    """Return the folders whose definitions override the newest ones, by precedence."""
    return [_OLDER / name for name in DISTROS[DISTROS.index(distro) :] if (_OLDER / name).is_dir()]


def _known(name: str, where: str) -> str:
    plain = name.strip().lower() or NEWEST
    if plain in DISTROS:
        return plain
    if plain in _AS_NEWEST:
        return NEWEST
    raise InterfaceError(f"{where}no definitions of ROS 2 {name!r}; there are {', '.join(NAMES)}")
