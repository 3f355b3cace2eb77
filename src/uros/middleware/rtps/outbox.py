"""Packets of our endpoints on their way into datagrams.

What endpoints send in one turn to one participant shares messages, each of which begins with
INFO_DST (RTPS 8.3.7.7).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from . import ids, submessages
from .changes import Packet
from .locators import Locator
from .remote import RemoteParticipant
from .writer import StatefulWriter, repeat_budget

# Octets of a message, unless the user chooses another size. Wi-Fi loses the fragments of larger IP
# datagrams.
MESSAGE_SIZE: Final = 1400


class Outbox:
    """Collects submessages by where they go, until :meth:`flush`.

    Attributes:
        datagrams: Datagrams to send, each with where to.
        burst: Writers that have written since the last :meth:`flush`.
        repeats: Octets that writers may repeat.

    Args:
        prefix: Our GUID prefix.
        remotes: The participants heard, by GUID prefix; it is not copied.
        message_size: The most octets of a datagram.
    """

    def __init__(
        self, prefix: bytes, remotes: Mapping[bytes, RemoteParticipant], message_size: int
    ) -> None:
        self.datagrams: list[tuple[bytes, Locator]] = []
        self.burst: set[StatefulWriter] = set()
        self.repeats = repeat_budget()
        self._head = submessages.header(prefix)
        self._remotes = remotes
        self._message_size = message_size
        self._pending: dict[tuple[Locator, bytes], list[bytes]] = {}

    def add(self, guid: bytes, octets: bytes) -> None:
        """Queue submessages for a remote endpoint."""
        place = self._place_of(guid)
        if place is not None:
            self._pending.setdefault(place, []).append(octets)

    def add_packets(self, writer: StatefulWriter, packets: Iterable[Packet]) -> None:
        """Queue packets of a writer for the readers that they are for."""
        everybody: list[tuple[Locator, bytes]] | None = None
        for packet in packets:
            if packet.reader is not None:
                place = self._place_of(packet.reader)
                places = [] if place is None else [place]
            else:
                if everybody is None:
                    found = map(self._place_of, writer.readers)
                    everybody = list(dict.fromkeys(place for place in found if place is not None))
                places = everybody
            octets = packet.submessages
            if packet.time_ns is not None:
                octets = submessages.encode_info_ts(packet.time_ns) + octets
            for place in places:
                self._pending.setdefault(place, []).append(octets)

    def _place_of(self, guid: bytes) -> tuple[Locator, bytes] | None:
        """Where a remote endpoint receives, and its participant's prefix."""
        remote = self._remotes.get(guid[: ids.PREFIX_SIZE])
        if remote is None:
            return None
        place = remote.place_of(guid)
        return None if place is None else (place, remote.prefix)

    def forget(self, remote: RemoteParticipant) -> None:
        """Drop what is queued for a participant."""
        for key in [key for key in self._pending if key[1] == remote.prefix]:
            del self._pending[key]

    def flush(self) -> None:
        """Make datagrams of what is queued, with a heartbeat behind each burst of samples."""
        if not self._pending and not self.burst:
            return
        for writer in self.burst:
            self.add_packets(writer, writer.heartbeats_for_burst())
        self.burst.clear()
        pending, self._pending = self._pending, {}
        for (place, prefix), parts in pending.items():
            remote = self._remotes[prefix]
            begin = self._head + submessages.encode_info_dst(prefix)
            messages = [begin]
            for part in parts:
                size = len(messages[-1])
                if size + len(part) > self._message_size and size > len(begin):
                    messages.append(begin)
                messages[-1] += part
            self.datagrams += [
                (message, place) for message in messages if remote.may_send(len(message))
            ]
