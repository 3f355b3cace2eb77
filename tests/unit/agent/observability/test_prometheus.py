"""--metrics: the pages for Prometheus, and requests that must not harm the agent."""

import datetime
import inspect
import json
import re
import socket
import sys
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics
from prometheus_client.parser import text_string_to_metric_families
from support.agent import RunningAgent, serving
from support.certificates import Authority
from support.client import XrceClient
from support.lines import SECONDS
from support.waiting import eventually
from unit.agent.transports.faults import wait_for
from unit.agent.transports.test_process import agent as process

from uros import agent as agent_package
from uros import http_server
from uros.agent.objects.client import ProxyClient
from uros.agent.observability import prometheus as module
from uros.agent.observability.prometheus import Metrics, families
from uros.agent.observability.snapshot import pieces
from uros.agent.policy.admission import KEY_NOT_ALLOWED, RULES
from uros.agent.transports.base import TransportError
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.tls import TlsServer
from uros.printable import printable
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


@contextmanager
def measured(transport="udp", host="127.0.0.1"):
    running = RunningAgent(transport, "memory", 0, 4)
    running.metrics = Metrics(host, 0)
    running.server.attachments.append(running.metrics)
    with serving(running):
        yield running


def get(running, path="/metrics", **headers):
    host = running.metrics.host
    where = f"[{host}]" if ":" in host else host
    request = urllib.request.Request(
        f"http://{where}:{running.metrics.port}{path}", headers=headers
    )
    with urllib.request.urlopen(request, timeout=SECONDS) as answer:
        return answer.read().decode(), answer.headers["Content-Type"]


def status(running, path="/metrics"):
    """Return the status and the text of an error response."""
    with pytest.raises(urllib.error.HTTPError) as caught:
        get(running, path)
    with caught.value as error:
        return error.code, error.read().decode()


def samples(text, parse=text_string_to_metric_families):
    """Return (name, labels in any order) → value."""
    return {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in parse(text)
        for sample in family.samples
    }


def value_of(metrics, name, **labels):
    return metrics[(name, *sorted(labels.items()))]


def board(running, key=0x77, writes=3):
    client = XrceClient(running.line(), key)
    assert client.open() == ids.STATUS_OK
    writer = client.writer("talker", "rt/numbers", TYPE)
    for _ in range(writes):
        client.write(writer, b"\0" * 8)
    assert client.ping() == 1
    return client


# --- what is told --------------------------------------------------------------------------


def test_a_scrape_has_the_values_of_the_snapshot():
    with measured() as running:
        board(running)
        text, form = get(running)
        assert form.startswith("text/plain")
        metrics = samples(text)
        snapshot = running.snapshot()
        key = "0x00000077"
        (client,) = snapshot["clients"]
        for name, part, field in (
            ("received_messages_total", "received", "messages"),
            ("received_bytes_total", "received", "bytes"),
            ("lost_messages_total", "received", "lost"),
            ("given_up_messages_total", "received", "given_up"),
            ("sent_messages_total", "sent", "messages"),
            ("resent_messages_total", "sent", "resent"),
            ("dropped_messages_total", "sent", "dropped"),
            ("stalled_messages", "queues", "stalled"),
        ):
            assert value_of(metrics, f"uros_client_{name}", key=key) == client[part][field], name
        assert (
            value_of(metrics, "uros_clients") == 1
            and value_of(metrics, "uros_refused_clients") == 0
        )
        assert value_of(
            metrics, "uros_client_info", key=key, transport="UDPv4Agent",
            address=client["address"], node="/talker",
        ) == 1  # fmt: skip
        where = {"transport": "UDPv4Agent", "where": f"port {running.transport.port}"}
        messages = value_of(metrics, "uros_transport_received_messages_total", **where)
        assert messages == snapshot["transports"][0]["messages"] > 5
        assert value_of(metrics, "process_resident_memory_bytes") > 1_000_000
        assert value_of(metrics, "process_open_fds") > 2
        assert value_of(metrics, "process_cpu_seconds_total") > 0
        assert value_of(metrics, "uros_agent_uptime_seconds") > 0
        assert get(running, "/")[0].splitlines()[0] == text.splitlines()[0]


def test_openmetrics_is_served_on_request():
    with measured("serial") as running:
        board(running, 0x10)
        text, form = get(running, Accept="application/openmetrics-text; version=1.0.0")
        assert form.startswith("application/openmetrics-text")
        metrics = samples(text, openmetrics)
        where = {"transport": "SerialAgent", "where": running.transport.device}
        assert value_of(metrics, "uros_transport_frames_total", **where) > 5
        assert value_of(metrics, "uros_transport_crc_errors_total", **where) == 0


