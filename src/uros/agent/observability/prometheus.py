"""``--metrics``: the agent's counters for Prometheus and its health, over HTTP.

Threads serve HTTP (:mod:`uros.http_server`). For each scrape one requests a snapshot from the
server's thread, which makes it while boards are served, and converts it to metrics. Boards have the
label ``key``; those beyond the first :data:`MAX_SERIES` share ``key="other"``, because each label
is a series that Prometheus keeps for weeks.
"""

from __future__ import annotations

import errno
import json
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final

from ... import __version__
from ...http_server import Handler, HttpServer
from ...printable import printable
from ..log import unexpected
from ..policy.admission import RULES
from ..transports.base import ERROR, INFO, TransportError
from ..transports.ip import address_trouble, bind_trouble, text_of
from .readiness import Readiness, readiness
from .snapshot import gather

if TYPE_CHECKING:
    from prometheus_client import Metric

    from ..server import Server

# The most boards with a label of their own. Otherwise boards that change their keys would create
# endless series.
MAX_SERIES: Final = 200
OTHER: Final = "other"
# The most scrapes that are answered at a time; others wait.
MAX_SCRAPES: Final = 4
# Timeout of a snapshot, in seconds: the agent may hang in its middleware.
PATIENCE: Final = 2.0
# Pause between metrics, which lets the server's thread have the GIL: two hundred boards take some
# ten milliseconds. In seconds.
_BREATH: Final = 0.0005
# Paths of the health: does the agent's thread run, and can a board connect.
HEALTH: Final = "/healthz"
READY: Final = "/readyz"
_BUSY: Final = b"the agent is busy: its log may have the reason\n"
_WRONG_HOST: Final = (
    "use this machine's address, such as http://127.0.0.1, or the name that the agent was"
    " started with: --metrics NAME:PORT\n"
)
_NOT_INSTALLED: Final = (
    "--metrics needs prometheus_client, which is not installed: python -m pip install"
    " prometheus_client"
)

# (name, description, counter or gauge, path in the client's part of the snapshot)
_CLIENT: Final = (
    ("received_messages", "Messages from the board", True, ("received", "messages")),
    ("received_bytes", "Bytes of these messages", True, ("received", "bytes")),
    ("lost_messages", "Best-effort messages of the board that never arrived, by their numbers",
     True, ("received", "lost")),
    ("given_up_messages", "Long messages of which the board sent the first fragments only",
     True, ("received", "given_up")),
    ("sent_messages", "Messages to the board", True, ("sent", "messages")),
    ("sent_bytes", "Bytes of these messages", True, ("sent", "bytes")),
    ("resent_messages", "Messages that were sent to the board again", True, ("sent", "resent")),
    ("dropped_messages", "Messages that found no room, on best-effort streams",
     True, ("sent", "dropped")),
    ("unacknowledged_messages", "Messages that the board has not acknowledged",
     False, ("queues", "unacknowledged")),
    ("stalled_messages", "Messages of the board that wait for room in the network",
     False, ("queues", "stalled")),
    ("early_messages", "Messages of the board that wait for one before them",
     False, ("queues", "early")),
    ("fragment_bytes", "Bytes of incomplete fragmented messages", False, ("queues", "fragments")),
)  # fmt: skip
_TRANSPORT: Final = (
    ("received_messages", "Messages received, those of unknown clients too", "messages"),
    ("received_bytes", "Bytes of these messages", "bytes"),
    ("frames", "Valid frames for the agent", "frames"),
    ("crc_errors", "Complete frames with a wrong CRC", "crc_errors"),
    ("foreign_frames", "Valid frames for other addresses", "foreign"),
    ("skipped_bytes", "Bytes outside of valid frames", "skipped"),
    ("malformed_messages", "Malformed messages or frames", "malformed"),
    ("dropped_messages", "Messages that the line did not take", "dropped"),
    ("refused_connections", "Connections that were refused", "refused"),
)


