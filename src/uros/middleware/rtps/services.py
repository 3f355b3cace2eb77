"""Service clients and servers, towards each peer in the form that it speaks.

rmw_fastrtps, and most others, put the identity of a request into inline QoS (RPC over DDS 7.8.2,
"enhanced" mapping): a request carries the GUID of the reader that waits for the reply, a reply that
GUID and the sequence number of the request's DATA. rmw_cyclonedds puts a header before the body and
announces ``clientid=…`` or ``serviceid=…``, the same value on both endpoints of a client or server.
One writer serves both kinds, each matched reader in its form; one reader parses by the writer.
"""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Final

from ...qos import QoSProfile
from ..base import OnReady, Replier, Requester, Service
from ..guid import FAST_DDS
from ..services import request_header
from ..services.form import CLIENT_ID, SERVICE_ID, uses_request_header
from . import ids
from .domain import RtpsDomain
from .endpoints import RtpsReader, RtpsWriter
from .parameters import EndpointData
from .reader import Sample

# SEQUENCENUMBER_UNKNOWN: in a request, whose own number is that of its DATA (9.3.2.3).
_UNKNOWN: Final = -1 << 32
# Attack: requests whose reply reader never matches. Replies that wait, and for how many seconds.
MAX_WAITING: Final = 256
_MAX_WAITING_OCTETS: Final = 16 * 1024 * 1024
_PATIENCE: Final = 10.0
# Requests, or replies, that an endpoint holds even with a smaller depth: they come in bursts, and
# are taken one by one.
MIN_DEPTH: Final = 256
# Attack: samples that are not for us, as fast as they can be sent. Takes in a row that may bring
# nothing; the rest is taken in a later turn.
_MAX_MISSES: Final = 4


def _uses_header(role: bytes, data: EndpointData) -> bool:
    return uses_request_header(data.guid, data.qos.user_data, role)


class _Parser:
    """Reads requests or replies by the form of their writers."""

    def __init__(self, domain: RtpsDomain, role: bytes) -> None:
        self._domain = domain
        self._role = role

    def parse(self, sample: Sample) -> tuple[bytes, int, bytes] | None:
        """Return (identity, sequence number, sample); None for a sample without an identity.

        The identity is the client's id and eight zeros where it stood in a header, else a GUID.
        """
        payload = sample.payload or b""
        remote = self._domain.participant.remotes.get(sample.writer[: ids.PREFIX_SIZE])
        endpoint = None if remote is None else remote.endpoints.get(sample.writer)
        if endpoint is not None and _uses_header(self._role, endpoint):
            parsed = request_header.remove(payload)
            if parsed is None:
                return None
            client_id, sequence, body = parsed
            return client_id + bytes(8), sequence, body
        related = None if sample.inline_qos is None else sample.inline_qos.related
        if related is None:
            if not sample.writer.startswith(FAST_DDS):
                return None
            related = sample.writer, _UNKNOWN
        guid, number = related
        return guid, sample.number if number < 1 else number, payload


