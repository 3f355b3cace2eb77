"""TLS of the agent: admitted clients, log lines of refused ones, hostile handshakes."""

import datetime
import random
import re
import socket
import ssl
import struct
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.agent import RunningAgent, running_agent, serving
from support.certificates import Authority, authority, own_certificates
from support.client import XrceClient
from support.examples import examples
from support.lines import SECONDS, TlsLine
from unit.agent.helpers import create_client
from unit.agent.transports import test_tcp as plain
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import (
    TYPE,
    Bystanders,
    check_a_client_that_does_not_read_is_disconnected,
    wait_for,
)
from unit.agent.transports.test_tcp import answers, framed

from uros.agent.policy.rules import _is_at
from uros.agent.transports import certificates as files_module
from uros.agent.transports import tcp
from uros.agent.transports import tls as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.tls import TlsServer, _name_in, tls_server
from uros.transport.tls import TlsTransport
from uros.wire import ids

PING = plain.PING
HELLO_BYTES = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"


@pytest.fixture(scope="module")
def agent():
    with running_agent("tls", "memory") as running:
        yield running


@pytest.fixture
def strict(tmp_path):
    """Yield (agent, authority): an agent that requires certificates of its CA."""
    authority = Authority(tmp_path)
    server = TlsServer(0, "127.0.0.1", Certificates(*authority.agent(), authority.ca))
    with serving(RunningAgent(server, "memory", 0, 4)) as running:
        yield running, authority


def connected(port, context):
    sock = socket.create_connection(("127.0.0.1", port), SECONDS)
    try:
        return context.wrap_socket(sock, server_hostname="127.0.0.1")
    except BaseException:
        sock.close()
        raise


def is_closed(sock):
    """Return whether the agent ends the connection, whatever it sends before."""
    try:
        while sock.recv(65536):
            pass
    except ConnectionResetError:
        pass
    except ssl.SSLError:
        pass
    return True


# --- who gets in --------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
def test_a_client_without_a_certificate_where_none_is_asked_for(agent, version):
    context = authority().client()
    context.minimum_version = context.maximum_version = ssl.TLSVersion[version]
    with connected(agent.transport.port, context) as sock:
        sock.sendall(framed(PING))
        assert answers(sock, 1)[0][4] == ids.INFO
        assert sock.version() == version.replace("_", ".")


@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
def test_the_name_in_a_clients_certificate_is_logged(strict, version):
    agent, authority = strict
    context = authority.client("left arm")
    context.minimum_version = context.maximum_version = ssl.TLSVersion[version]
    line = TlsLine(agent.transport.port, context)
    client = XrceClient(line, 0x11)
    assert client.open() == ids.STATUS_OK
    address = agent.agent.address(0x11)
    port = line._socket.getsockname()[1]
    assert address == f"127.0.0.1:{port} (CN=left arm)"
    wait_for(agent.said.getvalue, f"session established            | client_key: 0x00000011,"
             f" address: {address}")  # fmt: skip
    for pattern in ("127.0.0.0/8", "127.0.0.1", "*(CN=left arm)", f"*:{port}", "127.0.0.1:*"):
        assert _is_at(address, pattern), pattern
    for pattern in ("*(CN=right arm)", "10.0.0.0/8", "*:1"):
        assert not _is_at(address, pattern), pattern
    line.close()
    wait_for(agent.said.getvalue, "session closed")


def test_names_that_could_be_mistaken_for_another_are_escaped():
    def named(*values):
        return _name_in({"subject": tuple((("commonName", name),) for name in values)})

    assert named("a) (CN=b") == "a%29 %28CN%3Db"
    assert named("a\n[0.1] info\x1b[31m") == "a%0A%5B0.1%5D info%1B%5B31m"
    assert named("x" * 64) == "x" * 64
    long = [named("x" * 100), named("x" * 101)]
    assert all(name.startswith("x" * 47 + "-") and len(name) == 64 for name in long)
    assert long[0] != long[1]
    assert named("Müller") == "M%C3%BCller" != named("Möller")
    assert named("50%") == "50%25"
    assert named() == "?" and _name_in(None) == ""
    assert _name_in({"subjectAltName": (("DNS", "left.local"),)}) == "left.local"


