"""Admission by key, network and number, and the record of refusals."""

import re
import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, serving
from support.client import XrceClient
from support.lines import SECONDS, Line, UdpLine
from support.paths import ROOT
from unit.agent.helpers import (
    KEY,
    Board,
    Desk,
    create_client,
    get_info,
    message,
    parse,
    participant,
    sub,
)

from uros.agent.agent import requested_key
from uros.agent.policy.admission import MAX_REFUSALS, Admission, Refusals, make_admission
from uros.agent.policy.rules import ConfigError, Rules
from uros.agent.transports.discovery import DiscoveryServer
from uros.agent.transports.udp import UdpServer
from uros.wire import ids

OK, DENIED = ids.STATUS_OK, ids.STATUS_ERR_DENIED


def create_status(desk, *args, peer=1, **more):
    ((to, sent),) = desk.hear(create_client(*args, **more), peer)
    assert to == peer
    return parse(sent)[1][0][2][0]


# --- what the lists say ----------------------------------------------------------------------


def test_empty_lists_admit_all_clients():
    admission = Admission()
    assert (
        admission.admits_key(1)
        and admission.admits_host("192.0.2.1")
        and admission.admits_host("fe80::1%lo")
    )
    assert admission.max_clients == 4096


@pytest.mark.parametrize(
    "host, inside",
    [
        ("192.168.1.77", True),
        ("192.168.2.77", False),
        ("10.1.2.3", True),
        ("10.1.2.4", False),
        ("::ffff:192.168.1.77", True),
        ("::ffff:192.168.2.77", False),
        ("fd00::1234", True),
        ("fe80::1%eth0", True),
        ("fe90::1%eth0", False),
        ("2001:db8::1", False),
        ("", False),
        ("nonsense", False),
    ],
)
def test_networks(host, inside):
    admission = make_admission(networks=["192.168.1.0/24", "10.1.2.3", "fd00::/8", "fe80::1/64"])
    assert admission.admits_host(host) is inside
    assert admission.admits_host(host) is inside  # as remembered


def test_a_network_may_be_given_by_an_address_in_it():
    admission = make_admission(networks=["192.168.1.7/24"])
    assert admission.admits_host("192.168.1.200")


def test_the_cache_of_addresses_is_bounded():
    admission = make_admission(networks=["10.0.0.0/8"])
    for number in range(5000):
        assert admission.admits_host(f"10.0.{number >> 8}.{number & 255}")
    assert len(admission._hosts) <= 1024


def test_lists_of_files_and_command_line_add_up_and_max_clients_of_the_command_line_wins():
    admission = make_admission(
        [
            ("a.toml", {"keys": ["0x11", 0x22], "max_clients": 9}),
            ("b.toml", {"keys": 0x33, "networks": "10.0.0.0/8", "max_clients": 7}),
        ],
        ["0x44", "85"],
        ["fd00::/8"],
        5,
    )
    assert admission.keys == {0x11, 0x22, 0x33, 0x44, 0x55}
    assert [str(network) for network in admission.networks] == ["10.0.0.0/8", "fd00::/8"]
    assert admission.max_clients == 5


@pytest.mark.parametrize(
    "table, message",
    [
        ({"keys": []}, "keys is empty, which admits nobody: leave it out to admit all"),
        ({"networks": []}, "networks is empty"),
        ({"keys": ["0x1FFFFFFFF"]}, "key is '0x1FFFFFFFF', not a whole number"),
        ({"keys": [-1]}, "key is -1"),
        ({"keys": [True]}, "key is True"),
        ({"networks": ["192.168.1.0/33"]}, 'is no network, such as "192.168.1.0/24"'),
        ({"networks": ["wlan0"]}, "'wlan0' is no network"),
        ({"networks": [7]}, "7 is no network"),
        ({"max_clients": 0}, "max_clients is 0, not a whole number from 1 to 4096"),
        ({"max_clients": 4097}, "max_clients is 4097"),
        ({"max_clients": "10"}, "max_clients is '10'"),
        ({"key": [1]}, "it has no 'key'; did you mean 'keys'?"),
        ([{}], "it is a table, with one bracket on each side"),
        (7, "it is a table"),
    ],
)
def test_mistakes_are_named(table, message):
    with pytest.raises(ConfigError, match=r"rules.toml: \[admission\]: ") as caught:
        make_admission([("rules.toml", table)])
    assert message in str(caught.value)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda values: (
        st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=8), values, max_size=3)
    ),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(["keys", "networks", "max_clients", "x"]), VALUES) | VALUES)
