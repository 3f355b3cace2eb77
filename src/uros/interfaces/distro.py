"""Which ROS 2 distribution's definitions count: those of ROS_DISTRO, or as `use` says. Host only.

``definitions`` has the newest that uros knows. A folder of ``older`` has those which were another
up to that distribution: Humble's are in ``older/humble`` and ``older/iron``, Iron's in
``older/iron`` alone. What differs in comments only is not there.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from .errors import InterfaceError

DISTROS: Final = ("humble", "iron", "jazzy", "kilted")
"""Those whose definitions uros has, the oldest first."""
NEWEST: Final = DISTROS[-1]
_AS_NEWEST: Final = ("lyrical", "rolling")
NAMES: Final = (*DISTROS, *_AS_NEWEST)
"""All that may be chosen. Those which are newer than ours have the newest definitions."""
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
    """Take the definitions of a distribution, whatever ROS_DISTRO says; "" for ROS_DISTRO's.

    Call it before types are loaded; a class that is loaded already stays. Raises InterfaceError
    for a name that is none of `NAMES`.
    """
    global _used
    _used = _known(name, "") if name else ""


def chosen() -> str:
    """The distribution, one of `DISTROS`. Raises InterfaceError where ROS_DISTRO names none."""
    return _used or _known(os.environ.get("ROS_DISTRO", ""), "ROS_DISTRO: ")


def has_hashes() -> bool:
    """Whether ROS of that distribution knows type hashes, which came with Iron."""
    return chosen() not in _WITHOUT_HASHES


def since(type_name: str) -> str:
    """The distribution that a type came with, where it is not that old; else ""."""
    return _SINCE.get(type_name, "")


def missing(type_name: str, distro: str) -> bool:
    """Whether the distribution does not have a type of the packaged ones yet."""
    return type_name in _SINCE and DISTROS.index(distro) < DISTROS.index(_SINCE[type_name])


def older(distro: str) -> list[Path]:
    """The folders whose definitions go before the newest ones, the first one first."""
    return [_OLDER / name for name in DISTROS[DISTROS.index(distro) :] if (_OLDER / name).is_dir()]


def _known(name: str, where: str) -> str:
    plain = name.strip().lower() or NEWEST
    if plain in DISTROS:
        return plain
    if plain in _AS_NEWEST:
        return NEWEST
    raise InterfaceError(f"{where}no definitions of ROS 2 {name!r}; there are {', '.join(NAMES)}")