def test_openssl_s_client_gets_its_answer(strict):
    """Independent software sends a ping with its length and gets the agent's INFO."""
    agent, authority = strict
    cert, key = authority.issue("bench")
    done = subprocess.Popen(
        ["openssl", "s_client", "-quiet", "-connect", f"127.0.0.1:{agent.transport.port}",
         "-CAfile", authority.ca, "-verify_return_error", "-verify_ip", "127.0.0.1",
         "-cert", cert, "-key", key],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with done:
        done.stdin.write(framed(PING))
        done.stdin.flush()
        size = int.from_bytes(done.stdout.read(2), "little")
        answer = done.stdout.read(size)
        done.terminate()
    assert answer[4] == ids.INFO


# --- who does not, and what is said ---------------------------------------------------------------


def refusals(strict, context):
    """Return the log lines of a refused client, which must get no answer."""
    agent, _ = strict
    with pytest.raises((ssl.SSLError, ConnectionError)):
        with connected(agent.transport.port, context) as sock:
            sock.sendall(framed(PING))
            if not sock.recv(1):
                raise ConnectionResetError
    wait_for(agent.said.getvalue, "no TLS connection")
    assert agent.agent.clients == {}
    return agent.said.getvalue()


VERSIONS = pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])


def at(context, version):
    context.minimum_version = context.maximum_version = ssl.TLSVersion[version]
    return context


@VERSIONS
def test_a_client_without_the_required_certificate(strict, version):
    log = refusals(strict, at(strict[1].client(), version))
    assert "it shows no certificate, which --tls-ca demands: give its program cert and key" in log


@VERSIONS
def test_a_certificate_of_another_ca(strict, version, tmp_path):
    context = Authority(tmp_path / "other").client("left", trust=strict[1].ca)
    log = refusals(strict, at(context, version))
    assert "its certificate is refused (unable to get local issuer certificate)" in log
    assert "that the CA of --tls-ca has signed" in log


@VERSIONS
def test_an_expired_certificate(strict, version):
    now = datetime.datetime.now(datetime.timezone.utc)
    cert, key = strict[1].issue("old", not_after=now - datetime.timedelta(days=1))
    context = at(strict[1].client(), version)
    context.load_cert_chain(cert, key)
    log = refusals(strict, context)
    assert "its certificate has expired: give the board a new one" in log


@VERSIONS
def test_a_client_that_does_not_trust_the_agent(strict, version, tmp_path):
    context = at(Authority(tmp_path / "other").client(), version)
    log = refusals(strict, context)
    assert "it refuses the agent's certificate (tlsv1 alert unknown ca)" in log
    assert "give the board the CA that has signed it" in log


def test_outdated_tls_is_refused(strict):
    """A ClientHello that offers TLS 1.1, which OpenSSL's clients no longer support."""
    agent, _ = strict
    suites = b"\x00\x2f\x00\x35"
    body = b"\x03\x02" + bytes(32) + b"\0" + struct.pack(">H", len(suites)) + suites + b"\1\0"
    client_hello = b"\1" + len(body).to_bytes(3, "big") + body
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
        sock.sendall(b"\x16\x03\x01" + struct.pack(">H", len(client_hello)) + client_hello)
        assert is_closed(sock)
    wait_for(agent.said.getvalue, "it has no TLS 1.2 or later")
    assert "(unsupported protocol): update its TLS" in agent.said.getvalue()


def test_a_client_without_tls_is_logged(agent, raw):
    raw.sendall(framed(create_client(0x77)))
    assert is_closed(raw)
    wait_for(agent.said.getvalue, "it does not use TLS, which this port requires")
    assert "TlsTransport" in agent.said.getvalue()
    assert 0x77 not in agent.agent.clients