def families(snapshot: dict[str, Any]) -> Iterator[Metric]:
    """Yield the metrics of a snapshot."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    info = GaugeMetricFamily(
        "uros_agent_info", "The agent, always 1", labels=["version", "middleware"]
    )
    info.add_metric([__version__, _label(snapshot["middleware"])], 1)
    yield info
    uptime = "Seconds since the agent was started"
    yield GaugeMetricFamily("uros_agent_uptime_seconds", uptime, value=snapshot["uptime"])
    clients: list[dict[str, Any]] = snapshot["clients"]
    yield GaugeMetricFamily("uros_clients", "Boards with a session", value=len(clients))
    yield GaugeMetricFamily(
        "uros_refused_clients", "Client keys that were refused lately",
        value=len(snapshot["refused"]),
    )  # fmt: skip
    refusals = CounterMetricFamily(
        "uros_refusals", "Boards, requests and connections that were refused",
        labels=["kind", "rule"],
    )  # fmt: skip
    # All from the start, as 0: rate() and increase() see no change in the first sample of a series.
    counts = {(kind, rule): 0 for kind, rules in RULES.items() for rule in rules}
    counts.update({(each["kind"], each["rule"]): each["times"] for each in snapshot["refusals"]})
    for kind_and_rule, times in counts.items():
        refusals.add_metric(kind_and_rule, times)
    yield refusals

    transports = [
        ([transport["name"], _label(transport["label"])], transport)
        for transport in snapshot["transports"]
    ]
    for name, about, field in _TRANSPORT:
        family = CounterMetricFamily(f"uros_transport_{name}", about, labels=["transport", "where"])
        for labels, transport in transports:
            if field in transport:
                family.add_metric(labels, transport[field])
        if family.samples:
            yield family
    connections = GaugeMetricFamily(
        "uros_transport_connections", "Open connections", labels=["transport", "where"]
    )
    for labels, transport in transports:
        if "connections" in transport:
            connections.add_metric(labels, transport["connections"])
    yield connections
    ends = GaugeMetricFamily(
        "uros_tls_not_after_timestamp_seconds",
        "When the first certificate or list in a file ends, in seconds since 1970",
        labels=["transport", "where", "file"],
    )
    for labels, transport in transports:
        for file, moment in transport["not_after"].items():
            ends.add_metric([*labels, file], moment)
    yield ends

    about = "Address and first node of a board, always 1"
    info = GaugeMetricFamily(
        "uros_client_info", about, labels=["key", "transport", "address", "node"]
    )
    last_message = GaugeMetricFamily(
        "uros_client_silence_seconds", "Seconds since the board was heard", labels=["key"]
    )
    for client in clients[:MAX_SERIES]:
        node = client["nodes"][0]["name"] if client["nodes"] else ""
        where = [client["transport"], _label(client["address"])]
        info.add_metric([client["key"], *where, _label(node)], 1)
        last_message.add_metric([client["key"]], client["heard_ago"])
    yield info
    yield last_message
    for name, about, counter, (part, field) in _CLIENT:
        make = CounterMetricFamily if counter else GaugeMetricFamily
        each = make(f"uros_client_{name}", about, labels=["key"])
        for client in clients[:MAX_SERIES]:
            each.add_metric([client["key"]], client[part][field])
        if len(clients) > MAX_SERIES:
            each.add_metric([OTHER], sum(client[part][field] for client in clients[MAX_SERIES:]))
        yield each


def _label(text: str) -> str:
    """Make a text of a client safe for the legend of a graph."""
    return printable(text)


class _Families:
    """A collector of prometheus_client."""

    def __init__(self, snapshot: dict[str, Any]) -> None:
        self._snapshot = snapshot

    def collect(self) -> Iterable[Metric]:
        for family in families(self._snapshot):
            yield family
            time.sleep(_BREATH)


def _page(snapshot: dict[str, Any], accept: str) -> tuple[bytes, str]:
    """Return the metrics in a format that is accepted, and its content type."""
    from prometheus_client import CollectorRegistry, ProcessCollector
    from prometheus_client.exposition import choose_encoder

    registry = CollectorRegistry()
    registry.register(_Families(snapshot))
    ProcessCollector(registry=registry)
    encode, form = choose_encoder(accept)
    return encode(registry), form


class Metrics:
    """Serves the metrics over HTTP; an attachment of the server.

    Args:
        host: An address or name of this machine.
        port: TCP port; 0 for any.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host = host
        self.port = port
        self._http: _Http | None = None

    def open(self, server: Server) -> None:
        """Start to serve; raises TransportError."""
        try:
            import prometheus_client  # noqa: F401  here, and not at the first scrape
        except ImportError as error:
            raise TransportError(errno.ENOSYS, _NOT_INSTALLED) from error
        try:
            self._http = _Http(self.host, self.port, server)
        except OSError as error:
            raise TransportError(
                error.errno, listen_trouble(self.host, self.port, error)
            ) from error
        self.host, self.port = self._http.host, self._http.port
        self._http.start()
        url = f"http://{text_of((self.host, self.port))}/metrics"
        server.note(INFO, "Metrics", "init", "running...", f"port: {self.port}, {url}")

    def close(self) -> None:
        """Stop; idempotent."""
        http, self._http = self._http, None
        if http is not None:
            http.close()