def test_any_table_becomes_lists_or_is_refused(table):
    try:
        admission = make_admission([("file", table)])
    except ConfigError as error:
        assert len(str(error)) < 400
    else:
        assert 1 <= admission.max_clients <= 4096


@given(st.lists(st.text(max_size=30)), st.lists(st.text(max_size=30)))
def test_any_command_line_becomes_lists_or_is_refused(keys, networks):
    try:
        admission = make_admission((), keys, networks)
    except ConfigError:
        return
    assert all(0 <= key <= 0xFFFFFFFF for key in admission.keys)


@given(st.text(max_size=60))
def test_any_host_is_inside_or_outside(host):
    assert make_admission(networks=["10.0.0.0/8"]).admits_host(host) in (True, False)


def test_a_file_may_contain_the_table_alone_or_beside_rules(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text('[admission]\nkeys = ["0x4B0CBE99"]\n')
    rules = Rules()
    assert rules.load(file) == 0
    file.write_text('[admission]\nnetworks = ["10.0.0.0/8"]\n[[client]]\ndomain = 3\n')
    assert rules.load(file) == 1
    admission = make_admission(rules.admission)
    assert admission.keys == {0x4B0CBE99} and len(admission.networks) == 1
    assert rules.settings(1, "x", "/n").domain == 3
    file.write_text("[[admission]]\nkeys = [1]\n")
    rules = Rules()
    rules.load(file)
    with pytest.raises(ConfigError, match="with one bracket on each side"):
        make_admission(rules.admission)


def test_the_example_table_of_the_documentation(tmp_path):
    page = ROOT / "docs" / "agent.md"
    (text,) = re.findall(r"^```toml\n(.+?)^```$", page.read_text("utf-8"), re.M | re.S)
    file = tmp_path / "rules.toml"
    file.write_text(text)
    rules = Rules()
    rules.load(file)
    admission = make_admission(rules.admission)
    assert admission.keys == {0x4B0CBE99, 0x4B0CBE9A, 7} and admission.max_clients == 20
    assert [str(network) for network in admission.networks] == ["192.168.1.0/24", "fd00::/8"]


# --- keys and numbers --------------------------------------------------------------------------


def test_a_key_that_is_not_allowed_is_denied_and_logged_with_the_remedy():
    desk = Desk(admission=make_admission(keys=["0x11"]))
    assert create_status(desk, 0x11, peer=1) == OK
    for _ in range(50):
        assert create_status(desk, 0x22, peer=2) == DENIED
    assert list(desk.agent.clients) == [0x11]
    assert desk.log().count("client key not allowed") == 1
    assert "client_key: 0x00000022, address: peer 2 (to let it in: --allow-key 0x00000022)" in (
        desk.log()
    )
    assert desk.agent.refusals[0x22][:3] == ("client key not allowed", "peer 2", 50)
    desk.close()


def test_max_clients_limits_the_clients():
    desk = Desk(admission=make_admission(max_clients=3))
    for key in (1, 2, 3):
        assert Board(desk, key, key).ask(participant()) == [OK]
    assert create_status(desk, 4, peer=4) == ids.STATUS_ERR_RESOURCES
    assert "over 3 clients" in desk.log()
    assert "(see --max-clients, which can be 4096)" in desk.log()
    assert desk.agent.refusals[4].why == "over 3 clients"
    desk.agent.delete_client(2)
    assert create_status(desk, 4, peer=4) == OK
    desk.close()


def test_clients_without_objects_are_evicted_for_a_new_one_and_not_all_of_them():
    desk = Desk(admission=make_admission(max_clients=3))
    for key in (1, 2, 3, 4):
        desk.clock += 10
        assert create_status(desk, key, peer=key) == OK
    assert set(desk.agent.clients) == {2, 3, 4}
    desk.close()


# --- the record --------------------------------------------------------------------------------


def test_refusals_count_and_are_bounded():
    refusals = Refusals()
    for when in range(3):
        refusals.note(7, "why", f"peer {when}", when)
    assert refusals[7] == ("why", "peer 2", 3, 2)
    refusals.note(7, "else", "peer 9", 3)
    assert refusals[7].times == 1
    for key in range(100, 100 + MAX_REFUSALS - 1):
        refusals.note(key, "why", "x", 0)
    refusals.note(7, "else", "x", 0)  # the latest again
    for key in range(1000, 1000 + MAX_REFUSALS - 1):
        refusals.note(key, "why", "x", 0)
    assert len(refusals) == MAX_REFUSALS and 7 in refusals


@given(st.binary(max_size=80))
def test_the_key_of_a_refused_client(data):
    requested_key(memoryview(data))


def test_the_key_in_a_create_client():
    assert requested_key(memoryview(create_client(0x1234))) == 0x1234
    assert requested_key(memoryview(message([get_info()], 0))) is None
    assert requested_key(memoryview(message([sub(0)], 0, 0, 0x80))) is None


# --- networks, over real sockets ---------------------------------------------------------------


class FromLine(UdpLine):
    """A UDP line from a chosen local address: all of 127.0.0.0/8 is this machine."""

    def __init__(self, port, source):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((source, 0))
        self._socket.connect(("127.0.0.1", port))
        Line.__init__(self, self._socket.fileno())


def serving_with(transport, **lists):
    running = RunningAgent(transport, "memory", 0, 4)
    running.agent.admission = make_admission(**lists)
    return serving(running)


@pytest.mark.parametrize("session_id", [0x81, 0x05])
def test_a_peer_outside_the_networks_gets_no_answer(session_id):
    with serving_with("udp", networks=["127.0.0.8/30"]) as running:
        inside = XrceClient(FromLine(running.transport.port, "127.0.0.9"), 1, session_id)
        outside = FromLine(running.transport.port, "127.0.0.2")
        running.lines += [inside.line, outside]
        assert inside.open() == OK
        inside.participant("n")
        # Outsiders cannot use the session of an insider, even if they know its key.
        for datagram in (
            create_client(2), message([get_info()], 0, 0, 0x80), message([get_info()], 0, 0, 0, 1),
            message([get_info()], 0, 0, session_id, 1), b"", b"\x80", create_client(1),
        ):  # fmt: skip
            outside.send(datagram)
        assert inside.ping() == 1  # everything sent before has been handled
        assert outside.receive(0) is None
        assert list(running.agent.clients) == [1]
        assert running.agent.refusals[2].why == "address not allowed"
        assert running.agent.refusals[2].address.startswith("127.0.0.2:")
        log = running.said.getvalue()
        assert log.count("address not allowed") == 1
        assert "it is in no allowed network, client_key: 0x00000002" in log


def test_a_tcp_connection_from_outside_the_networks_is_closed_at_once():
    with serving_with("tcp", networks=["127.0.0.8/30"]) as running:
        where = ("127.0.0.1", running.transport.port)
        with socket.create_connection(where, SECONDS, ("127.0.0.2", 0)) as outside:
            assert outside.recv(1) == b""
        inside = socket.create_connection(where, SECONDS, ("127.0.0.9", 0))
        with inside:
            datagram = create_client(1)
            inside.sendall(len(datagram).to_bytes(2, "little") + datagram)
            assert inside.recv(100)
        assert "it is in no allowed network, refused: 1" in running.said.getvalue()


def test_networks_do_not_apply_to_serial_lines():
    with serving_with("pseudoterminal", networks=["10.0.0.0/8"]) as running:
        client = XrceClient(running.line(), 1)
        assert client.open() == OK
        assert client.ping() == 1


def test_discovery_does_not_answer_peers_outside_the_networks():
    udp = UdpServer(0, "127.0.0.1")
    discovery = DiscoveryServer([udp], 0)
    running = RunningAgent(udp, "memory", 0, 4)
    running.server.transports.append(discovery)
    running.agent.admission = make_admission(networks=["127.0.0.8/30"])
    with serving(running):
        outside = FromLine(discovery.port, "127.0.0.2")
        inside = FromLine(discovery.port, "127.0.0.9")
        running.lines += [outside, inside]
        question = message([get_info()], 0, 0, 0x80)
        outside.send(question)
        inside.send(question)
        assert inside.receive(time.monotonic() + SECONDS) is not None
        assert outside.receive(0) is None


def test_without_networks_every_address_is_admitted():
    with serving_with("udp") as running:
        assert running.transport.admits is None
        client = XrceClient(running.line(), KEY)
        assert client.open() == OK