@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
def test_a_client_with_tls_on_a_port_without(version):
    with running_agent("tcp", "memory") as agent:
        bystanders = Bystanders(agent)
        with pytest.raises((ssl.SSLError, ConnectionError)):
            connected(agent.transport.port, at(authority().client(), version))
        wait_for(agent.said.getvalue, "it begins TLS, which this port does not speak")
        assert "--tls-cert and --tls-key" in agent.said.getvalue()
        for _ in range(30):
            with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
                sock.sendall(HELLO_BYTES)
                assert is_closed(sock)
        assert agent.said.getvalue().count("it begins TLS") < 8
        bystanders.check()


def test_only_a_client_hello_is_recognised_as_one():
    assert tcp.is_client_hello(HELLO_BYTES)
    for size in range(9):
        assert not tcp.is_client_hello(HELLO_BYTES[:size])
    for at_ in (0, 1, 3, 4, 5, 6, 7, 8):
        spoilt = bytearray(HELLO_BYTES)
        spoilt[at_] ^= 1
        assert not tcp.is_client_hello(bytes(spoilt))
    assert not tcp.is_client_hello(framed(PING))


# --- what harms nobody --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "sent",
    [b"", b"\x16", b"\x16\x03", HELLO_BYTES, HELLO_BYTES[:6], b"\x16\x03\x03\xff\xff" + bytes(99)],
)
def test_half_a_handshake_and_an_abrupt_end(agent, bystanders, sent):
    sock = socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS)
    sock.sendall(sent)
    bystanders.check()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()  # RST
    bystanders.check()
    deadline = time.monotonic() + SECONDS
    while len(agent.transport._connections) > 2:
        assert time.monotonic() < deadline
        bystanders.check()
    assert not agent.transport._shaking


