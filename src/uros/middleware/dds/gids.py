"""How long a Gid is in what we announce: as ROS_DISTRO says, or as the peers' Gids are.

A ROS up to Humble and one from Iron on cannot read each other's ``ros_discovery_info``. Without
ROS_DISTRO the agent begins with 16 bytes, and where more of the ROS participants in a domain use
24 it does as they do, until as many use 16. Participants of ours do not count: they follow the
others, and two agents would hold each other where they are. Each participant has one voice, by what
it writes itself: nobody speaks for others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from . import announce
from .config import LONG_GID, SHORT_GID
from .discovery import Peers

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_ENCLAVE: Final = b"enclave="


class GidWatch:
    """Decides ``size`` for one domain; ends with the participant it looks through."""

    def __init__(
        self, middleware: DdsMiddleware, participant: SharedParticipant, told: int | None
    ) -> None:
        self.size = told or SHORT_GID
        self._told = told
        self._middleware = middleware
        self._domain = participant.domain
        self._noticed = False
        self._peers = Peers(middleware, participant, self._look)

    def _look(self) -> None:
        count = {SHORT_GID: 0, LONG_GID: 0}
        for guid, size in self._peers.gid_sizes.items():
            data = self._peers.participants.get(guid, announce.MARK)
            if _ENCLAVE in data and announce.MARK not in data:
                count[size] += 1
        other = SHORT_GID if self.size == LONG_GID else LONG_GID
        if count[other] and self._told is not None:
            self._notice_once(
                f"ROS_DISTRO asks for {self.size}-byte Gids, and ROS nodes in the domain use"
                f" {other}: they do not see the boards' nodes; set ROS_DISTRO to the peers' ROS,"
                " or unset it"
            )
        elif count[other] >= count[self.size] + (other == LONG_GID) and count[other]:
            self._noticed = False
            self.size = other
            self._middleware.resize_gids(self._domain, other)
            self._middleware.notice(
                f"domain {self._domain}: ros_discovery_info with {other}-byte Gids from now on, as"
                " the ROS nodes in the domain have; set ROS_DISTRO to decide it"
            )
        elif count[other]:
            self._notice_once(
                f"ROS nodes of before Iron and of after are in the domain; those with {other}-byte"
                " Gids do not see the boards' nodes; set ROS_DISTRO to choose"
            )

    def _notice_once(self, text: str) -> None:
        if not self._noticed:
            self._noticed = True
            self._middleware.notice(f"domain {self._domain}: {text}")

