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
        datagrams: Datagrams to send, each with where to; see :meth:`take`.
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
        self._begins: dict[bytes, bytes] = {}  # of messages, by GUID prefix

    @property
    def is_empty(self) -> bool:
        """Whether :meth:`flush` has nothing to do, and there is no datagram."""
        return not (self._pending or self.burst or self.datagrams)

    def add(self, guid: bytes, octets: bytes) -> None:
        """Queue submessages for a remote endpoint."""
        remote = self._remotes.get(guid[: ids.PREFIX_SIZE])
        place = None if remote is None else remote.place_of(guid)
        if remote is not None and place is not None:
            self._pending.setdefault((place, remote.prefix), []).append(octets)

    def add_packets(self, writer: StatefulWriter, packets: Iterable[Packet]) -> None:
        """Queue packets of a writer for the readers that they are for."""
        for reader, octets, time_ns in packets:
            if time_ns is not None:
                octets = submessages.encode_info_ts(time_ns) + octets
            if reader is not None:
                self.add(reader, octets)
            else:
                self.add_for_all(writer, octets)

    def add_for_all(self, writer: StatefulWriter, octets: bytes) -> None:
        """Queue submessages for all readers of a writer."""
        pending = self._pending
        for guid in writer.readers:
            remote = self._remotes.get(guid[: ids.PREFIX_SIZE])
            place = None if remote is None else remote.place_of(guid)
            if remote is None or place is None:
                continue
            key = place, remote.prefix
            parts = pending.get(key)
            if parts is None:
                pending[key] = [octets]
            elif parts[-1] is not octets:  # readers of one participant share a message
                parts.append(octets)

    def forget(self, remote: RemoteParticipant) -> None:
        """Drop what is queued for a participant."""
        self._begins.pop(remote.prefix, None)
        for key in [key for key in self._pending if key[1] == remote.prefix]:
            del self._pending[key]

    def take(self) -> list[tuple[bytes, Locator]]:
        """Return the datagrams to send, those of what is queued included."""
        if self._pending or self.burst:
            self.flush()
        datagrams, self.datagrams = self.datagrams, []
        return datagrams

    def flush(self) -> None:
        """Make datagrams of what is queued, with a heartbeat behind each burst of samples."""
        for writer in self.burst:
            self.add_packets(writer, writer.heartbeats_for_burst())
        self.burst.clear()
        pending, self._pending = self._pending, {}
        for (place, prefix), parts in pending.items():
            remote = self._remotes[prefix]
            begin = self._begins.get(prefix)
            if begin is None:
                begin = self._begins[prefix] = self._head + submessages.encode_info_dst(prefix)
            message = begin
            for part in parts:
                if len(message) + len(part) > self._message_size and message is not begin:
                    if remote.is_proven or remote.may_send(len(message)):
                        self.datagrams.append((message, place))
                    message = begin
                message += part
            if remote.is_proven or remote.may_send(len(message)):
                self.datagrams.append((message, place))