def recorded_hello():
    """Return a complete ClientHello of OpenSSL."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = authority().client().wrap_bio(incoming, outgoing, server_hostname="localhost")
    with pytest.raises(ssl.SSLWantReadError):
        client.do_handshake()
    return outgoing.read()


@settings(
    max_examples=examples(150),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_any_bytes_instead_of_a_handshake(agent, bystanders, data):
    client_hello = recorded_hello()
    chunk = st.one_of(
        st.binary(max_size=300),
        st.integers(0, len(client_hello)).map(lambda length: client_hello[:length]),
        st.tuples(st.integers(0, len(client_hello) - 1), st.integers(1, 255)).map(
            lambda length: (
                client_hello[: length[0]]
                + bytes([client_hello[length[0]] ^ length[1]])
                + client_hello[length[0] + 1 :]
            )
        ),
        st.tuples(st.integers(20, 24), st.binary(max_size=60)).map(
            lambda length: (
                bytes([length[0]]) + b"\x03\x03" + struct.pack(">H", len(length[1])) + length[1]
            )
        ),
    )
    chunks = data.draw(st.lists(chunk, min_size=1, max_size=4))
    shut = data.draw(st.booleans())
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
        try:
            for length in chunks:
                sock.sendall(length)
            if shut:
                sock.shutdown(socket.SHUT_WR)
                is_closed(sock)
        except (ConnectionError, OSError):
            pass
    bystanders.check()


def test_random_bytes_behind_the_handshake(agent, bystanders):
    """Unauthenticated records, sent over the socket below TLS."""
    rng = random.Random(7)
    for kind in (20, 21, 22, 23, 24, 0x80):
        with connected(agent.transport.port, authority().client()) as sock:
            sock.sendall(framed(PING))
            answers(sock, 1)
            with socket.socket(fileno=socket.dup(sock.fileno())) as below:
                below.settimeout(SECONDS)
                below.sendall(bytes([kind]) + b"\x03\x03\0\x40" + rng.randbytes(64))
                assert is_closed(below)
        bystanders.check()


def test_messages_cut_anywhere_and_records_of_many(agent, bystanders):
    with connected(agent.transport.port, authority().client()) as sock:
        for byte in framed(PING):
            sock.sendall(bytes([byte]))
        assert len(answers(sock, 1)) == 1
        sock.sendall(framed(PING) * 1500)  # two records, and one of them full
        assert len(answers(sock, 1500)) == 1500
    bystanders.check()


def test_bytes_that_openssl_has_decrypted_already_are_read(agent, monkeypatch):
    """The chunk is smaller than a record: no further byte would wake the selector."""
    monkeypatch.setattr(tcp, "_CHUNK", 100)
    with connected(agent.transport.port, authority().client()) as sock:
        sock.sendall(framed(PING) * 300)
        assert len(answers(sock, 300)) == 300


def test_a_client_that_renegotiates_is_disconnected(agent, bystanders):
    """The command R of openssl s_client renegotiates, with TLS 1.2."""
    command = ["openssl", "s_client", "-tls1_2", "-connect", f"127.0.0.1:{agent.transport.port}"]
    done = subprocess.run(
        [*command, "-CAfile", authority().ca, "-legacy_renegotiation"],
        input=b"R\n", capture_output=True, timeout=SECONDS,
    )  # fmt: skip
    output = done.stdout + done.stderr
    assert b"RENEGOTIATING" in output
    assert b"no renegotiation" in output or b"handshake failure" in output, output
    bystanders.check()


def test_endless_key_updates(agent, bystanders):
    """TLS 1.3 has KeyUpdate instead: the command k of openssl requests one, which is answered."""
    command = ["openssl", "s_client", "-tls1_3", "-connect", f"127.0.0.1:{agent.transport.port}"]
    subprocess.run(
        [*command, "-CAfile", authority().ca], input=b"K\n" * 200, capture_output=True,
        timeout=SECONDS,
    )  # fmt: skip
    bystanders.check()


def test_a_client_that_does_not_read_is_disconnected_alone(agent, bystanders, monkeypatch):
    monkeypatch.setattr(tcp, "MAX_UNSENT", 200_000)
    check_a_client_that_does_not_read_is_disconnected(agent, bystanders)


def test_a_client_that_reads_slowly_gets_all_messages(agent):
    """More data than a socket accepts at once is sent record by record."""
    line = agent.line()
    line._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow = XrceClient(line, 0x7A, mtu=60_000)
    assert slow.open() == 0
    reader = slow.reader("slow", "rt/large", TYPE)
    slow.read(reader)
    writer = slow.writer("slow", "rt/large", TYPE)
    payload = random.Random(5).randbytes(100_000)
    slow.write(writer, payload)
    assert slow.sample(reader) == payload
    assert slow.close() == 0


def test_close_notify_is_sent(agent):
    """close_notify shows the peer that the connection was not cut."""
    with connected(agent.transport.port, authority().client()) as sock:
        sock.suppress_ragged_eofs = False
        sock.sendall(framed(PING))
        answers(sock, 1)
        connection = max(agent.transport._names, key=lambda connection_name: connection_name.whole)
        agent.server.wake_at(0.0, lambda: agent.transport._drop(connection))
        agent.server._wake.set()
        assert sock.recv(1) == b""


def test_the_number_of_cached_sessions_is_limited(monkeypatch):
    """OpenSSL would cache 20,000 sessions with the clients' certificates."""
    monkeypatch.setattr(files_module, "MAX_SESSIONS", 5)
    files = own_certificates()
    with serving(RunningAgent(TlsServer(0, "127.0.0.1", files), "memory", 0, 4)) as agent:
        session_ids = set()
        for _ in range(20):
            with connected(agent.transport.port, at(authority().client(), "TLSv1_2")) as sock:
                sock.sendall(framed(PING))
                answers(sock, 1)
                try:
                    sock.unwrap()  # with close_notify, or the session would not be cached
                except (OSError, ValueError):
                    pass
            session_ids.add(files.context().session_stats()["number"])
        assert 3 <= max(session_ids) <= 6