def test_metric_names_are_valid_and_texts_of_boards_are_escaped():
    evil = 'a"} 1\nuros_clients 99\n\\ \ud800é\u202e\x1b[2J'
    with measured() as running:
        board(running)
        text = "".join(pieces(running.server))
    snapshot = json.loads(text)
    snapshot["clients"][0]["nodes"] = [{"name": evil, "domain": 0}]
    snapshot["clients"][0]["address"] = evil
    snapshot["transports"][0]["label"] = evil
    page, _ = module._page(snapshot, "")
    metrics = samples(page.decode("utf-8"))
    assert value_of(metrics, "uros_clients") == 1
    assert any(dict(metric[1:]).get("node") == printable(evil) for metric in metrics)
    assert not any("\u202e" in str(metric) or "\x1b" in str(metric) for metric in metrics)
    for family in families(snapshot):
        assert family.documentation and family.name.startswith("uros_")


def test_each_rule_that_refuses_is_0_before_its_first_refusal():
    """Otherwise rate() does not see the first one."""
    with measured() as running:
        metrics = samples(get(running)[0])
        assert value_of(metrics, "uros_refusals_total", kind="board", rule="allow_key") == 0
        refusals = running.agent.refusals
        running.server.soon(lambda: refusals.note(7, KEY_NOT_ALLOWED, "somewhere", 0.0))
        metrics = samples(get(running)[0])
    assert value_of(metrics, "uros_refusals_total", kind="board", rule="allow_key") == 1
    counts = [value for metric, value in metrics.items() if metric[0] == "uros_refusals_total"]
    assert len(counts) == sum(map(len, RULES.values())) and sum(counts) == 1


def test_the_rules_that_refuse_are_those_of_the_agent():
    sources = Path(agent_package.__file__).parent
    transports = "".join(path.read_text("utf-8") for path in sources.glob("transports/*.py"))
    create = inspect.getsource(ProxyClient._create)
    connection = {"allow_net", *re.findall(r'on_refused\("(\w+)"', transports)}
    request = {name.lower() for name in re.findall(r"ids\.STATUS_ERR_(\w+)", create)}
    assert set(RULES["connection"]) == connection and set(RULES["request"]) == request


def test_when_the_files_of_tls_end(tmp_path):
    ca = Authority(tmp_path)
    day = datetime.timedelta(1)
    ends = datetime.datetime.now(datetime.timezone.utc).replace(microsecond=0) + 3 * day
    files = Certificates(*ca.agent(not_after=ends), ca.ca, ca.revoke(days=7))
    name = "uros_tls_not_after_timestamp_seconds"
    with measured(TlsServer(0, "127.0.0.1", files)) as running:
        metrics = samples(get(running)[0])
        where = {"transport": running.transport.name, "where": running.transport.label()}
    assert value_of(metrics, name, file="tls_cert", **where) == ends.timestamp()
    until_new_list = value_of(metrics, name, file="tls_crl", **where) - ends.timestamp()
    assert abs(until_new_list - 4 * 86_400) < 60
    assert value_of(metrics, name, file="tls_ca", **where) > ends.timestamp()
    with measured() as running:
        assert name + "{" not in get(running)[0]


def test_boards_over_the_limit_share_one_series(monkeypatch):
    monkeypatch.setattr(module, "MAX_SERIES", 2)
    with measured() as running:
        for key in (1, 2, 3, 4):
            board(running, key, writes=key)
        metrics = samples(get(running)[0])
        snapshot = running.snapshot()
    name = "uros_client_received_messages_total"
    keys = [dict(metric[1:])["key"] for metric in metrics if metric[0] == name]
    assert keys == ["0x00000001", "0x00000002", "other"]
    rest = sum(metric["received"]["messages"] for metric in snapshot["clients"][2:])
    assert value_of(metrics, name, key="other") == rest
    assert value_of(metrics, "uros_clients") == 4


# --- askers that are slow, mad or many ------------------------------------------------------


def test_other_paths_and_methods():
    with measured() as running:
        assert status(running, "/secret")[0] == 404
        with socket.create_connection(("127.0.0.1", running.metrics.port)) as sock:
            sock.settimeout(SECONDS)
            sock.sendall(b"DELETE /metrics HTTP/1.0\r\nHost: localhost\r\n\r\n")
            assert b" 501 " in sock.recv(100)
        for junk in (b"\0" * 1000, b"GET\r\n\r\n", b"\xff" * 70_000, b"GET / HTTP/9.9\r\n\r\n"):
            with socket.create_connection(("127.0.0.1", running.metrics.port)) as sock:
                try:
                    sock.sendall(junk)
                except ConnectionError:
                    pass
        board(running)
        get(running)
        assert "internal error" not in running.said.getvalue()


def test_an_agent_that_hangs_answers_503_until_it_goes_on(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.1)
    with measured() as running:
        go_on, hangs = threading.Event(), threading.Event()

        def hang():
            hangs.set()
            go_on.wait(SECONDS)

        running.server.soon(hang)
        assert hangs.wait(SECONDS)
        code, body = status(running)
        assert code == 503 and "the agent is busy" in body
        go_on.set()
        monkeypatch.setattr(module, "PATIENCE", SECONDS)
        assert "uros_clients 0.0" in get(running)[0]


