"""State of the agent as one JSON object: transports, clients, refused clients.

It is made in the server's thread, in pieces, so that boards are served between them: one with
four thousand clients has megabytes. Texts of clients, such as names, are cut to a length.

``clock_offset`` is the client's own time minus the agent's at its last TIMESTAMP, null before; a C
client sends the time since its start there. ``heard_since_restart`` is false for a client that was
restored from a state file and has sent nothing since. ``rate`` is messages a second, and ``recent``
are counts, over the last ``rate_over`` seconds. ``round_trip`` is the mean time in seconds, in that
time, from the last sending of a message to its acknowledgement, null without one;
``unacknowledged_for`` is the time since the oldest message without one was sent. ``not_after`` is
when the first certificate or list in each file of TLS ends, in seconds since 1970.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ... import names
from ...ticks import ticks_diff
from ...wire import ids
from ..objects.client import ProxyClient
from ..objects.endpoints import WriterEndpoint
from ..objects.kinds import KIND_NAMES, key_label, object_label
from ..objects.object_table import Endpoint, XrceObject
from ..transports.base import ServerTransport
from .readiness import readiness

if TYPE_CHECKING:
    from ..server import Server

VERSION: Final = 1
# The most characters of a name and endpoints of a client in a snapshot: a name may have 64 kB, and
# a client 4096 objects.
MAX_TEXT: Final = 200
MAX_ENDPOINTS: Final = 256
# Rates are over at least so many seconds, and at most twice as many.
RATE_SECONDS: Final = 5.0
# How long the work on a snapshot takes at a time, in seconds, before boards are served.
SLICE: Final = 0.0003
# Ticks wrap around: for longer silences the time of the marks is used.
_TICKS_MS: Final = 3_600_000
_END: Final = object()


class Counts(NamedTuple):
    """The counters of a client, in all or over some time: messages, and their round trips."""

    received: int
    sent: int
    lost: int
    given_up: int
    resent: int
    dropped: int
    acknowledged: int
    round_trips_ms: int


class _Mark(NamedTuple):
    """The counters of a client at a time."""

    born: float
    when: float
    counts: Counts
    heard: int
    heard_at: float  # seconds of the monotonic clock, approximate


_NONE: Final = Counts(0, 0, 0, 0, 0, 0, 0, 0)


def _counts(client: ProxyClient) -> Counts:
    session = client.session
    return Counts(
        session.received, session.sent, session.lost, session.given_up, session.resent,
        session.dropped, session.acknowledged, session.round_trips_ms,
    )  # fmt: skip


# A session begins with a burst of CREATE messages, which no rate includes; and the shortest time of
# a rate.
_CREATING_SECONDS: Final = 1.0
_LEAST_SECONDS: Final = 1.0


class Rates:
    """Records the counters of all clients every :data:`RATE_SECONDS`."""

    def __init__(self, clients: dict[int, ProxyClient]) -> None:
        self._clients = clients
        self._before: dict[int, _Mark] = {}
        self._last: dict[int, _Mark] = {}

    def mark(self, now: float) -> None:
        """Record the counters; the ones before are kept too."""
        marks = {}
        for key, client in self._clients.items():
            session = client.session
            old = self._last.get(key)
            same = old is not None and old.born == client.born and old.heard == session.heard
            heard_at = old.heard_at if same and old is not None else now
            marks[key] = _Mark(client.born, now, _counts(client), session.heard, heard_at)
        self._before, self._last = self._last, marks

    def recent(self, client: ProxyClient, now: float) -> tuple[Counts, float]:
        """Return what was counted lately, and over how many seconds."""
        since, before = client.born, _NONE
        # The longer time first; a client without a mark is younger.
        for mark in (self._before.get(client.key), self._last.get(client.key)):
            if (
                mark is not None
                and mark.born == client.born
                and mark.when - client.born >= _CREATING_SECONDS
                and now - mark.when >= _LEAST_SECONDS
            ):
                since, before = mark.when, mark.counts
                break
        counts = (now - then for now, then in zip(_counts(client), before, strict=True))
        return Counts(*counts), max(now - since, 1e-3)

    def heard_ago(self, client: ProxyClient, now: float, ticks: int) -> float:
        """Return the seconds since the last message of the client."""
        mark = self._last.get(client.key)
        if mark is not None and mark.born == client.born and mark.heard == client.session.heard:
            ago = now - mark.heard_at
            if ago * 1000 > _TICKS_MS:
                return ago
        return max(0, ticks_diff(ticks, client.session.heard)) / 1000


def cut(text: str) -> str:
    """Cut a text of a client to :data:`MAX_TEXT` characters."""
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."


def pieces(server: Server, rates: Rates | None = None) -> Iterator[str]:
    """Yield the JSON of a snapshot as one line, a piece for each client.

    Without ``rates``, rates are over a client's life.
    """
    agent = server.agent
    rates = rates or Rates(agent.clients)
    ready, problems = readiness(server)
    now = agent.clock.monotonic()
    judged = {
        "config": server.config_file or None,
        "ready": ready,
        "problems": [cut(problem) for problem in problems],
        "refusals": [
            {
                "kind": kind,
                "rule": rule,
                "times": agent.refusals.counts[kind, rule],
                "address": cut(latest.address),
                "why": cut(latest.why),
                "ago": round(now - latest.when, 3),
            }
            for (kind, rule), latest in agent.refusals.latest.items()
        ],
    }
    yield _text({**head(server), **judged})[:-1] + ',"clients":['
    comma = ""
    for key in list(agent.clients):
        client = agent.clients.get(key)
        if client is not None:  # otherwise it left meanwhile
            yield comma + _text(_client(server, client, rates))
            comma = ","
    yield '],"refused":' + _text(refused(server)) + "}\n"


def snapshot(server: Server) -> dict[str, Any]:
    """Make a snapshot at once, for callers that may keep boards waiting."""
    content: dict[str, Any] = json.loads("".join(pieces(server)))
    return content


def gather(server: Server, done: Callable[[str], None], is_wanted: Callable[[], bool]) -> None:
    """Make a snapshot in the server's thread while boards are served; pass its JSON to ``done``.

    It stops once ``is_wanted`` returns False.
    """

    def steps() -> Iterator[None]:
        texts = []
        for piece in pieces(server):
            texts.append(piece)
            yield
        done("".join(texts))

    run_in_slices(server, steps(), is_wanted)


def run_in_slices(server: Server, steps: Iterator[None], is_wanted: Callable[[], bool]) -> None:
    """Run an iterator to its end in the server's thread while boards are served.

    It stops once ``is_wanted`` returns False.
    """
    monotonic = server.clock.monotonic

    def work() -> None:
        end = monotonic() + SLICE
        while is_wanted():
            if next(steps, _END) is _END:
                return
            if monotonic() >= end:
                server.wake_at(0.0, work)
                return

    work()


def _text(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


def head(server: Server) -> dict[str, Any]:
    """Return the state of the agent itself."""
    agent = server.agent
    return {
        "version": VERSION,
        "pid": os.getpid(),
        "uptime": round(agent.clock.monotonic() - server.started, 3),
        "middleware": agent.middleware.name,
        "rss": resident_bytes(),
        "cpu": round(agent.clock.process_time(), 3),
        "fds": descriptors(),
        "limits": dataclasses.asdict(agent.limits),
        "max_clients": agent.admission.max_clients,
        "memory_full": agent.budget.full,
        "transports": [_transport(transport) for transport in server.transports],
    }


def refused(server: Server) -> list[dict[str, Any]]:
    """Return the clients that were refused, the latest last."""
    now = server.agent.clock.monotonic()
    return [
        {
            "key": key_label(key), "why": cut(refusal.why), "address": cut(refusal.address),
            "times": refusal.times, "ago": round(now - refusal.when, 3),
        }
        for key, refusal in list(server.agent.refusals.items())
    ]  # fmt: skip


def _transport(transport: ServerTransport) -> dict[str, Any]:
    return {
        "name": transport.name,
        "kind": transport.kind,
        "label": cut(transport.label()),
        "not_after": transport.not_after(),
        **transport.counters(),
    }


def _client(server: Server, client: ProxyClient, rates: Rates) -> dict[str, Any]:
    entry = board(server, client, rates)
    with_endpoints = [obj for obj in client.objects.values() if obj.endpoint is not None]
    entry["endpoints"] = [
        _endpoint(obj, obj.endpoint)
        for obj in with_endpoints[:MAX_ENDPOINTS]
        if obj.endpoint is not None
    ]
    if len(with_endpoints) > MAX_ENDPOINTS:
        entry["endpoints_left_out"] = len(with_endpoints) - MAX_ENDPOINTS
    return entry


def board(server: Server, client: ProxyClient, rates: Rates) -> dict[str, Any]:
    """Return the state of a client without its endpoints."""
    agent, session = server.agent, client.session
    transport, peer = agent.place(client.key)
    now, ticks = agent.clock.monotonic(), agent.now()
    recent, over = rates.recent(client, now)
    unacknowledged, stalled, early, fragments = session.queues()
    return {
        "key": key_label(client.key),
        "session_id": f"0x{session.session_id:02X}",
        "transport": transport.name,
        "address": cut(transport.address(peer)),
        "mtu": session.mtu,
        "age": round(now - client.born, 3),
        "heard_ago": round(rates.heard_ago(client, now, ticks), 3),
        "heard_since_restart": client.resumed_at != session.heard,
        "line_lost": transport.is_away(peer),
        "unanswered": agent.liveliness.is_unanswered(client),
        "nodes": [
            {"name": cut(obj.named[0]), "domain": int(obj.named[1])}
            for obj in client.objects.values()
            if obj.kind == ids.KIND_PARTICIPANT and obj.node is not None
        ],
        "objects": Counter(KIND_NAMES[obj.kind] for obj in client.objects.values()),
        "refused_objects": {object_label(key): cut(why) for key, why in client.refused.items()},
        "held": client.held(),
        "received": {
            "messages": session.received, "bytes": session.received_bytes, "lost": session.lost,
            "given_up": session.given_up, "rate": round(recent.received / over, 2),
        },
        "sent": {
            "messages": session.sent, "bytes": session.sent_bytes, "resent": session.resent,
            "dropped": session.dropped, "rate": round(recent.sent / over, 2),
        },
        "recent": recent._asdict(),
        "rate_over": round(over, 3),
        "round_trip": round(recent.round_trips_ms / recent.acknowledged / 1000, 4)
        if recent.acknowledged
        else None,
        "unacknowledged_for": session.unacknowledged_ms(ticks) / 1000,
        "queues": {
            "unacknowledged": unacknowledged, "stalled": stalled, "early": early,
            "fragments": fragments,
        },
        "clock_offset": client.clock_offset,
    }  # fmt: skip


def _endpoint(obj: XrceObject, endpoint: Endpoint) -> dict[str, Any]:
    topic, type_name = obj.named
    if obj.kind in (ids.KIND_REQUESTER, ids.KIND_REPLIER):
        shown = names.service_from_request(topic) or topic
        type_name = names.service_type_from_dds(type_name)
    else:
        shown = names.topic_from_dds(topic) or topic
        type_name = names.type_from_dds(type_name)
    return {
        "object": object_label(obj.object_id),
        "kind": KIND_NAMES[obj.kind],
        "topic": cut(shown),
        "type": cut(type_name),
        "samples": endpoint.written if isinstance(endpoint, WriterEndpoint) else endpoint.taken,
    }


def resident_bytes() -> int | None:
    """Return the resident memory of this process in bytes; None if it is unknown."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return None


def descriptors() -> int | None:
    """Return the number of open descriptors of this process; None if it is unknown."""
    try:
        return len(os.listdir("/proc/self/fd")) - 1  # one of them is that of listdir
    except OSError:
        return None