def test_a_new_certificate_is_used_without_a_restart(tmp_path):
    old, new = Authority(tmp_path / "old"), Authority(tmp_path / "new")
    cert, key = old.agent()
    with serving(
        RunningAgent(tls_server(0, "127.0.0.1", cert, key, None), "memory", 0, 4)
    ) as agent:
        stays = connected(agent.transport.port, old.client())
        for path, content in zip((cert, key), new.agent(), strict=True):
            with open(path, "wb") as out, open(content, "rb") as text:
                out.write(text.read())
        with connected(agent.transport.port, new.client()) as sock:
            sock.sendall(framed(PING))
            answers(sock, 1)
        with stays:
            stays.sendall(framed(PING))
            answers(stays, 1)
        with open(cert, "w") as out:
            out.write("a slip of the editor")
        for _ in range(3):
            with connected(agent.transport.port, new.client()) as sock:
                sock.sendall(framed(PING))
                answers(sock, 1)
        log = agent.said.getvalue()
        assert log.count("cannot use new files") == 1
        assert "holds no valid certificate" in log and "the former ones stay in use" in log


def test_an_expired_certificate_of_the_agent_is_logged_at_the_start(tmp_path):
    now = datetime.datetime.now(datetime.timezone.utc)
    files = Authority(tmp_path).agent(not_after=now - datetime.timedelta(days=1))
    with serving(RunningAgent(tls_server(0, "127.0.0.1", *files, None), "memory", 0, 4)) as agent:
        day = f"{now - datetime.timedelta(days=1):%Y-%m-%d}"
        said = agent.said.getvalue()
        assert re.search(
            rf"boards may not connect +\| --tls-cert {files[0]} expired on {day}", said
        )


@VERSIONS
def test_a_board_that_refuses_an_expired_certificate_is_told_as_that(tmp_path, version):
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = Authority(tmp_path)
    files = authority.agent(not_after=now - datetime.timedelta(days=1))
    with serving(RunningAgent(tls_server(0, "127.0.0.1", *files, None), "memory", 0, 4)) as agent:
        with pytest.raises(ssl.SSLCertVerificationError):
            connected(agent.transport.port, at(authority.client(), version))
        wait_for(agent.said.getvalue, "no TLS connection")
        why = agent.said.getvalue().rpartition("address: ")[2]
    day = f"{now - datetime.timedelta(days=1):%Y-%m-%d}"
    said = f"it refuses the agent's certificate: --tls-cert {files[0]} expired on {day}: make a new"
    assert said in why


@pytest.mark.parametrize("receives", [True, False])
def test_a_board_with_an_expired_certificate_is_told_by_the_agent(strict, receives):
    """Also if it learns by sending that the agent has closed the connection."""
    agent, authority = strict
    now = datetime.datetime.now(datetime.timezone.utc)
    files = authority.issue("old", not_after=now - datetime.timedelta(days=1))
    board = TlsTransport("127.0.0.1", agent.transport.port, 512, authority.ca, *files)
    board.open()
    while not board._connected():
        pass
    with pytest.raises(OSError, match=r"its log has why and the remedy: .*certificate expired"):
        while True:
            board.send(PING)
            if receives:
                board.receive(1)
    board.close()


# --- revocation and rotation ---------------------------------------------------------------------


@contextmanager
def revoking(authority, crl):
    """An agent that refuses what the revocation list has."""
    server = tls_server(0, "127.0.0.1", *authority.agent(), authority.ca, crl)
    with serving(RunningAgent(server, "memory", 0, 4)) as running:
        yield running


def reload(agent):
    agent.server.soon(agent.transport.reload)