def listen_trouble(host: str, port: int, error: OSError) -> str:
    """Explain why the metrics cannot be served at an address, with the remedy."""
    if isinstance(error, socket.gaierror):
        return f"--metrics: there is no host {host}: give an address of this machine"
    if error.errno == errno.EADDRNOTAVAIL:
        return address_trouble("TCP", host, port)
    if error.errno == errno.EADDRINUSE:
        return (
            f"--metrics: TCP port {port} is in use, perhaps by another agent: choose another, or 0"
            " for any that is free"
        )
    return bind_trouble("TCP", port, error, "--metrics")


class _Http(HttpServer):
    def __init__(self, host: str, port: int, server: Server) -> None:
        self.agent_server = server
        super().__init__(host, port, _Handler, MAX_SCRAPES, _WRONG_HOST, self._tell)

    def _tell(self, error: Exception) -> None:
        server, about = self.agent_server, unexpected(error)
        server.soon(lambda: server.note(ERROR, "Metrics", "run", "internal error", about))

    def readiness(self) -> Readiness | None:
        """Ask the server's thread, in a thread of HTTP; None if it does not answer in time."""
        judged: list[Readiness] = []
        ready = threading.Event()
        server = self.agent_server

        def judge() -> None:
            judged.append(readiness(server))
            ready.set()

        server.soon(judge)
        return judged[0] if ready.wait(PATIENCE) else None

    def snapshot(self) -> dict[str, Any] | None:
        """Request a snapshot, in a thread of HTTP; None if it is not made in time."""
        pieces: list[str] = []
        ready = threading.Event()
        waiting = True

        def done(text: str) -> None:
            pieces.append(text)
            ready.set()

        server = self.agent_server
        server.soon(lambda: gather(server, done, lambda: waiting))
        if not ready.wait(PATIENCE):
            waiting = False
            return None
        snapshot: dict[str, Any] = json.loads(pieces[0])
        return snapshot


class _Handler(Handler):
    server: _Http

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path in (HEALTH, READY):
            self._judge(path)
            return
        if path not in ("/", "/metrics"):
            self._reply(404, b"the metrics are at /metrics, the health at /healthz and /readyz\n")
            return
        snapshot = self.server.snapshot()
        if snapshot is None:
            self._reply(503, _BUSY)
            return
        self._reply(200, *_page(snapshot, self.headers.get("Accept") or ""))

    def _judge(self, path: str) -> None:
        """Answer whether the agent runs, or whether it can serve boards."""
        judged = self.server.readiness()
        if judged is None:
            self._reply(503, _BUSY)
        elif path == HEALTH:
            self._reply(200, b"ok\n")
        else:
            body = json.dumps(judged._asdict()).encode() + b"\n"
            self._reply(200 if judged.ready else 503, body, "application/json")

    def _reply(self, status: int, body: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self.reply(status, body, kind)