@pytest.mark.parametrize("opened_count", [b"", b"GET /met"])
def test_connections_without_a_request_delay_no_scrape(opened_count):
    """Test as many connections as threads, as many as places, and more."""
    with measured() as running:
        connections = []
        for count in (module.MAX_SCRAPES, 2 * http_server.MAX_CONNECTIONS):
            while len(connections) < count:
                connections.append(socket.create_connection(("127.0.0.1", running.metrics.port)))
                connections[-1].sendall(opened_count)
            assert "uros_clients 0.0" in get(running)[0]
        assert running.metrics._http.connections <= http_server.MAX_CONNECTIONS
        assert board(running).ping() == 1
        for sock in connections:
            sock.close()


def test_scrapes_of_an_agent_that_hangs_wait_for_threads_and_are_all_answered(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", SECONDS)
    with measured() as running:
        go_on, hangs = threading.Event(), threading.Event()
        running.server.soon(lambda: hangs.set() or go_on.wait(SECONDS))
        assert hangs.wait(SECONDS)
        connections = [
            socket.create_connection(("127.0.0.1", running.metrics.port))
            for _ in range(3 * module.MAX_SCRAPES)
        ]
        for sock in connections:
            sock.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        server = running.metrics._http
        eventually(lambda: len(server._queue) == 2 * module.MAX_SCRAPES)
        assert len(server._answering) == module.MAX_SCRAPES
        go_on.set()
        for sock in connections:
            sock.settimeout(SECONDS)
            assert sock.recv(65536).startswith(b"HTTP/1.1 200 ")
            sock.close()


@pytest.mark.parametrize(
    ("host", "code"),
    [
        ("127.0.0.1:9100", 200), ("[::1]", 200), ("localhost", 200), (socket.gethostname(), 200),
        (f"{socket.gethostname()}.local:9100", 200), ("evil.example", 403), ("", 403),
        ("127.0.0.1.evil.example", 403), ("[x", 403),
    ],
)  # fmt: skip
def test_a_request_with_a_foreign_host_name_is_refused(host, code):
    with measured() as running:
        if code == 200:
            assert "uros_clients 0.0" in get(running, Host=host)[0]
        else:
            with pytest.raises(urllib.error.HTTPError) as caught:
                get(running, Host=host)
            with caught.value as error:
                assert error.code == code and b"--metrics NAME:PORT" in error.read()


def test_a_request_with_the_configured_host_name_is_answered(monkeypatch):
    """In a container, the name of the service leads to it."""
    real = http_server._listen
    monkeypatch.setattr(http_server, "_listen", lambda host, port: real("127.0.0.1", port))
    with measured(host="Agent.Hall") as running:
        assert "uros_clients 0.0" in get(running, Host="agent.hall:9100")[0]
        with pytest.raises(urllib.error.HTTPError) as caught:
            get(running, Host="evil.hall")
        caught.value.close()


def test_an_internal_error_in_a_scrape_is_logged(monkeypatch):
    with measured() as running:
        monkeypatch.setattr(module, "_page", lambda *_: 1 / 0)
        with pytest.raises(OSError):
            get(running)
        wait_for(running.said.getvalue, "internal error")
        assert "ZeroDivisionError" in running.said.getvalue()
        running.said.truncate(0)  # serving() checks that the log has no fault


# --- opening it -------------------------------------------------------------------------------


def test_an_address_of_ipv6():
    with measured(host="::1") as running:
        assert "uros_clients 0.0" in get(running)[0]


def test_the_port_is_logged_and_a_second_agent_on_it_names_the_remedy():
    with process("udp4", "-p", 0, "-m", "memory", "--metrics", 0) as first:
        port = int(first.until(r"Metrics .*port: (\d+), http://127\.0\.0\.1:\d+/metrics")[1])
        url = f"http://127.0.0.1:{port}/metrics"
        with urllib.request.urlopen(url, timeout=SECONDS) as answer:
            assert b"uros_clients 0.0" in answer.read()
        with process("udp4", "-p", 0, "-m", "memory", "--metrics", port) as second:
            second.until(
                rf"uros: --metrics: TCP port {port} is in use by another agent \(pid"
                rf" {first.popen.pid}\): choose another, or 0 for any that is free"
            )
            while second.read():
                pass
            assert second.popen.wait(SECONDS) == 1
        assert first.end() == 0


@pytest.mark.parametrize(
    "host, why",
    [("192.0.2.1", "this machine has no address"), ("no.such.host.invalid", "there is no host")],
)
def test_an_invalid_address_is_refused(host, why):
    metrics = Metrics(host, 0)
    with pytest.raises(TransportError, match=why):
        metrics.open(None)
    metrics.close()


def test_without_the_library_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(TransportError, match="python -m pip install prometheus_client"):
        Metrics("127.0.0.1", 0).open(None)


def test_the_registry_of_the_library_is_not_used():
    """A program that embeds the agent may have metrics of its own."""
    with measured() as running:
        get(running)
        get(running)
    from prometheus_client import REGISTRY

    assert isinstance(REGISTRY, CollectorRegistry)
    assert not any(name.startswith("uros_") for name in REGISTRY._names_to_collectors)