@VERSIONS
def test_a_revoked_certificate_is_refused_and_named(tmp_path, version):
    authority = Authority(tmp_path)
    lost = authority.issue("lost")
    with revoking(authority, authority.revoke(lost[0])) as agent:
        context = at(authority.client(), version)
        context.load_cert_chain(*lost)
        log = refusals((agent, authority), context)
        assert "its certificate is revoked by --tls-crl: give the board a new one" in log
        with connected(agent.transport.port, at(authority.client("left"), version)) as sock:
            sock.sendall(framed(PING))
            answers(sock, 1)


def test_a_certificate_that_is_revoked_ends_its_connection_and_no_other(tmp_path):
    authority = Authority(tmp_path)
    crl = authority.revoke()
    with revoking(authority, crl) as agent:
        lines, clients = [], []
        for key, name in enumerate(("left", "lost"), 1):
            lines.append(TlsLine(agent.transport.port, authority.client(name)))
            clients.append(XrceClient(lines[-1], key))
            assert clients[-1].open() == ids.STATUS_OK
        authority.revoke(tmp_path / "lost.pem", path=crl)
        address = agent.agent.address(2)
        assert address.endswith(" (CN=lost)")
        reload(agent)
        wait_for(
            agent.said.getvalue, f"| address: {address}, its certificate is revoked by --tls-crl"
        )
        assert agent.snapshot()["refusals"][0]["address"] == address
        files = f"| certificate: {tmp_path}/agent.pem, CA: {authority.ca}, revocation list: {crl}"
        assert files in agent.said.getvalue()
        wait_for(agent.said.getvalue, "delete                         | client_key: 0x00000002")
        assert list(agent.agent.clients) == [1]
        assert clients[0].ping()
        for line in lines:
            line.close()


def test_a_changed_list_is_used_without_a_signal_from_the_next_handshake_on(tmp_path):
    authority = Authority(tmp_path)
    crl = authority.revoke()
    with revoking(authority, crl) as agent:
        lost = authority.client("lost")
        stays = connected(agent.transport.port, lost)
        authority.revoke(tmp_path / "lost.pem", path=crl)
        assert refused_by(agent, lost)
        assert is_closed(stays)  # a new handshake has shown that the list changed
        stays.close()


def test_a_list_that_has_ended_admits_nobody_and_is_named_at_the_start(tmp_path):
    authority = Authority(tmp_path)
    with revoking(authority, authority.revoke(days=-2)) as agent:
        log = refusals((agent, authority), authority.client("left"))
        assert "a revocation list ended on " in log and "no board of its CA is admitted" in log
        assert "the revocation list of --tls-crl has ended, so no board is admitted" in log


def test_a_list_of_another_ca_admits_nobody_and_is_named_at_the_start(tmp_path):
    authority, other = Authority(tmp_path / "a"), Authority(tmp_path / "b")
    with revoking(authority, other.revoke()) as agent:
        log = refusals((agent, authority), authority.client("left"))
        assert "it has no list of one of the CAs of " in log
        assert "--tls-crl has no list of the CA that signed its certificate" in log


def test_two_cas_and_their_lists_are_valid_together_while_boards_change_over(tmp_path):
    old, new = Authority(tmp_path / "old"), Authority(tmp_path / "new")
    lists = tmp_path / "lists.pem"
    lost = new.issue("lost")
    parts = (old.revoke(), new.revoke(lost[0]))
    lists.write_text("".join(Path(part).read_text() for part in parts))
    cert, key = old.agent()
    ca = Path(old.ca)
    ca.write_bytes(ca.read_bytes() + Path(new.ca).read_bytes())
    server = tls_server(0, "127.0.0.1", cert, key, old.ca, str(lists))
    with serving(RunningAgent(server, "memory", 0, 4)) as agent:
        for context in (old.client("left"), new.client("right", trust=old.ca)):
            with connected(agent.transport.port, context) as sock:
                sock.sendall(framed(PING))
                answers(sock, 1)
        context = new.client(trust=old.ca)
        context.load_cert_chain(*lost)
        assert refused_by(agent, context)


