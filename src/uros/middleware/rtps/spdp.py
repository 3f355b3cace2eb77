"""Our announcements to participants (SPDP, RTPS 8.5.3): what they say, and when they are due."""

from __future__ import annotations

import dataclasses
from typing import Final

from . import ids, parameters, submessages
from .locators import Locator
from .parameters import ParticipantData

# Milliseconds after which a peer that hears nothing of us counts us as gone.
LEASE_MS: Final = 20_000
# Seconds between announcements: some early ones, at 0.1, 0.2, 0.5 and 1.5 s, as the first may be
# lost, then six in the time of the lease.
_FIRST_PAUSES: Final = (0.1, 0.1, 0.3, 1.0)
_PERIOD: Final = LEASE_MS / 1000 / 6


class ParticipantAnnouncer:
    """Announces one participant.

    Attributes:
        due: When :meth:`advance` is called, with an announcement to all.

    Args:
        data: What is announced.
        now: The time in seconds: the first announcement is due at once.
    """

    def __init__(self, data: ParticipantData, now: float) -> None:
        self.due = now
        self._data = data
        self._number = 0  # of announcements
        self._periods = 0

    def advance(self, now: float) -> None:
        """Set when the next announcement to all is due."""
        count, pauses = self._periods, _FIRST_PAUSES
        self._periods += 1
        self.due = now + (pauses[count] if count < len(pauses) else _PERIOD)

    def move(
        self, unicast: list[Locator], multicast: list[Locator], data: list[Locator], now: float
    ) -> None:
        """Announce other locators from now on, with the first announcement at once."""
        self._data = dataclasses.replace(
            self._data, metatraffic_unicast=unicast, metatraffic_multicast=multicast,
            default_unicast=data,
        )  # fmt: skip
        self._periods = 0
        self.due = now

    def announcement(self) -> bytes:
        """Return a message that announces the participant."""
        return self._message(parameters.write_participant(self._data))

    def farewell(self) -> bytes:
        """Return a message that says that the participant is gone."""
        guid = self._data.guid
        return self._message(
            parameters.write_key(guid), parameters.write_farewell_qos(guid), is_key=True
        )

    def _message(self, payload: bytes, inline_qos: bytes = b"", is_key: bool = False) -> bytes:
        self._number += 1
        prefix = self._data.guid[: ids.PREFIX_SIZE]
        return submessages.header(prefix) + submessages.encode_data(
            ids.SPDP_READER, ids.SPDP_WRITER, self._number, payload, inline_qos, is_key
        )
