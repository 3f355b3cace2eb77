"""What is known of another participant: what it announces, and where it may be sent to.

Nothing that a peer announces is believed beyond what can be checked: datagrams are sent only to
addresses that the peer was heard from, or that the user configured.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from . import ids
from .locators import UDPV4, UDPV6, Locator
from .parameters import EndpointData, ParticipantData

# Attack: a participant that never leaves. The longest lease that is believed, in ms.
MAX_LEASE_MS: Final = 600_000
# Attack: a participant that comes and goes with each announcement.
_MIN_LEASE_MS: Final = 100


def lease(data: ParticipantData) -> float:
    """Return the lease of a participant in seconds, within the limit."""
    if data.lease_ms is None:
        return MAX_LEASE_MS / 1000
    return max(_MIN_LEASE_MS, min(data.lease_ms, MAX_LEASE_MS)) / 1000


# Attack: a participant that announces other addresses again and again. A machine has some
# interfaces, each with some addresses.
MAX_ADDRESSES: Final = 32
# What a participant and an endpoint cost besides the octets of their announcements.
_OVERHEAD: Final = 2048


def cost(data: ParticipantData | EndpointData) -> int:
    """Return about how many octets it takes to know a participant or an endpoint."""
    if isinstance(data, ParticipantData):
        places = len(data.metatraffic_unicast) + len(data.metatraffic_multicast)
        places += len(data.default_unicast) + len(data.default_multicast)
        return 2 * _OVERHEAD + 200 * places + len(data.user_data)
    texts = sum(map(len, (data.topic, data.type_name, *data.qos.partitions)))
    places = len(data.unicast) + len(data.multicast) + len(data.qos.partitions)
    return _OVERHEAD + 200 * places + texts + len(data.qos.user_data)


class RemoteEndpoints:
    """The endpoints of others by topic: one of ours must not take longer to create with many."""

    def __init__(self) -> None:
        self._by_topic: dict[str, dict[bytes, EndpointData]] = {}

    def add(self, endpoint: EndpointData) -> None:
        """Add an endpoint, or replace what was announced of it before, of the same topic."""
        self._by_topic.setdefault(endpoint.topic, {})[endpoint.guid] = endpoint

    def remove(self, endpoint: EndpointData) -> None:
        """Remove an endpoint that was added."""
        same_topic = self._by_topic[endpoint.topic]
        del same_topic[endpoint.guid]
        if not same_topic:
            del self._by_topic[endpoint.topic]

    def counterparts(self, ours: EndpointData) -> list[EndpointData]:
        """Return the readers of a writer's topic, or the writers of a reader's."""
        same_topic = self._by_topic.get(ours.topic, {}).values()
        return [theirs for theirs in same_topic if theirs.is_writer != ours.is_writer]


class RemoteParticipant:
    """A participant that was heard.

    Attributes:
        prefix: Its GUID prefix.
        data: What it announces of itself; see :meth:`announce`.
        heard: The addresses that it was heard from, the first one first.
        lease: Seconds without a sign of life after which it is gone.
        since: When it was heard first.
        expires: When it counts as gone.
        endpoints: Its endpoints by GUID; see :meth:`add` and :meth:`remove`.
        answers_to: Where its readers want answers, by GUID, if not at their locators (INFO_REPLY);
            see :meth:`answer_to`.
        received: Octets that came from it.
        announced_at: When we announced ourselves to it alone.
        is_proven: Whether it has answered us, and so receives what is sent to its address.
        lacks_announcement: Whether an announcement of ours was longer than what has come from it:
            then it gets nothing else.
        introductions: Announcements of ours to it alone, since it was last sent what was left out.
        left_out: Octets of the last message that it was not sent; see :meth:`may_send`. 0: none.
    """

    def __init__(self, data: ParticipantData, now: float) -> None:
        self.prefix = data.guid[: ids.PREFIX_SIZE]
        self.data = data
        self.since = now
        self.heard: dict[str, None] = {}
        self.lease = lease(data)
        self.expires = now + self.lease
        self.endpoints: dict[bytes, EndpointData] = {}
        self.answers_to: dict[bytes, tuple[Locator, ...]] = {}
        self.received = 0
        self.announced_at = now
        self.is_proven = False
        self.lacks_announcement = False
        self.introductions = 0
        self.left_out = 0
        self._sent = 0  # octets, until it is proven
        # What place_of() has found, by GUID: it is asked for each sample.
        self._places: dict[bytes, Locator | None] = {}

    def next_deadline(self) -> float:
        """Return when it counts as gone."""
        return self.expires

    def may_send(self, octets: int) -> bool:
        """Count octets to be sent; return whether they may.

        Attack: announcements with the address of somebody else. Until a participant has answered,
        it gets no more octets than came from it; the protocol repeats what was left out, and
        :meth:`may_resume` tells when.
        """
        if self.is_proven or (not self.lacks_announcement and self._take(octets)):
            return True
        self.left_out = octets
        return False

    def may_resume(self) -> bool:
        """Return, once, whether what was left out may be sent by now."""
        if not self.left_out or self.lacks_announcement:
            return False
        if not self.is_proven and self._sent + self.left_out > self.received:
            return False
        self.left_out = self.introductions = 0
        return True

    def may_announce(self, octets: int) -> bool:
        """Return the same for an announcement of ours, without which it cannot answer."""
        self.lacks_announcement = not (self.is_proven or self._take(octets))
        self.introductions += not self.lacks_announcement
        return not self.lacks_announcement

    def _take(self, octets: int) -> bool:
        if self._sent + octets > self.received:
            return False
        self._sent += octets
        return True

    def announce(self, data: ParticipantData) -> None:
        """Note what it announces of itself now."""
        self.data = data
        self._places.clear()

    def add(self, endpoint: EndpointData) -> None:
        """Add an endpoint, or replace what was announced of it before."""
        self.endpoints[endpoint.guid] = endpoint
        self._places.pop(endpoint.guid, None)

    def remove(self, guid: bytes) -> EndpointData | None:
        """Remove an endpoint; return it, or None if there is none."""
        self.answers_to.pop(guid, None)
        self._places.pop(guid, None)
        return self.endpoints.pop(guid, None)

    def answer_to(self, guid: bytes, places: tuple[Locator, ...]) -> None:
        """Note where a reader wants answers; empty: at its locators."""
        if self.answers_to.get(guid, ()) == places:
            return
        self._places.pop(guid, None)
        if places:
            self.answers_to[guid] = places
        else:
            del self.answers_to[guid]

    def hear(self, source: str) -> None:
        """Note an address that it was heard from."""
        if source in self.heard:
            return
        self.heard[source] = None
        self._places.clear()
        if len(self.heard) > MAX_ADDRESSES:
            del self.heard[next(iter(self.heard))]

    def is_from(self, source: str) -> bool:
        """Return whether an address is one that it was heard from, or announces."""
        if source in self.heard:
            return True
        data = self.data
        host = source.partition("%")[0]  # nobody announces the number of an interface here
        return any(
            locator.address == host
            for locator in (*data.metatraffic_unicast, *data.default_unicast)
        )

    def place(self, announced: Iterable[Locator]) -> Locator | None:
        """Return the first of the announced locators at an address that it was heard from.

        A participant behind a translation of addresses announces none of those: then it is the
        announced port at the address that was heard. A link-local address of IPv6 is announced
        without the interface that it was heard on.
        """
        announced = list(announced)
        for locator in announced:
            if locator.address in self.heard:  # nothing is heard from a multicast address
                return locator
        announced = [locator for locator in announced if not locator.is_multicast]
        for address in self.heard:
            host, kind = address.partition("%")[0], UDPV6 if ":" in address else UDPV4
            same = [locator for locator in announced if locator.kind == kind]
            if same:
                found = next((locator for locator in same if locator.address == host), same[0])
                return found._replace(address=address)
        return None

    def discovery_place(self) -> Locator | None:
        """Return where it receives announcements."""
        return self.place(self.data.metatraffic_unicast)

    def leave_address(self, address: str) -> None:
        """Send no longer to an address, if it was heard from another one too."""
        if len(self.heard) > 1:
            self.heard.pop(address, None)
            self._places.clear()

    def place_of(self, guid: bytes) -> Locator | None:
        """Return where one of its endpoints receives; builtin ones by their participant."""
        try:
            return self._places[guid]
        except KeyError:
            pass
        endpoint = self.endpoints.get(guid)
        if guid in self.answers_to:
            announced: Iterable[Locator] = self.answers_to[guid]
        elif endpoint is None:
            announced = self.data.metatraffic_unicast
        else:
            announced = endpoint.unicast or self.data.default_unicast
        place = self._places[guid] = self.place(announced)
        return place