def test_files_that_cannot_be_used_are_named_at_each_reload_and_the_former_ones_stay(tmp_path):
    authority = Authority(tmp_path)
    crl = authority.revoke()
    with revoking(authority, crl) as agent:
        for _ in range(2):
            Path(crl).write_text("a slip of the editor")
            reload(agent)
        wait_for(agent.said.getvalue, "cannot use new files")
        said = agent.said.getvalue()
        assert f"--tls-crl {crl} holds no revocation list in PEM form" in said
        with connected(agent.transport.port, authority.client("left")) as sock:
            sock.sendall(framed(PING))
            answers(sock, 1)
        authority.revoke(path=crl)
        reload(agent)
        wait_for(agent.said.getvalue, "certificates loaded")


def test_the_dates_of_the_files_are_checked_each_day():
    times = Times()
    host, server = Host(times), TlsServer(0, "127.0.0.1", own_certificates())
    server.open(host)
    now = times.time_ns()
    times.time_ns = lambda: now + 1000 * 365 * 86_400 * 1_000_000_000
    for _ in range(2):
        assert [seconds for seconds, _ in host.calls].count(86_400.0) == 1
        host.fire()
    warnings = [text for text in host.warnings() if "expired on" in text]
    assert len(warnings) == 2
    server.close()
    host.close()


def refused_by(agent, context):
    """Return whether the agent refuses the handshake."""
    try:
        with connected(agent.transport.port, context) as sock:
            sock.sendall(framed(PING))
            return not sock.recv(100)
    except (ssl.SSLError, ConnectionError):
        return True


@pytest.mark.parametrize(("present", "missing"), [((1, 0, 0), "key"), ((0, 1, 0), "cert"),
                                                ((0, 0, 1), "cert")])  # fmt: skip
def test_options_that_belong_together(present, missing):
    names = [
        name if is_given else None for is_given, name in zip(present, ("c", "k", "a"), strict=True)
    ]
    with pytest.raises(TransportError) as caught:
        tls_server(0, "127.0.0.1", *names)
    assert caught.value.strerror.startswith(f"--tls-{missing} is missing: TLS needs --tls-cert")


# --- limits: with a clock of our own --------------------------------------------------------------


class Host(BareHost):
    """A server whose clock the test sets."""

    def gone(self, transport, peer):
        pass


class Times:
    """The agent's clock: between two readings of the thread's CPU time, ``cost`` passes."""

    def __init__(self):
        self.now = 100.0
        self.cpu = 0.0
        self.cost = 0.0

    def monotonic(self):
        return self.now

    def thread_time(self):
        self.cpu += self.cost
        return self.cpu

    def time_ns(self):
        return time.time_ns()


@pytest.fixture
def tls_bench():
    """(server, its host, times)."""
    times = Times()
    host, server = Host(times), TlsServer(0, "127.0.0.1", own_certificates())
    server.open(host)
    socks = []

    def connect(*, source="127.0.0.1", send_hello=True):
        sock = socket.socket()
        sock.bind((source, 0))
        sock.connect(("127.0.0.1", server.port))
        sock.settimeout(SECONDS)
        socks.append(sock)
        own_address = sock.getsockname()
        host.until(
            lambda: own_address in [connection.address for connection in server._connections],
            "the connection",
        )
        if send_hello:
            sock.sendall(recorded_hello())
        return sock

    yield server, host, times, connect
    for sock in socks:
        sock.close()
    server.close()
    host.close()


def is_over(sock):
    sock.setblocking(False)
    try:
        while sock.recv(65536):
            pass
    except BlockingIOError:
        return False
    except ConnectionResetError:
        pass
    return True