class RtpsRequester(Requester):
    """A service client.

    Args:
        domain: The domain.
        service: The service.
        qos: The profile of both endpoints, with ``clientid=…`` in its USER_DATA.
        on_ready: Called by a dispatch after replies have come.
    """

    __slots__ = ("_client_id", "_identities", "_parser", "_reader", "_related", "_writer")

    def __init__(
        self, domain: RtpsDomain, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        self._client_id = os.urandom(8)
        self._parser = _Parser(domain, SERVICE_ID)
        self._reader = RtpsReader(domain, service.reply_topic, service.reply_type, qos, on_ready)
        try:
            self._writer = RtpsWriter(
                domain, service.request_topic, service.request_type, qos,
                lambda data: _uses_header(SERVICE_ID, data),
            )  # fmt: skip
        except BaseException:
            self._reader.close()
            raise
        self._related = self._reader.guid, _UNKNOWN  # of all requests
        # Who a reply may be for; see _Parser.parse.
        self._identities = (self._reader.guid, self._writer.guid, self._client_id + bytes(8))

    @property
    def endpoints(self) -> tuple[RtpsWriter, RtpsReader]:
        """Its writer and its reader."""
        return self._writer, self._reader

    def servers(self) -> int:
        """Return how many servers match both endpoints."""
        servers = self._writer.local.state.readers
        answering = {guid[: ids.PREFIX_SIZE] for guid in self._reader.local.state.writers}
        remote = sum(guid[: ids.PREFIX_SIZE] in answering for guid in servers)
        return remote + len(self._writer.readers)

    def again(self) -> None:
        """Have ``on_ready`` called again, after others."""
        self._reader.again()

    def request(self, cdr: bytes | bytearray | memoryview) -> int | None:
        """Send a request; its sequence number, or None where there is no room.

        Raises:
            MiddlewareError: It is big endian, and a server wants the header.
        """
        payload = bytes(cdr)
        sequence = self._writer.local.state.last + 1
        header = None
        if payload[1] & 1 or self._wants_header():
            header = request_header.insert(payload, self._client_id, sequence)
        if not self._writer.write_related(payload, self._related, None, header):
            return None
        return sequence

    def _wants_header(self) -> bool:
        """Whether a matched server would read a request without the header wrongly."""
        for proxy in self._writer.local.state.readers.values():  # without a generator
            if proxy.wants_header:
                return True
        return False

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take replies to own requests."""
        replies: list[tuple[int, bytes]] = []
        for _ in range(_MAX_MISSES):
            wanted = limit - len(replies)
            taken = self._reader.take_samples(wanted)
            for sample in taken:
                parsed = self._parser.parse(sample)
                if parsed is not None and parsed[0] in self._identities:
                    replies.append(parsed[1:])
            if len(taken) < wanted or len(replies) == limit:
                return replies
        self.again()
        return replies

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Delete both endpoints; idempotent."""
        self._writer.close()
        self._reader.close()


class RtpsReplier(Replier):
    """A service's server.

    rmw_fastrtps counts a service as available where it has as many request readers as reply
    writers: the writer is created first, and both are deleted together.

    Args:
        domain: The domain.
        service: The service.
        qos: The profile of both endpoints, with ``serviceid=…`` in its USER_DATA.
        on_ready: Called by a dispatch after requests have come.
    """

    __slots__ = ("_domain", "_parser", "_reader", "_waiting", "_writer")

    def __init__(
        self, domain: RtpsDomain, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        self._domain = domain
        self._parser = _Parser(domain, CLIENT_ID)
        # Replies whose reader has not matched yet: (reader, sequence, sample, until when).
        self._waiting: deque[tuple[bytes, int, bytes, float]] = deque(maxlen=MAX_WAITING)
        self._writer = RtpsWriter(
            domain, service.reply_topic, service.reply_type, qos,
            lambda data: _uses_header(CLIENT_ID, data),
        )  # fmt: skip
        self._writer.local.on_match = self._on_match
        self._writer.local.on_leave = self._on_leave
        try:
            self._reader = RtpsReader(
                domain, service.request_topic, service.request_type, qos, on_ready
            )
        except BaseException:
            self._writer.close()
            raise

    @property
    def endpoints(self) -> tuple[RtpsWriter, RtpsReader]:
        """Its writer and its reader."""
        return self._writer, self._reader

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take requests, each with its client's identity."""
        requests: list[tuple[bytes, int, bytes]] = []
        for _ in range(_MAX_MISSES):
            wanted = limit - len(requests)
            taken = self._reader.take_samples(wanted)
            parsed = [self._parser.parse(sample) for sample in taken]
            requests += [request for request in parsed if request is not None]
            if len(taken) < wanted or len(requests) == limit:
                return requests
        self._reader.again()
        return requests

    def reply(self, guid: bytes, sequence: int, cdr: bytes | bytearray | memoryview) -> bool:
        """Send a reply; False where there is no room.

        rmw_fastrtps drops a reply that comes before its reader and our writer know each other: such
        a reply waits for the match.
        """
        payload = bytes(cdr)
        if guid[8:] == bytes(8):  # a client's id, for all that want the header
            proxies = self._writer.local.state.readers.values()
            readers = frozenset(proxy.guid for proxy in proxies if proxy.wants_header)
            header = request_header.insert(payload, guid[:8], sequence)
            return self._writer.write_related(payload, None, readers, header)
        if guid not in self._known_readers() and self._is_reader(guid):
            now = time.monotonic()
            while self._waiting and self._waiting[0][3] <= now:
                self._waiting.popleft()
            self._waiting.append((guid, sequence, payload, now + _PATIENCE))
            while sum(len(reply[2]) for reply in self._waiting) > _MAX_WAITING_OCTETS:
                self._waiting.popleft()
            return True
        return self._write(guid, sequence, payload)

    def _known_readers(self) -> set[bytes]:
        """The readers of replies that have matched, in this process and in others."""
        found = {reader.guid for reader in self._writer.readers}
        found.update(self._writer.local.state.readers)
        return found

    def _is_reader(self, guid: bytes) -> bool:
        return guid[-1] & 0x3F == ids.KIND_READER_NO_KEY

    def _write(self, guid: bytes, sequence: int, payload: bytes) -> bool:
        readers = frozenset([guid])
        if not self._is_reader(guid):  # a client that gave its writer: all of its participant
            prefix = guid[: ids.PREFIX_SIZE]
            readers = frozenset(
                known for known in self._known_readers() if known.startswith(prefix)
            )
        return self._writer.write_related(payload, (guid, sequence), readers, None)

    def _on_match(self, guid: bytes) -> None:
        """Send the replies that have waited for a reader; drop those that waited too long."""
        now = time.monotonic()
        waiting, self._waiting = self._waiting, deque(maxlen=MAX_WAITING)
        for reply in waiting:
            reader, sequence, payload, until = reply
            if until <= now:
                continue
            if reader == guid:
                self._write(reader, sequence, payload)
            else:
                self._waiting.append(reply)

    def _on_leave(self, guid: bytes) -> None:
        """Drop the replies that wait for a reader, or for those of a participant."""
        if self._waiting:
            kept = [reply for reply in self._waiting if not reply[0].startswith(guid)]
            self._waiting = deque(kept, maxlen=MAX_WAITING)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Delete both endpoints; idempotent."""
        self._waiting.clear()
        self._writer.close()
        self._reader.close()
