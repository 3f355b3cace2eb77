"""Our announcements to participants (SPDP, RTPS 8.5.3): what they say, and when they are due."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Final

from . import ids, parameters, submessages
from .locators import Locator
from .parameters import ParticipantData
from .remote import RemoteParticipant

# Milliseconds after which a peer that hears nothing of us counts us as gone.
LEASE_MS: Final = 20_000
# Seconds between announcements: some early ones, at 0.1, 0.2, 0.5 and 1.5 s, as the first may be
# lost, then six in the time of the lease.
_FIRST_PAUSES: Final = (0.1, 0.1, 0.3, 1.0)
_PERIOD: Final = LEASE_MS / 1000 / 6
# Seconds between announcements to a participant that was heard: two of them before our lease ends.
_DIRECTED_PERIOD: Final = LEASE_MS / 3000
# Seconds for which a participant gets nothing before an announcement of ours that is longer than
# what has come from it: it announces itself several times at first.
_INTRODUCTION: Final = 0.5
# Fast DDS announces itself a moment before it handles what comes, so our answer may be lost. One
# that announces itself again and has not answered gets another one, after so many seconds.
_ANSWER_PAUSE: Final = 0.05
# How many introductions in a row may keep all else from one that does not answer.
_IN_A_ROW: Final = 2

Datagrams = list[tuple[bytes, Locator]]


class ParticipantAnnouncer:
    """Announces one participant.

    Datagrams are returned, each with where to.

    Attributes:
        due: When :meth:`announce` is due.

    Args:
        data: What is announced.
        peers: Places to announce to, besides the multicast groups.
        now: The time in seconds: the first announcement is due at once.
    """

    def __init__(self, data: ParticipantData, peers: list[Locator], now: float) -> None:
        self.due = now
        self._data = data
        self._peers = peers
        self._number = 0  # of announcements
        self._periods = 0

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

    def announce(self, remotes: Iterable[RemoteParticipant], now: float) -> Datagrams:
        """Announce the participant to all, and now and then to each that was heard.

        Some are beyond the reach of multicast, and no peers of ours: they have us as a peer.
        """
        count, pauses = self._periods, _FIRST_PAUSES
        self._periods += 1
        self.due = now + (pauses[count] if count < len(pauses) else _PERIOD)
        message = self.announcement()
        places = self._all_places()
        for remote in remotes:
            remote.lacks_announcement &= now - remote.since < _INTRODUCTION
            if now - remote.announced_at < _DIRECTED_PERIOD:
                continue
            place = remote.discovery_place()
            if place is not None and place not in places and remote.may_send(len(message)):
                remote.announced_at = now
                places[place] = None
        return [(message, place) for place in places]

    def introduce(self, remote: RemoteParticipant, now: float) -> Datagrams:
        """Announce the participant to one that is new: it need not wait for the next time."""
        place = remote.discovery_place()
        if place is None:
            return []
        message = self.announcement()
        if not remote.may_announce(len(message)):
            return []
        remote.announced_at = now
        return [(message, place)]

    def answer(self, remote: RemoteParticipant, now: float) -> Datagrams:
        """Introduce the participant again to one that has announced itself again, if need be.

        One that knows us since before, while we have forgotten it, does not answer introductions.
        It answers what they leave no octets for, so that comes first after some of them.
        """
        is_unanswered = not remote.is_proven and now - remote.announced_at >= _ANSWER_PAUSE
        if not (remote.lacks_announcement or is_unanswered):
            return []
        if remote.left_out and not remote.lacks_announcement and remote.introductions >= _IN_A_ROW:
            return []
        return self.introduce(remote, now)

    def leave(self, remotes: Iterable[RemoteParticipant]) -> Datagrams:
        """Say farewell to all."""
        message = self.farewell()
        places = self._all_places()
        for remote in remotes:
            place = remote.discovery_place()
            if place is not None and remote.may_send(len(message)):
                places[place] = None
        return [(message, place) for place in places]

    def give_up(self, remote: RemoteParticipant) -> Datagrams:
        """Say farewell to a participant whose lease has ended.

        It may have been stopped, and go on. Fast DDS would then count as received what we have
        acknowledged before, and not send it again: it has to discover us anew too. If it has
        ended, another may be at its place by now: the farewell is for this one alone.
        """
        message = self.farewell(remote.prefix)
        place = remote.discovery_place()
        return [(message, place)] if place is not None and remote.is_proven else []

    def _all_places(self) -> dict[Locator, None]:
        return dict.fromkeys([*self._data.metatraffic_multicast, *self._peers])

    def announcement(self) -> bytes:
        """Return a message that announces the participant."""
        return self._message(parameters.write_participant(self._data))

    def farewell(self, to: bytes = ids.NO_PREFIX) -> bytes:
        """Return a message that says that the participant is gone.

        Args:
            to: The prefix of the only participant that it is for; by default it is for all.
        """
        guid = self._data.guid
        return self._message(
            parameters.write_key(guid), parameters.write_farewell_qos(guid), is_key=True, to=to
        )

    def _message(
        self, payload: bytes, inline_qos: bytes = b"", is_key: bool = False,
        to: bytes = ids.NO_PREFIX,
    ) -> bytes:  # fmt: skip
        self._number += 1
        head = submessages.header(self._data.guid[: ids.PREFIX_SIZE])
        if to != ids.NO_PREFIX:
            head += submessages.encode_info_dst(to)
        return head + submessages.encode_data(
            ids.SPDP_READER, ids.SPDP_WRITER, self._number, payload, inline_qos, is_key
        )
