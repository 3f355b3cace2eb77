"""Octets of a Gid in our discovery info: as ROS_DISTRO says, or as other participants have it.

A ROS up to Humble and one from Iron on cannot read each other's ``ros_discovery_info``. Without
ROS_DISTRO the agent begins with 16 octets. If more of the ROS participants in a domain use 24, it
changes to 24, and back as soon as as many use 16. Participants of uros do not count, because they
follow the others, and two agents would otherwise confirm each other. A participant counts once, by
the message that it wrote itself; messages about other participants are ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ..user_data import ENCLAVE, UROS
from .codec import LONG_GID, SHORT_GID

_SIZES: Final = {
    **dict.fromkeys(("foxy", "galactic", "humble"), LONG_GID),
    **dict.fromkeys(("iron", "jazzy", "kilted", "lyrical", "rolling"), SHORT_GID),
}


def configured_gid_size(environment: Mapping[str, str]) -> int | None:
    """Return the octets of a Gid in the ROS that ROS_DISTRO names; None for an unknown one."""
    return _SIZES.get(environment.get("ROS_DISTRO", "").strip().lower())


class GidSizeSelector:
    """Selects the Gid size of one domain.

    Attributes:
        size: The selected size in octets.

    Args:
        domain: The domain, for notices.
        configured: The size that ROS_DISTRO asks for; it is never changed. None: follow the others.
        on_change: Called with the new size.
        notice: Called with a line for the user.
    """

    def __init__(
        self,
        domain: int,
        configured: int | None,
        on_change: Callable[[int], None],
        notice: Callable[[str], None],
    ) -> None:
        self.size = configured or SHORT_GID
        self._domain = domain
        self._configured = configured
        self._on_change = on_change
        self._notice = notice
        self._noticed = False

    def update(self, participants: Mapping[bytes, bytes], gid_sizes: Mapping[bytes, int]) -> None:
        """Count the sizes in use and change :attr:`size` if more participants use the other.

        Args:
            participants: USER_DATA of the participants known, by GUID.
            gid_sizes: Octets of a Gid in the participants' messages, by the participants' GUIDs.
        """
        count = {SHORT_GID: 0, LONG_GID: 0}
        for guid, size in gid_sizes.items():
            # A message may come before its participant is discovered. It counts once that is.
            user_data = participants.get(guid, UROS)
            if ENCLAVE in user_data and UROS not in user_data:
                count[size] += 1
        target = SHORT_GID if self.size == LONG_GID else LONG_GID
        if count[target] and self._configured is not None:
            self._notice_once(
                f"ROS_DISTRO asks for {self.size}-byte Gids, and ROS nodes in the domain use"
                f" {target}: they do not see the boards' nodes; set ROS_DISTRO to the peers' ROS,"
                " or unset it"
            )
        elif count[target] >= count[self.size] + (target == LONG_GID) and count[target]:
            self._noticed = False
            self.size = target
            self._on_change(target)
            self._notice(
                f"domain {self._domain}: ros_discovery_info with {target}-byte Gids from now on, as"
                " the ROS nodes in the domain have; set ROS_DISTRO to decide it"
            )
        elif count[target]:
            self._notice_once(
                f"ROS nodes of before Iron and of after are in the domain; those with {target}-byte"
                " Gids do not see the boards' nodes; set ROS_DISTRO to choose"
            )

    def _notice_once(self, text: str) -> None:
        if not self._noticed:
            self._noticed = True
            self._notice(f"domain {self._domain}: {text}")