def test_a_handshake_has_a_time_limit(tls_bench):
    server, host, times, connect = tls_bench
    sock = connect()
    host.until(lambda: server._shaking)
    times.now += module.HANDSHAKE_SECONDS - 0.5
    host.fire()
    assert server._shaking and not is_over(sock)
    times.now += 1.0
    host.fire()
    assert not server._shaking and not server._connections
    host.until(lambda: is_over(sock))
    assert "no handshake within 10 s" in host.said()


def test_concurrent_handshakes_are_limited_and_networks_with_most_are_closed_first(
    tls_bench, monkeypatch
):
    server, host, times, connect = tls_bench
    monkeypatch.setattr(module, "MAX_HANDSHAKES", 4)
    greedy = [connect(source="127.0.0.2") for _ in range(4)]
    host.until(lambda: len(server._shaking) == 4)
    more = connect(source="127.0.0.2")
    host.until(lambda: is_over(more))
    assert "over 4 handshakes at once: it may try again" in host.said()
    other_sockets = [connect(source=f"127.0.0.{number}") for number in (3, 4, 5)]
    host.until(lambda: len({connection.network for connection in server._shaking}) == 4)
    assert [is_over(connection) for connection in greedy] == [True, True, True, False]
    assert not any(is_over(connection) for connection in other_sockets)
    late_socket = connect(
        source="127.0.0.6"
    )  # each network has one handshake: those that have begun go on
    host.until(lambda: is_over(late_socket))
    assert (
        not any(is_over(connection) for connection in other_sockets) and len(server._shaking) == 4
    )


def test_handshakes_have_a_share_of_the_time_and_the_network_with_least_is_served_first(tls_bench):
    server, host, times, connect = tls_bench
    times.cost = 0.1
    greedy = [connect(source="127.0.0.2") for _ in range(5)]
    host.until(lambda: len(server._shaking) == 5)
    assert len(server._waiting) == 2  # three steps of 0.1 s, and 0.25 s were saved
    modest = connect(source="127.0.0.3")
    host.until(lambda: len(server._waiting) == 3)
    host.fire()
    assert len(server._waiting) == 3  # no time has passed
    times.now += 0.3  # 75 ms, of which 50 are debts
    host.fire()
    assert {connection.network for connection in server._waiting} == {"127.0.0.2"}
    assert len(server._waiting) == 2
    modest.setblocking(False)
    host.until(lambda: modest.recv(5)[:1] == b"\x16")  # the server's hello
    for _ in range(3):
        times.now += 0.5
        host.fire()
    assert not server._waiting
    for sock in greedy:
        assert sock.recv(5)[:1] == b"\x16"
    times.now += 5.0
    server._seconds_left(times.now)
    assert not server._spent  # no handshake waits: earlier debts no longer count


def test_a_waiting_handshake_whose_connection_closes(tls_bench):
    server, host, times, connect = tls_bench
    times.cost = 0.5
    first, second = connect(), connect()
    host.until(lambda: len(server._waiting) == 1)
    first.close()
    second.close()
    times.now += module.HANDSHAKE_SECONDS + 1
    host.fire()
    host.turn()
    assert not server._waiting and not server._shaking and not server._connections


def test_a_silent_connection_costs_no_handshake(tls_bench):
    server, host, times, connect = tls_bench
    connect(send_hello=False)
    host.turn(0.01)
    assert not server._shaking and len(server._connections) == 1


def test_boards_that_connect_all_at_once():
    """After a restart of the agent, all boards are admitted."""
    with running_agent("tls", "memory") as agent:
        lines, failed = [], []

        def come(number):
            try:
                line = TlsLine(agent.transport.port, authority().client())
                lines.append(line)
                assert XrceClient(line, number).open() == ids.STATUS_OK
            except Exception as error:
                failed.append(error)

        threads = [threading.Thread(target=come, args=(index,)) for index in range(1, 41)]
        for index in threads:
            index.start()
        for index in threads:
            index.join(SECONDS)
        assert not failed and len(agent.agent.clients) == 40
        for line in lines:
            line.close()
